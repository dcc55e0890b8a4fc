"""The true sub-frames of a case as one image: eight cut-outs side by side, to look at and for evaluation."""

from pathlib import Path

import cv2
import numpy as np

from hfb.datasets.case import Case
from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import picture_size
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.typing import Array, Float

SHARP_SUBFRAMES = 8
"""Number of sub-frames at u = i / 7, the instants of a fit with eight sub-frames."""


def save_sharp(path: Path, pictures: Float[Array, "8 H W 4"]) -> list[int]:
    """Write premultiplied linear sub-frames as straight sRGB with alpha, 8 bit; return their common box.

    The box is (left, top, width, height) [px] within the full image; the file holds eight of it, side by side.

    Args:
        path: the PNG file.
        pictures: premultiplied linear colour and silhouette.
    """
    alphas = pictures[..., 3].max(0)
    rows, columns = (np.flatnonzero(alphas.max(axis) > 0.5 / 255) for axis in (1, 0))
    left, top = int(columns[0]), int(rows[0])
    width, height = int(columns[-1]) + 1 - left, int(rows[-1]) + 1 - top
    strip = np.concatenate(list(pictures[:, top : top + height, left : left + width]), 1)
    alpha = np.clip(strip[..., 3:], 0, 1)
    colour = linear_to_srgb(np.clip(strip[..., :3] / np.maximum(alpha, 1e-6), 0, 1))
    levels = np.round(np.concatenate([colour[..., ::-1], alpha], -1) * 255).astype(np.uint8)
    levels[levels[..., 3] == 0] = 0
    done, encoded = cv2.imencode(".png", levels, [cv2.IMWRITE_PNG_COMPRESSION, 6])
    if not done:
        raise OSError(f"{path}: the picture could not be encoded")
    write_bytes_atomic(path, encoded.tobytes())
    return [left, top, width, height]


def load_sharp(case: Case, frame: int) -> Float[Array, "8 H W 4"]:
    """Return the true sub-frames of one frame at u = i / 7, full size: premultiplied linear colour and silhouette.

    Colours are those of the 8-bit file.

    Args:
        case: a case of a set.
        frame: its number.

    Raises:
        InputError: the file is missing or damaged, or case.json has no box for it.
    """
    path = case.sharp_paths()[frame]
    try:
        left, top, width, height = (int(value) for value in case.facts["sharp"][frame])
        size = int(case.facts["camera"]["height"]), int(case.facts["camera"]["width"])
        picture_size(path)
        levels = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, KeyError, IndexError, TypeError, ValueError, cv2.error) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path} is no strip of sub-frames ({reason}); make the set again with `hfb synth`") from None
    inside = min(left, top) >= 0 and left + width <= size[1] and top + height <= size[0]
    if levels is None or not inside or levels.shape != (height, SHARP_SUBFRAMES * width, 4):
        raise InputError(f"{path} is damaged or of another case; make the set again with `hfb synth`")
    strip = levels.reshape(height, SHARP_SUBFRAMES, width, 4).swapaxes(0, 1).astype(np.float32) / 255
    pictures = np.zeros((SHARP_SUBFRAMES, *size, 4), np.float32)
    window = pictures[:, top : top + height, left : left + width]
    window[..., 3] = strip[..., 3]
    window[..., :3] = srgb_to_linear(strip[..., 2::-1]) * strip[..., 3:]
    return pictures
