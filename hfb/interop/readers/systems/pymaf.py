"""PyMAF (and VIBE, whose layout it took over): output.pkl, {person: {pose, betas, orig_cam, frame_ids, ...}}.

`orig_cam` is weak perspective in the whole image: x appears at (sx (x + tx) + 1) W / 2, y at (sy (y + ty) + 1) H / 2.
A pinhole very far away shows the same.
"""

from typing import Any

import numpy as np

from hfb.interop.readers.parts import numbers_at, read_people
from hfb.interop.readers.pose_track import PoseTrack, pinhole
from hfb.io.safe.contents import frame_numbers
from hfb.typing import Array, Float

SYSTEM = "PyMAF"
_FAR = 150.0
"""Focal length in image sides: the depth of a body then moves no point by a pixel."""


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the persons of an output.pkl; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    return read_people(content, {"pose", "betas", "orig_cam"}, lambda name, one: _person(name, one, size))


def _person(name: str, one: dict[str, Any], size: tuple[int, int]) -> PoseTrack:
    poses = numbers_at(one, "pose", None, 72, finite=False)
    count = len(poses)
    camera = numbers_at(one, "orig_cam", count, 4, finite=False)
    camera[(camera[:, :2] <= 0).any(1)] = np.nan  # a scale of zero or less is no detection
    height, width = _size(one, camera) or size
    focal_px = _FAR * max(height, width)
    depth = 2 * focal_px / (camera[:, 0] * width)
    frames = numbers_at(one, "frame_ids", count) if one.get("frame_ids") is not None else np.arange(count)
    return PoseTrack(
        SYSTEM,
        name,
        frame_numbers(frames),
        (height, width),
        poses=poses.reshape(count, 24, 3),
        trans=np.stack([camera[:, 2], camera[:, 3], depth], 1),
        betas=numbers_at(one, "betas", count, 10, finite=False),
        K=np.tile(pinhole(focal_px, width / 2, height / 2), (count, 1, 1)),
    )


def _size(one: dict[str, Any], camera: Float[Array, "N 4"]) -> tuple[int, int] | None:
    """Return the images' size, which is stored only as the ratio of two cameras: sx = s h / W, sy = s h / H."""
    if one.get("pred_cam") is None or one.get("bboxes") is None:
        return None
    scale = numbers_at(one, "pred_cam", len(camera), 3, finite=False)[:, 0]
    boxes = numbers_at(one, "bboxes", len(camera), 4, finite=False)
    ratios = scale[:, None] * boxes[:, 2:3] / camera[:, :2]
    ratios = ratios[np.isfinite(ratios).all(1)]
    if not len(ratios):
        return None
    sides = np.median(ratios, 0)
    return (round(float(sides[1])), round(float(sides[0]))) if (sides > 8).all() and (sides < 1e5).all() else None
