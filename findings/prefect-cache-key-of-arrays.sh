#!/usr/bin/env bash
# Prefect: the cache policy INPUTS gives a torch tensor another key in every process, and equal NumPy arrays the same key only if they lie alike in memory.
#
# Guess (2026-11-28): equal inputs have equal keys.
# Seen with prefect 3.9.1, torch 2.13.0 and numpy 2.4.6: a tensor's key differs between two runs of one script, and from its clone's in one run: what was
# computed is never found again. An array's key changes with memory order, with being a view, a row of a batch or read-only.
# So: give tasks the hash of the bytes (`np.ascontiguousarray(x).tobytes()`, shape and dtype) as the key, or paths with their hashes.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check torch==2.13.0 numpy==2.4.6
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check prefect==3.9.1
export PREFECT_HOME="$place/home" DO_NOT_TRACK=true PREFECT_SERVER_ANALYTICS_ENABLED=false
ask() {
    "$place/venv/bin/python" - <<'PY' 2>/dev/null
import numpy as np
import torch
from prefect.cache_policies import INPUTS


def key(value):
    return INPUTS.compute_key(task_ctx=None, inputs={"x": value}, flow_parameters={})


array = np.arange(12.0).reshape(3, 4)
read_only = array.copy()
read_only.flags.writeable = False
alike = {
    "copy": array.copy(), "column order": np.asfortranarray(array), "view": np.stack([array, array], 2)[..., 0],
    "read-only": read_only,
}  # fmt: skip
assert all(np.array_equal(one, array) for one in alike.values())
same = {name: key(one) == key(array) for name, one in alike.items()}
assert same == {"copy": True, "column order": False, "view": False, "read-only": False}, same
tensor = torch.arange(12.0).reshape(3, 4)
assert key(tensor) == key(tensor) != key(tensor.clone())
print("array", key(array), "tensor", key(tensor))
PY
}
one=$(ask) two=$(ask)
printf '%s\n' "$one" "$two"
test "${one%% tensor*}" = "${two%% tensor*}"
test "${one##* }" != "${two##* }"
echo "prefect 3.9.1: as found"
