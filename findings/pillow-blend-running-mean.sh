#!/usr/bin/env bash
# Pillow: a running mean of 32 frames by Image.blend is 8 levels too dark.
#
# Guess (2026-11-28): `mean = Image.blend(mean, frame, 1 / k)` rounds, so the mean of 32 frames is right to a level.
# Seen with Pillow 13.0.0: each blend cuts off what follows the point, half a level each time; of 32 frames of noise the mean is 7.8 levels too dark.
# So: add frames up as numbers (float32 or wider, in linear light where an exposure is meant).
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check pillow==13.0.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import numpy as np
import PIL
from PIL import Image

frames = np.random.default_rng(3).integers(0, 256, (32, 64, 64, 3)).astype(np.uint8)
mean = Image.fromarray(frames[0])
for count, frame in enumerate(frames[1:], 2):
    mean = Image.blend(mean, Image.fromarray(frame), 1 / count)
bias = float((np.asarray(mean) - frames.mean(0)).mean())
print(f"running mean of 32 frames: {bias:.2f} levels")
assert -8.5 < bias < -7, bias
print(f"Pillow {PIL.__version__}: as found")
PY
