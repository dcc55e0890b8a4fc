"""HybrIK: res.pk, a dictionary of arrays over the frames (pred_thetas as 24 matrices, transl, bbox, ...).

Its camera has a focal length of 1000 px for a crop of 256 px, scaled with the box (x1, y1, x2, y2), and its axis passes
through the middle of the image; `transl` is the position of the root joint.
"""

import re
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.interop.readers.foreign_rotations import from_matrices, from_quaternions
from hfb.interop.readers.parts import numbers_at
from hfb.interop.readers.pose_track import PoseTrack, pinhole
from hfb.io.safe.contents import array_in, named, texts
from hfb.typing import Array, Float, Int

SYSTEM = "HybrIK"
_FOCAL_PX, _CROP_PX = 1000.0, 256.0


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the one person of a res.pk; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    if not {"pred_thetas", "transl", "bbox"} <= one.keys():
        return None
    place = numbers_at(one, "transl", None, 3, finite=False)
    count = len(place)
    if not count:
        raise InputError("it holds nobody")
    boxes = numbers_at(one, "bbox", count, 4, finite=False)
    height, width = _sides(one, count) or size
    focal_px = _FOCAL_PX / _CROP_PX * (boxes[:, 2] - boxes[:, 0])
    return [
        PoseTrack(
            SYSTEM,
            "0",
            _frames(one, count),
            (height, width),
            poses=_poses(one["pred_thetas"], count),
            betas=numbers_at(one, "pred_betas", count, 10, finite=False) if "pred_betas" in one else None,
            pelvis=place,
            K=np.stack([pinhole(float(focal), width / 2, height / 2) for focal in focal_px]),
        )
    ]


def _poses(value: Any, count: int) -> Float[Array, "N 24 3"]:
    """Return poses from matrices, or from quaternions in the releases of 2021."""
    array = array_in(value)
    if array.size % count:
        raise InputError(f"it has poses of the shape {array.shape} for {count} frames")
    flat = array.reshape(count, -1)
    if flat.shape[1] == 24 * 9:
        return from_matrices(flat.reshape(count, 24, 3, 3))
    if flat.shape[1] == 24 * 4:
        return from_quaternions(flat.reshape(count, 24, 4))
    if flat.shape[1] in (55 * 9, 55 * 4):
        raise InputError("it has the 55 joints of HybrIK-X, whose body is SMPL-X; give HybrIK's own result, of SMPL")
    raise InputError(f"it has poses of {flat.shape[1]} numbers; 24 matrices are 216")


def _sides(one: dict[str, Any], count: int) -> tuple[int, int] | None:
    if "height" not in one or "width" not in one:
        return None
    height, width = (np.unique(numbers_at(one, name, count)) for name in ("height", "width"))
    if len(height) != 1 or len(width) != 1:
        raise InputError("it is about pictures of several sizes; hfb needs those of one camera")
    return int(height[0]), int(width[0])


def _frames(one: dict[str, Any], count: int) -> Int[Array, "N"]:
    """Return frames by the images' names, counted from 1; frames before the first detection are missing."""
    found = [re.search(r"(\d+)\.\w+$", name) for name in texts(one.get("img_path"))]
    numbered = [int(match[1]) - 1 for match in found if match]
    if len(numbered) == count and len(set(numbered)) == count and min(numbered, default=-1) >= 0:
        return np.array(numbered, np.int64)
    return np.arange(count)
