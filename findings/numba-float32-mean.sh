#!/usr/bin/env bash
# numba: the mean of a float32 image is wrong by a sixth where NumPy's is right to a millionth.
#
# Guess (2026-11-28): `image.mean()` in a compiled function is as exact as NumPy's.
# Seen with numba 0.68.1: sums of float32 are added one after another in float32. The mean of a 4K RGB image that is .8 everywhere is .674, of
# 1080p .7916; NumPy adds in pairs and gives .8000001.
# So: sum into a float64 of one's own, or row by row.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check numba==0.68.1 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import numba
import numpy as np


@numba.njit
def mean(image):
    return image.mean()


found = {}
for height, width in ((1080, 1920), (2160, 3840)):
    image = np.full((height, width, 3), 0.8, np.float32)
    found[height] = float(mean(image)), float(image.mean())
print("mean of .8 everywhere, (numba, NumPy):", found)
assert abs(found[1080][0] - 0.8) > 0.005 and abs(found[2160][0] - 0.8) > 0.1, found
assert all(abs(right - 0.8) < 1e-6 for _, right in found.values()), found
print(f"numba {numba.__version__}: as found")
PY
