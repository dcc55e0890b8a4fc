"""SAM 3D Body: the result of its estimator, saved as a pickle, .npy, .npz or JSON.

A person has pred_keypoints_3d (70, 3), pred_cam_t, focal_length and pred_keypoints_2d; a missing focal_length is
estimated from both kinds of keypoints. The people are in

- one dictionary, or a flat list of them: the people of one image, as the system's own call returns them
- a list of lists: the people of each frame, counted from 0
- a dictionary of lists: by frame numbers, or by images' names that end with one

Its body is MHR, not SMPL: only the joints are used, and hfb's body is fitted to them.
"""

import logging
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.initialization.joint_layouts import MHR70_AS_24
from hfb.interop.readers.linking import linked, pelvis_ways
from hfb.interop.readers.parts import MAX_PEOPLE, has_keys, named_all, numbers_at
from hfb.interop.readers.pose_track import PoseTrack, pinhole, size_seen
from hfb.interop.readers.seen_camera import camera_of_points, focal_of_points
from hfb.io.safe.contents import named
from hfb.typing import Array, Float

SYSTEM = "SAM 3D Body"
_NEEDED = {"pred_keypoints_3d", "pred_cam_t"}
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Seen:
    """A person in a frame: joints [m], NaN where unknown, and the camera; the image's name where it is known."""

    number: int
    image: str | None
    joints: Float[Array, "24 3"]
    K: Float[Array, "3 3"]


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the persons of a saved estimate, numbered in order; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    frames = _frames(content)
    if sum(len(people) for *_, people in frames) > MAX_PEOPLE:
        raise InputError(f"it holds people more than {MAX_PEOPLE} times")
    found = named_all((one for *_, people in frames for one in people), _NEEDED)
    if not found:
        return None
    places = [(number, image) for number, image, people in frames for _ in people]
    seen = [_look(number, image, one, size) for (number, image), one in zip(places, found, strict=True)]
    placed = [one for one in seen if one.joints[0, 2] > 0]
    if len(placed) < len(seen):
        _log.warning(
            "%s: %d of %d people are left out: not before the camera", SYSTEM, len(seen) - len(placed), len(seen)
        )
    people = linked(placed, pelvis_ways(lambda one: one.joints[0]))
    return [_person(str(name), rows, size) for name, rows in enumerate(people)]


def _frames(content: Any) -> list[tuple[int, str | None, list[Any]]]:
    """Return (frame number, image's name, people) of each frame, as far as the content has that form."""
    if isinstance(content, dict) and len(content) == 1:
        (inner,) = content.values()
        if not has_keys(inner, _NEEDED) and not (isinstance(inner, list) and _are_people(inner)):
            content = inner  # an .npz with one array of frames
    if has_keys(content, _NEEDED):
        return [(0, None, [content])]
    if isinstance(content, dict):
        parts = [one if isinstance(one, list) else [one] for one in content.values()]
        names = list(named(content))
        are_pictures = any(not name.isdecimal() for name in names)
        images = names if are_pictures else [None] * len(names)
        return list(zip(_written(names), images, parts, strict=False))
    if not isinstance(content, list):
        return []
    if _are_people(content):
        return [(0, None, content)]
    return [(number, None, one if isinstance(one, list) else [one]) for number, one in enumerate(content)]


def _are_people(part: list[Any]) -> bool:
    return not any(isinstance(one, list) for one in part)


def _written(names: list[str]) -> list[int]:
    """Return the last number in each name before its suffix; places where one has none, or two are equal."""
    found = [re.findall(r"\d{1,15}", re.sub(r"\.[A-Za-z]\w*$", "", name)) for name in names]
    numbers = [int(each[-1]) for each in found if each]
    return numbers if len(set(numbers)) == len(names) else list(range(len(names)))


def _look(number: int, image: str | None, one: dict[str, Any], size: tuple[int, int]) -> _Seen:
    place = numbers_at(one, "pred_cam_t", 3, finite=False)
    points = numbers_at(one, "pred_keypoints_3d", 70, 3, finite=False) + place
    focal_px = _focal_px(one, points)
    joints = np.full((24, 3), np.nan)
    joints[list(MHR70_AS_24)] = points[list(MHR70_AS_24.values())]
    joints[0] = (joints[1] + joints[2]) / 2
    return _Seen(number, image, joints, _camera(one, points, focal_px, size))


def _focal_px(one: dict[str, Any], points: Float[Array, "70 3"]) -> float:
    """Return the stored focal length, else the one by the system's own 2D and 3D keypoints.

    Raises:
        InputError: neither is there.
    """
    if one.get("focal_length") is not None:
        return float(numbers_at(one, "focal_length", 1, finite=False)[0])
    if one.get("pred_keypoints_2d") is None:
        raise InputError("it has no focal_length, and no pred_keypoints_2d that would tell it; save one of them too")
    pixels = numbers_at(one, "pred_keypoints_2d", 70, 2, finite=False)
    return focal_of_points(points, pixels)  # rows without one are left out


def _camera(
    one: dict[str, Any], points: Float[Array, "70 3"], focal_px: float, size: tuple[int, int]
) -> Float[Array, "3 3"]:
    """Return the camera; the principal point is not stored and follows from the system's own keypoints."""
    if one.get("pred_keypoints_2d") is None:
        return pinhole(focal_px, size[1] / 2, size[0] / 2)
    pixels = numbers_at(one, "pred_keypoints_2d", 70, 2, finite=False)
    return camera_of_points(points, pixels, focal_px)


def _person(name: str, rows: list[_Seen], size: tuple[int, int]) -> PoseTrack:
    K = np.stack([one.K for one in rows])
    frames = np.array([one.number for one in rows], np.int64)
    images = tuple(one.image for one in rows if one.image is not None)
    return PoseTrack(
        SYSTEM,
        name,
        frames,
        size_seen(K, size),
        joints=np.stack([one.joints for one in rows]),
        K=K,
        images=images if len(images) == len(rows) else None,
    )
