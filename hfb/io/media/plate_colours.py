"""A plate whose colours were decoded by another matrix than the video's: recognised and converted.

Where a video does not state its matrix, OpenCV and plain swscale decode it as BT.601, players decode HD as BT.709. A
plate that was cut out of the video by one and compared with frames by the other differs wherever the scene is
colourful: saturated red by 20 levels.
"""

from collections.abc import Sequence

import numpy as np

from hfb.typing import Array, Float

COMPARED_FRAMES = 3
_LUMA = {"BT.601": (0.299, 0.114), "BT.709": (0.2126, 0.0722)}
"""Weights of red and blue in luma (ITU-R BT.601-7, BT.709-6)."""
_COLOURFUL, _LEAST_SHARE = 4 / 255, 2e-3
_FAR = 24 / 255  # a person, or anything else that moved, counts no more than this
_CLEARLY = 0.75


def in_colours_of(
    plate: Float[Array, "H W 3"], frames: Sequence[Float[Array, "H W 3"]]
) -> tuple[Float[Array, "H W 3"], str | None]:
    """Return a plate in the colours of a video's frames, and a remark where it was converted.

    Both conversions are compared with the frames, where they change the plate by four levels of 255 or more. One is
    taken where it leaves clearly less difference (0.3 to 0.65 on real plates of this fault); else the plate stays as it
    is, bit for bit.

    Args:
        plate: as its file stores it, in [0, 1].
        frames: a few of the video, as stored.
    """
    scene = np.median(np.stack(frames), axis=0)
    best, remark, least = plate, None, _CLEARLY
    for of_plate, of_video in (("BT.601", "BT.709"), ("BT.709", "BT.601")):
        converted = _converted(plate, of_plate, of_video)
        colourful = np.abs(converted - plate).max(-1) >= _COLOURFUL
        if colourful.mean() < _LEAST_SHARE:
            continue
        before, after = (float(np.minimum(np.abs(scene - one)[colourful], _FAR).mean()) for one in (plate, converted))
        if after < least * before:
            best, least = converted, after / before
            remark = f"its colours were decoded by {of_plate}'s matrix and the video's by {of_video}'s: converted"
    return best, remark


def _converted(rgb: Float[Array, "H W 3"], of: str, to: str) -> Float[Array, "H W 3"]:
    """Convert to luma and chroma by one matrix and back by another."""
    matrix = np.linalg.inv(_to_ycc(*_LUMA[to])) @ _to_ycc(*_LUMA[of])
    return np.clip(rgb @ matrix.T, 0, 1).astype(rgb.dtype)


def _to_ycc(red: float, blue: float) -> Float[Array, "3 3"]:
    luma = np.array([red, 1 - red - blue, blue])
    chroma_blue, chroma_red = (np.eye(3)[axis] - luma for axis in (2, 0))
    return np.stack([luma, chroma_blue / (2 - 2 * blue), chroma_red / (2 - 2 * red)])
