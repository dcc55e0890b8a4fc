"""Neural Localizer Fields (Sárándi and Pons-Moll 2024): the dictionary of its detect_smpl_batched, saved as it is.

{pose, betas, trans, joints3d, joints2d, ...}, each a list with an entry per frame, frames one after another:

pose       (people, 72) axis-angle of SMPL, or (people, 165) of SMPL-X [rad]; the root turns into the camera's axes
betas      (people, 10)
trans      (people, 3) [m]
joints3d   (people, 24 | 55, 3) [mm], the pelvis first
joints2d   as joints3d [px]; tells the camera, else the default's 55 degrees over the longer side are assumed
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.interop.readers.linking import linked, pelvis_ways
from hfb.interop.readers.parts import MAX_PEOPLE, has_keys
from hfb.interop.readers.pose_track import PoseTrack, pinhole, size_seen
from hfb.interop.readers.seen_camera import camera_of_points, focal_of_points
from hfb.interop.readers.smplx import smpl_poses
from hfb.io.safe.contents import array_in, named, numbers
from hfb.typing import Array, Float

SYSTEM = "NLF"
_NEEDED = ("pose", "betas", "joints3d")
_FIELD_OF_VIEW_DEG = 55.0
_JOINTS = {72: 24, 165: 55}


@dataclass(frozen=True)
class _Seen:
    """A person in a frame."""

    number: int
    pose: Float[Array, "24 3"]
    betas: Float[Array, "10"]
    pelvis: Float[Array, "3"]
    K: Float[Array, "3 3"]


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the persons of a saved prediction, numbered in order; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    if not has_keys(content, _NEEDED):
        return None
    one = named(content)
    lists = [_frames(one[name]) for name in _NEEDED]
    pixels = _frames(one.get("joints2d"))
    if any(part is None for part in lists):
        return None
    poses, betas, joints = (part or [] for part in lists)
    if not len(poses) == len(betas) == len(joints) == len(pixels or poses):
        raise InputError("its pose, betas, joints3d and joints2d have different numbers of frames")
    found: list[_Seen] = []
    spaces = set()
    for number, parts in enumerate(zip(poses, betas, joints, pixels or [None] * len(poses), strict=True)):
        width = _width(parts[0])
        if width:
            spaces.add("smpl" if width == 72 else "smplx")
            found += _look(number, *parts, width=width, size=size)
        if len(found) > MAX_PEOPLE or len(spaces) > 1:
            raise InputError("it holds too many people, or poses of several bodies")
    space = "smplx" if spaces == {"smplx"} else "smpl"
    people = linked(found, pelvis_ways(lambda one: one.pelvis))
    return [_person(str(name), rows, size, space) for name, rows in enumerate(people)]


def _frames(value: Any) -> list[Any] | None:
    """Return the entries per frame; None where it is no list of them."""
    if value is None or isinstance(value, list | tuple):
        return None if value is None else list(value)
    try:
        array = array_in(value)
    except InputError:
        return None
    return list(array) if array.ndim >= 3 else None


def _width(pose: Any) -> int:
    """Return the numbers of a pose, 0 in a frame without people."""
    array = array_in(pose)
    width = array[0].size if array.ndim and len(array) else 0
    if width and width not in _JOINTS:
        raise InputError(f"its poses have {width} numbers instead of 72 (SMPL) or 165 (SMPL-X)")
    return width


def _look(
    number: int, pose: Any, betas: Any, joints: Any, pixels: Any, *, width: int, size: tuple[int, int]
) -> list[_Seen]:
    poses = array_in(pose).reshape(-1, width).astype(np.float64)
    count, joint_count = len(poses), _JOINTS[width]
    bodies = poses.reshape(-1, 24, 3) if width == 72 else smpl_poses(poses[:, :3], poses[:, 3:66])
    shapes = numbers(betas, count, None, finite=False)
    shapes = np.pad(shapes[:, :10], ((0, 0), (0, max(0, 10 - shapes.shape[1]))))
    points = numbers(joints, count, joint_count, 3, finite=False) / 1000
    places = None if pixels is None else numbers(pixels, count, joint_count, 2, finite=False)
    rows = []
    for row in range(count):
        if places is None:
            focal_px = max(size) / (2 * math.tan(math.radians(_FIELD_OF_VIEW_DEG) / 2))
            K = pinhole(focal_px, size[1] / 2, size[0] / 2)
        else:
            K = camera_of_points(points[row], places[row], focal_of_points(points[row], places[row]))
        rows.append(_Seen(number, bodies[row], shapes[row], points[row, 0], K))
    return [one for one in rows if np.isfinite(one.pelvis).all()]


def _person(name: str, rows: list[_Seen], size: tuple[int, int], space: Any) -> PoseTrack:
    K = np.stack([one.K for one in rows])
    return PoseTrack(
        SYSTEM,
        name,
        np.array([one.number for one in rows], np.int64),
        size_seen(K, size),
        poses=np.stack([one.pose for one in rows]),
        betas=np.stack([one.betas for one in rows]),
        betas_space=space,
        pelvis=np.stack([one.pelvis for one in rows]),
        K=K,
    )
