#!/usr/bin/env bash
# OpenCV 5: Lanczos moves an image in steps of 1/32 pixel, linear interpolation does not.
#
# Guess (2026-11-28): all of warpAffine's filters share one table of 32 positions, or none does; Lanczos, the sharpest, is the one to take
# for shifts of a hundredth of a pixel.
# Seen with opencv-python-headless 5.0.0.93: INTER_LANCZOS4 does not move by .01 px at all and moves by .069 px when asked for .05, in
# warpAffine and remap alike. INTER_LINEAR is right to .0005 px.
# So: no Lanczos of OpenCV where a plate must lie right to .01 px.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import cv2
import numpy as np

PERIOD_PX = 37
x = np.arange(400)
image = np.repeat(np.sin(x * 2 * np.pi / PERIOD_PX).astype(np.float32)[None], 50, 0)


def moved_px(shifted):
    """How far a sine wave went, by its phase."""
    inner = slice(PERIOD_PX, 10 * PERIOD_PX)
    wave = np.exp(-2j * np.pi * x[inner] / PERIOD_PX)
    before, after = (image[20, inner] * wave).sum(), (shifted[20, inner] * wave).sum()
    return float(np.angle(before / after) / (2 * np.pi) * PERIOD_PX)


worst = {}
for name in ("INTER_LINEAR", "INTER_LANCZOS4"):
    found = {}
    for asked in (0.01, 0.02, 0.05, 0.1):
        matrix = np.float64([[1, 0, asked], [0, 1, 0]])
        shifted = cv2.warpAffine(image, matrix, (400, 50), flags=getattr(cv2, name), borderMode=cv2.BORDER_REPLICATE)
        found[asked] = moved_px(shifted)
    worst[name] = max(abs(got - asked) for asked, got in found.items())
    print(name, {asked: round(got, 4) for asked, got in found.items()})
assert worst["INTER_LINEAR"] < 0.001, worst
assert worst["INTER_LANCZOS4"] > 0.009, worst
print(f"OpenCV {cv2.__version__}: as found")
PY
