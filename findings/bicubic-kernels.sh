#!/usr/bin/env bash
# "Bicubic" is three kernels in two libraries, and inside one library by the function or by a flag that should do nothing there.
#
# Guesses (2026-11-28): torch's `antialias=True` changes nothing where an image is enlarged; Pillow's `transform` and `resize` agree to a level for a
# shift by half a pixel.
# Seen with torch 2.13.0, Pillow 13.0.0: torch has a = -.75, with `antialias` -.5 (bilinear stays the same). Pillow's `resize` has a = -.5, `transform`
# and `rotate` have -1: an edge of 200 levels overshoots by 25 instead of 13.
# So: name library, function and flag beside the word, and never compare or train across them at edges.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check torch==2.13.0 pillow==13.0.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import numpy as np
import PIL
import torch
from PIL import Image


def weights(a):
    """Of the four neighbours half-way between the middle two."""
    far, near = a * (1.5**3 - 5 * 1.5**2 + 8 * 1.5 - 4), (a + 2) * 0.5**3 - (a + 3) * 0.5**2 + 1
    return np.array([far, near, near, far])


found = {}
point = torch.zeros(1, 1, 1, 9)
point[..., 4] = 1
for antialias in (False, True):
    # Twice as large: the outputs beside the point lie .25, .75, 1.25 and 1.75 of its pixels away.
    large = torch.nn.functional.interpolate(point, size=(1, 18), mode="bicubic", antialias=antialias)[0, 0, 0]
    found["torch", antialias] = float(large.min())
same = [torch.nn.functional.interpolate(point, size=(1, 18), mode="bilinear", antialias=flag) for flag in (False, True)]
assert torch.equal(*same)
pixels = np.zeros((9, 9), np.float32)
pixels[:, 4] = 1
image, wide = Image.fromarray(pixels), Image.fromarray(np.pad(pixels, ((0, 0), (0, 1))))
moved = image.transform((9, 9), Image.Transform.AFFINE, (1, 0, 0.5, 0, 1, 0), Image.Resampling.BICUBIC)
resized = wide.resize((9, 9), Image.Resampling.BICUBIC, box=(0.5, 0, 9.5, 9))
found["Pillow transform"], found["Pillow resize"] = (np.asarray(one)[4, 2:6].round(4).tolist() for one in (moved, resized))
print(found)
assert np.allclose(found["Pillow transform"], weights(-1.0), atol=1e-3), weights(-1.0)
assert np.allclose(found["Pillow resize"], weights(-0.5), atol=1e-3), weights(-0.5)
lobe = 1.25**3 - 5 * 1.25**2 + 8 * 1.25 - 4  # times a: the kernel at 1.25
assert abs(found["torch", False] - -0.75 * lobe) < 1e-3 and abs(found["torch", True] - -0.5 * lobe) < 1e-3, lobe
print(f"torch {torch.__version__}, Pillow {PIL.__version__}: as found")
PY
