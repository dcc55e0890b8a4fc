#!/usr/bin/env bash
# torch on a processor: sigmoid of one and the same number has other bits at the end of an array than inside it.
#
# Guess (2026-11-28): an elementwise function of a number is a function of that number; where lies no part in it. If vectors differ from
# the scalar tail, then for exp, sin or tanh, which are approximated.
# Seen with torch 2.13.0 on x86-64 (AVX2): exp, sin, cos, tanh, log, erf and atan have equal bits everywhere. sigmoid does not (some 2 % of
# float32 and of float64 numbers), nor does atan2 of float64 (some 5 %).
# So: batching other items beside one changes its result, unless the batch is padded to a fixed size.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check torch==2.13.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import torch

torch.set_num_threads(1)


def differing(function, dtype):
    """How many of 2000 numbers come out otherwise by themselves than among the others."""
    numbers = torch.rand(2000, generator=torch.Generator().manual_seed(0), dtype=dtype) * 0.9 + 0.05
    alone = torch.cat([function(one[None]) for one in numbers])
    return int((function(numbers) != alone).sum())


equal = {name: differing(getattr(torch, name), torch.float32) for name in ("exp", "sin", "cos", "tanh", "log", "erf")}
sigmoid = {str(dtype): differing(torch.sigmoid, dtype) for dtype in (torch.float32, torch.float64)}
angle = differing(lambda x: torch.atan2(x, 1 - x * x), torch.float64)
print("equal:", equal, "sigmoid:", sigmoid, "atan2, float64:", angle)
assert not any(equal.values()), equal
assert all(sigmoid.values()), sigmoid
assert angle > 0
print(f"torch {torch.__version__}: as found")
PY
