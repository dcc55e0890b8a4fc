"""Levels and places of colours in decoded frames: the standard's formula (ITU-R BT.709), whatever the pixel format."""

from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
import pytest

from hfb.io.media.video.video_pixels import upright
from hfb.typing import Array, Float

_KR, _KB = 0.2126, 0.0722
_NAME = Path("clip.mp4")
_BT709, _LIMITED, _FULL = 1, 1, 2


class _Layout(NamedTuple):
    """A pixel format, and how its samples hold values."""

    name: str
    bits: int = 8
    full: bool = False
    pairs: bool = False
    """Both chroma components in one plane."""
    shift: int = 0


_LAYOUTS = (
    _Layout("yuv420p"),
    _Layout("yuv422p"),
    _Layout("yuv444p"),
    _Layout("yuvj420p", full=True),
    _Layout("nv12", pairs=True),
    _Layout("yuv420p10le", 10),
    _Layout("yuv422p10le", 10),
    _Layout("yuv444p10le", 10),
    _Layout("p010le", 10, pairs=True, shift=6),
    _Layout("yuv420p12le", 12),
)


def _encoded(rgb: Float[Array, "H W 3"], layout: _Layout) -> tuple[list[Array], Float[Array, "H W 3"]]:
    """(whole Y, Cb and Cr, the RGB in [0, 1] that they stand for)."""
    y = rgb @ np.array([_KR, 1 - _KR - _KB, _KB])
    cb, cr = (rgb[..., 2] - y) / (2 * (1 - _KB)), (rgb[..., 0] - y) / (2 * (1 - _KR))
    unit, top = 2 ** (layout.bits - 8), 2**layout.bits - 1
    black, span, chroma = (0, top, top) if layout.full else (16 * unit, 219 * unit, 224 * unit)
    stored = [np.round(black + span * y), np.round(128 * unit + chroma * cb), np.round(128 * unit + chroma * cr)]
    y, cb, cr = (stored[0] - black) / span, (stored[1] - 128 * unit) / chroma, (stored[2] - 128 * unit) / chroma
    red, blue = y + 2 * (1 - _KR) * cr, y + 2 * (1 - _KB) * cb
    green = (y - _KR * red - _KB * blue) / (1 - _KR - _KB)
    return stored, np.stack([red, green, blue], -1)


def _frame(stored: list[Array], layout: _Layout) -> av.VideoFrame:
    height, width = stored[0].shape
    frame = av.VideoFrame(width, height, layout.name)
    frame.colorspace, frame.color_range = _BT709, _FULL if layout.full else _LIMITED
    contents = [stored[0], *([np.stack(stored[1:], -1).reshape(height, -1)] if layout.pairs else stored[1:])]
    planes: list[Any] = list(frame.planes)
    for plane, values in zip(planes, contents, strict=True):
        samples = np.frombuffer(plane, np.uint8 if layout.bits == 8 else np.uint16).reshape(plane.height, -1)
        step_y, step_x = height // plane.height, 1 if layout.pairs else width // plane.width
        chosen = values[::step_y, ::step_x][:, : samples.shape[1]]
        if layout.pairs and values is not stored[0]:
            chosen = values.reshape(height, width, 2)[::2, ::2].reshape(height // 2, -1)
        samples[:, : chosen.shape[1]] = chosen.astype(int) << layout.shift
    return frame


@pytest.mark.parametrize("layout", _LAYOUTS, ids=lambda layout: layout.name)
@pytest.mark.parametrize("size", [(48, 64), (18, 34)])
def test_levels_are_the_standards_without_bias(layout: _Layout, size: tuple[int, int]) -> None:
    random, errors = np.random.default_rng(0), []
    for colour in [*random.uniform(0.02, 0.98, (40, 3)), np.zeros(3), np.ones(3), np.full(3, 0.5)]:
        stored, meant = _encoded(np.broadcast_to(colour, (*size, 3)), layout)
        pixels = upright(_frame(stored, layout), _NAME, 1.0)
        full = 255 if pixels.dtype == np.uint8 else 65535
        assert pixels.dtype == (np.uint8 if layout.bits == 8 else np.uint16)
        errors.append(pixels * (255 / full) - meant.clip(0, 1) * 255)
    assert np.abs(errors).max() < (0.6 if layout.bits == 8 else 0.05)
    assert abs(np.mean(errors)) < (0.12 if layout.bits == 8 else 0.02)


@pytest.mark.parametrize("layout", [one for one in _LAYOUTS if "420" in one.name], ids=lambda layout: layout.name)
def test_a_coloured_edge_lies_where_it_was_filmed(layout: _Layout) -> None:
    columns = np.arange(128)
    for place in np.arange(60, 64, 0.5):
        share = 1 / (1 + np.exp(-(columns - place) / 1.5))
        rgb = np.empty((32, 128, 3))
        rgb[:] = np.stack([0.1 + 0.7 * share, np.full(128, 0.25), 0.8 - 0.7 * share], -1)
        stored, _ = _encoded(rgb, layout)
        for chroma in (1, 2):  # a sample for two pixels lies between them, as encoders average
            stored[chroma] = np.round((stored[chroma][:, ::2] + stored[chroma][:, 1::2]) / 2).repeat(2, 1)
        pixels = upright(_frame(stored, layout), _NAME, 1.0)[16].astype(float)
        for channel in (0, 2):
            line, whole = pixels[:, channel], rgb[16, :, channel]
            found, meant = (np.interp(0.5, (v - v[0]) / (v[-1] - v[0]), columns) for v in (line, whole))
            assert abs(found - meant) < 0.12, (place, channel)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("limited", [True, False])
def test_gray_has_the_range_that_is_stated(bits: int, limited: bool) -> None:
    unit = 2 ** (bits - 8)
    black, white = (16 * unit, 235 * unit) if limited else (0, 2**bits - 1)
    stored = np.round(np.linspace(black, white, 64)).astype(np.uint8 if bits == 8 else np.uint16)
    picture = np.tile(stored, (48, 1))
    frame = av.VideoFrame.from_ndarray(picture, format="gray" if bits == 8 else f"gray{bits}le")
    frame.color_range = _LIMITED if limited else _FULL
    levels = upright(frame, _NAME, 1.0)
    most = np.iinfo(levels.dtype).max
    expected = (picture.astype(float) - black) / (white - black)
    np.testing.assert_allclose(levels / most, np.repeat(expected[..., None], 3, -1), atol=0.51 / most)
