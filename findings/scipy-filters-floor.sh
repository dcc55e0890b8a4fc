#!/usr/bin/env bash
# SciPy: filters of 8-bit images cut off the fraction after each axis, so a blurred image is a whole gray level too dark; interpolation rounds.
#
# Guess (2026-11-28): `ndimage.gaussian_filter` and `uniform_filter` of uint8 keep an image's mean to .05 levels.
# Seen with scipy 1.17.1: -1.0 levels for a Gaussian, -.7 to -.8 for a box, half of it per axis. `shift`, `zoom` and `rotate` with order 1 round.
# So: filter float arrays, or pass `output=np.float32`. Ten such blurs in a row cost ten levels.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check scipy==1.17.1 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import numpy as np
import scipy
from scipy import ndimage

image = np.random.default_rng(0).integers(0, 256, (300, 300), dtype=np.uint8)
ways = {
    "gaussian_filter, sigma 2": lambda levels: ndimage.gaussian_filter(levels, 2),
    "uniform_filter, 5": lambda levels: ndimage.uniform_filter(levels, 5),
    "rotate by 10 degrees": lambda levels: ndimage.rotate(levels, 10, order=1, reshape=False, mode="mirror"),
    "zoom by 1.5": lambda levels: ndimage.zoom(levels, 1.5, order=1),
}
bias = {name: float(way(image).mean() - way(image.astype(float)).mean()) for name, way in ways.items()}
print({name: round(value, 3) for name, value in bias.items()})
assert -1.05 < bias["gaussian_filter, sigma 2"] < -0.95 and -0.9 < bias["uniform_filter, 5"] < -0.7, bias
assert abs(bias["rotate by 10 degrees"]) < 0.05 and abs(bias["zoom by 1.5"]) < 0.05, bias
as_float = ndimage.gaussian_filter(image, 2, output=np.float32).mean() - image.mean()
assert abs(as_float) < 0.05, as_float
print(f"scipy {scipy.__version__}: as found")
PY
