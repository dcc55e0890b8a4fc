#!/usr/bin/env bash
# c3d: in a file of integers a coordinate beyond 32767 steps of the scale comes back with another sign, without a warning.
#
# Guess (2026-11-29): 1.1 m in steps of .01 mm, a usual scale of integer files, is kept or refused.
# Seen with c3d 0.6.0: 1100 mm is -210.72 mm; ezc3d 1.7.2 reads the same from the file, so that it was written so.
# So: write floats (a negative `point_scale`, the default, as hfb does), or choose a scale of at least the room's size / 32767.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check c3d==0.6.0 ezc3d==1.7.2 numpy==2.4.6
cd "$place"; "$place/venv/bin/python" - <<'PY'
import importlib.metadata
import warnings

import c3d
import ezc3d
import numpy as np

found, told = {}, []
for scale in (-1.0, 0.1, 0.01):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        writer = c3d.Writer(point_rate=100, point_units="mm", point_scale=scale)
        writer.set_point_labels(["A"])
        writer.add_frames([(np.array([[1100.0, 0, 0, 0, 0]], np.float32), np.zeros((0, 0), np.float32))] * 2)
        writer.set_start_frame(1)
        with open("a.c3d", "wb") as file:
            writer.write(file)
    told += [str(one.message) for one in caught if "analog" not in str(one.message).lower()]
    with open("a.c3d", "rb") as file:
        own = float(next(iter(c3d.Reader(file).read_frames()))[1][0, 0])
    found[scale] = round(own, 2), round(float(ezc3d.c3d("a.c3d")["data"]["points"][0, 0, 0]), 2)
print("1100 mm by scale (c3d, ezc3d):", found, told)
assert found == {-1.0: (1100, 1100), 0.1: (1100, 1100), 0.01: (-210.72, -210.72)}, found
assert not told, told
print(", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("c3d", "ezc3d")) + ": as found")
PY
