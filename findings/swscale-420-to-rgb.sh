#!/usr/bin/env bash
# PyAV (swscale): 4:2:0 video read as rgb24 is 1 to 3 levels too dark and its coloured edges lie half a pixel off; white of 10 bits is 253.
#
# Guess (2026-11-28): RGB of a decoded frame is the standard's formula, rounded; coloured edges stay where they were.
# Seen with av 18.1.0 (libswscale 9, x86-64): `to_ndarray(format="rgb24")` of yuv420p is 1.2 levels too dark on average and 2.3 at worst, yuv444p is
# right to .5; white of yuv420p10le is 253, and 65283 as rgb48le. Each colour sample is repeated over two pixels, which moves edges by up to .5 px.
# ACCURATE_RND | FULL_CHR_H_INT mend both, one of them alone does not. With both, rgb48le needs BICUBIC: BILINEAR gives colours that are not there.
# So: give `interpolation=Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT`.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import av
import numpy as np
from av.video.reformatter import Interpolation as Filter

PLAIN, BOTH = Filter.BILINEAR, Filter.BILINEAR | Filter.ACCURATE_RND | Filter.FULL_CHR_H_INT
WIDE = Filter.BICUBIC | Filter.ACCURATE_RND | Filter.FULL_CHR_H_INT


def constant(form, values, dtype=np.uint8):
    frame = av.VideoFrame(32, 32, form)
    for plane, value in zip(frame.planes, values, strict=True):
        np.frombuffer(plane, dtype)[:] = value
    return frame


def meant(y, cb, cr):
    """BT.601, limited range, which swscale takes where nothing is stated."""
    y, cb, cr = (y - 16) / 219, (cb - 128) / 224, (cr - 128) / 224
    red, blue = y + 1.402 * cr, y + 1.772 * cb
    return 255 * np.array([red, (y - 0.299 * red - 0.114 * blue) / 0.587, blue])


def errors(form, filters, target="rgb24", unit=1):
    found = []
    for red, green, blue in np.random.default_rng(0).uniform(0.05, 0.95, (60, 3)):
        y = 0.299 * red + 0.587 * green + 0.114 * blue
        values = np.round([16 + 219 * y, 128 + 224 * (blue - y) / 1.772, 128 + 224 * (red - y) / 1.402])
        rgb = constant(form, values).reformat(format=target, interpolation=filters).to_ndarray()
        found.append(rgb[16, 16] / unit - meant(*values))
    return float(np.mean(found)), float(np.abs(found).max())


def worst_edge(filters):
    columns, worst = np.arange(128), 0
    for place in np.arange(60, 64, 0.25):
        share = 1 / (1 + np.exp(-(columns - place) / 1.5))
        line = np.stack([20 + 180 * share, np.full(128, 60), 200 - 180 * share], -1).round()
        rgb = np.repeat(line[None], 32, 0).astype(np.uint8)
        stored = av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format="yuv420p", interpolation=WIDE)
        read = stored.reformat(format="rgb24", interpolation=filters).to_ndarray()[16].astype(float)
        middles = [np.interp(0.5, (v[:, 0] - v[0, 0]) / (v[-1, 0] - v[0, 0]), columns) for v in (read, line)]
        worst = max(worst, abs(middles[0] - middles[1]))
    return float(worst)


plain, fine, mended = errors("yuv420p", PLAIN), errors("yuv444p", PLAIN), errors("yuv420p", BOTH)
alone = [errors("yuv420p", Filter.BILINEAR | flag) for flag in (Filter.ACCURATE_RND, Filter.FULL_CHR_H_INT)]
white = constant("yuv420p10le", (940, 512, 512), np.uint16)
whites = [int(white.to_ndarray(format=form).max()) for form in ("rgb24", "rgb48le")]
edges = worst_edge(PLAIN), worst_edge(BOTH)
deep = [errors("yuv420p", filters, "rgb48le", 256)[1] for filters in (BOTH, WIDE)]
print("(mean, worst) error [levels]: 4:2:0", plain, "4:4:4", fine, "each flag", alone, "both", mended)
print("white of 10 bits:", whites, "edge [px], plain and both:", edges, "rgb48le, bilinear and bicubic [levels]:", deep)
assert plain[0] < -1 and plain[1] > 2 and all(mean < -1 for mean, _ in alone), (plain, alone)
assert max(fine[1], mended[1]) < 0.6 and whites == [253, 65283], (fine, mended, whites)
assert edges[0] > 0.3 and edges[1] < 0.1, edges
assert deep[0] > 50 and deep[1] < 1, deep
print(f"av {av.__version__}: as found")
PY
