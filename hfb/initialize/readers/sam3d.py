"""SAM 3D Body: what its estimator returns, saved as a pickle, .npy, .npz or JSON: per person pred_keypoints_3d (70, 3),
pred_cam_t, focal_length, pred_keypoints_2d; a dictionary, a list of persons, or a list (or dictionary) of frames.

Its body is MHR, not SMPL: the joints are taken, and hfb's body is laid onto them.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.initialize.joint_layouts import MHR70_AS_24
from hfb.initialize.readers.contents import named, numbers
from hfb.initialize.readers.pose_track import PoseTrack, pinhole
from hfb.shapes import Array, Float

SYSTEM = "SAM 3D Body"
_NEEDED = {"pred_keypoints_3d", "pred_cam_t", "focal_length"}


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """The persons of a saved estimate, numbered by their place in each frame; None where it is something else."""
    frames = list(_frames(content))
    if not any(frames):
        return None
    people: dict[int, list[tuple[int, dict[str, Any]]]] = {}
    for number, found in enumerate(frames):
        for person, one in enumerate(found):
            people.setdefault(person, []).append((number, one))
    return [_person(str(person), found, size) for person, found in sorted(people.items())]


def _frames(content: Any) -> Iterator[list[dict[str, Any]]]:
    if named(content).keys() >= _NEEDED:
        yield [named(content)]
    elif isinstance(content, list) and content and all(named(one).keys() >= _NEEDED for one in content):
        yield [named(one) for one in content]
    elif isinstance(content, dict) and len(content) == 1:  # an .npz with one array of them
        yield from _frames(next(iter(content.values())))
    else:
        parts = content if isinstance(content, list) else list(named(content).values())
        for part in parts:
            people = part if isinstance(part, list) else [part]
            if not all(named(one).keys() >= _NEEDED for one in people):
                return
            yield [named(one) for one in people]


def _person(name: str, found: list[tuple[int, dict[str, Any]]], size: tuple[int, int]) -> PoseTrack:
    joints, cameras = [], []
    for _, one in found:
        points = numbers(one["pred_keypoints_3d"], 70, 3) + numbers(one["pred_cam_t"], 3)
        focal_px = float(numbers(one["focal_length"], 1)[0])
        if (points[:, 2] <= 0).any() or focal_px <= 0:
            raise InputError("it has keypoints behind the camera")
        full = np.full((24, 3), np.nan)
        full[list(MHR70_AS_24)] = points[list(MHR70_AS_24.values())]
        full[0] = (full[1] + full[2]) / 2
        joints.append(full)
        cameras.append(_camera(one, points, focal_px, size))
    frames = np.array([number for number, _ in found], np.int64)
    return PoseTrack(SYSTEM, name, frames, size, joints=np.stack(joints), K=np.stack(cameras))


def _camera(
    one: dict[str, Any], points: Float[Array, "70 3"], focal_px: float, size: tuple[int, int]
) -> Float[Array, "3 3"]:
    """The principal point is not stored; it follows from where the system saw its own keypoints."""
    if one.get("pred_keypoints_2d") is None:
        return pinhole(focal_px, size[1] / 2, size[0] / 2)
    offsets = numbers(one["pred_keypoints_2d"], 70, 2) - focal_px * points[:, :2] / points[:, 2:]
    cx, cy = np.median(offsets, 0)
    return pinhole(focal_px, float(cx), float(cy))
