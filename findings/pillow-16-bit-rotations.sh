#!/usr/bin/env bash
# Pillow: a 16-bit gray image (I;16) that is rotated or moved with BILINEAR or BICUBIC is noise in every pixel; no error, no warning.
#
# Guess (2026-11-28): `Image.transform` and `Image.rotate` of an I;16 image agree with those of the same levels as mode F to half a level.
# Seen with Pillow 13.0.0: a ramp of 16-bit levels moved by half a pixel comes out at levels below 256 where 920, 960, 1000 belong. NEAREST is right,
# and so is `resize` with every filter.
# So: convert to mode F first, or turn 16-bit mattes, depth maps and frames by OpenCV or SciPy.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check pillow==13.0.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import numpy as np
import PIL
from PIL import Image

levels = np.tile((40 * np.arange(200) + 100).astype(np.uint16), (20, 1))
deep, floats = Image.fromarray(levels), Image.fromarray(levels.astype(np.float32))
assert deep.mode == "I;16"
half = (1, 0, 0.5, 0, 1, 0)
ways = {
    "moved by .5 px": lambda image, how: image.transform((198, 20), Image.Transform.AFFINE, half, how),
    "rotated by 1 degree": lambda image, how: image.rotate(1, how),
    "half as wide": lambda image, how: image.resize((100, 20), how),
}
worst = {}
for name, way in ways.items():
    for how in (Image.Resampling.NEAREST, Image.Resampling.BILINEAR, Image.Resampling.BICUBIC):
        found, expected = (np.asarray(way(image, how)).astype(float)[4:-4, 6:-6] for image in (deep, floats))
        worst[name, how.name] = float(np.abs(found - expected).max())
        print(f"{name}, {how.name}: {found[6, 14:18].tolist()} for {expected[6, 14:18].round().tolist()}")
for (name, how), error in worst.items():
    wrong = how != "NEAREST" and name != "half as wide"
    assert (error > 5000) == wrong and (wrong or error <= 1), (name, how, error)
print(f"Pillow {PIL.__version__}: as found")
PY
