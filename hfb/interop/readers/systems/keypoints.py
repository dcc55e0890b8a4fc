"""Any system's 2D keypoints [px]: only where the joints are seen, not how deep they lie.

keypoints     (frames, J, 2 | 3) in an .npz or JSON, the third a confidence; J is 17 (COCO), 25 (OpenPose) or 24 (SMPL).
              Also keypoints2d, keypoints_2d, joints2d, joints_2d
joint_names   SMPL's names, for joints in another order or number
frame_index   the video's frame numbers, from 0 on

COCO's and AlphaPose's results: a JSON list of {image_id, keypoints: [x, y, confidence, ...]}, 17 or more of them; an
image's number is its id, or the last digits of its name; names are matched with the clip's own. People are told apart
by track_id or idx, else a person is who lies nearest from frame to frame.
MMPose's: {instance_info: [{frame_id, instances: [{keypoints, keypoint_scores}]}]}, frames counted from 1.
OpenPose's: {people: [{pose_keypoints_2d}]}, one image.
"""

import math
import warnings
from collections import defaultdict
from typing import Any, NamedTuple

import numpy as np

from hfb.errors import InputError
from hfb.initialization.joint_layouts import keypoints_as_24, trusted
from hfb.interop.readers.image_names import number_in
from hfb.interop.readers.linking import linked
from hfb.interop.readers.parts import named_all
from hfb.interop.readers.pose_track import PoseTrack, pinhole
from hfb.io.safe.contents import array_in, named, numbers, text_of
from hfb.typing import Array, Float

SYSTEM = "2D keypoints"
_NAMES = ("keypoints", "keypoints2d", "keypoints_2d", "joints2d", "joints_2d")
_MOST = 1 << 17  # of single detections
_REACH = 0.4
"""Largest step of a person from one frame to the next, relative to their visible size."""


class _Detection(NamedTuple):
    """A person in an image: its number, the keypoints, and its name where it has one."""

    number: int
    points: Float[Array, "_ c"]
    image: str | None = None


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the persons of a file of keypoints; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    name = next((name for name in _NAMES if name in one), None)
    if name is not None and "poses" not in one:
        return [_of_array(array_in(one[name]), one, size)]
    if isinstance(one.get("people"), list):
        people = named_all(one["people"], ("pose_keypoints_2d",))
        points = [_points(person["pose_keypoints_2d"]) for person in people or ()]
        return [_person(str(at), [_Detection(0, found)], size) for at, found in enumerate(points)] or None
    if isinstance(one.get("instance_info"), list):
        return _of_detections(_of_mmpose(one["instance_info"]), size)
    detections = named_all(content, ("image_id", "keypoints")) if isinstance(content, list) else None
    return _of_detections(detections, size) if detections else None


def _of_array(points: Float[Array, "..."], one: dict[str, Any], size: tuple[int, int]) -> PoseTrack:
    if points.ndim == 2:
        points = points[None]
    if points.ndim != 3 or points.shape[2] not in (2, 3) or not len(points):
        raise InputError(f"its keypoints are {points.shape} instead of (frames, 17 | 24 | 25, 2 | 3)")
    names = tuple(text_of(name) for name in one["joint_names"]) if "joint_names" in one else None
    frames = numbers(one["frame_index"], len(points)) if "frame_index" in one else np.arange(len(points))
    return _person("0", list(map(_Detection, frames.astype(int).tolist(), points)), size, names)


def _of_mmpose(frames: list[Any]) -> list[dict[str, Any]]:
    """Convert MMPose's detections to COCO's; its demo counts frames from 1."""
    parts = []
    for frame in named_all(frames, ("frame_id", "instances")) or []:
        for one in named_all(frame["instances"], ("keypoints", "keypoint_scores")) or []:
            points = numbers(one["keypoints"], None, 2)
            rows = np.column_stack([points, numbers(one["keypoint_scores"], len(points))])
            number = int(numbers(frame["frame_id"], 1)[0]) - 1
            parts.append({**one, "image_id": number, "keypoints": rows.ravel().tolist()})
    if not parts:
        raise InputError("it holds nobody")
    return parts


def _of_detections(parts: list[dict[str, Any]], size: tuple[int, int]) -> list[PoseTrack]:
    if len(parts) > _MOST:
        raise InputError(f"it holds {len(parts)} people one by one; give the frames of one clip")
    people: dict[str, list[_Detection]] = defaultdict(list)
    nameless: list[_Detection] = []
    for part in sorted(parts, key=lambda part: -float(numbers(part.get("score", 0), 1)[0])):
        image = part["image_id"]
        seen = _Detection(_number(image), _points(part["keypoints"]), None if _is_number(image) else text_of(image))
        person = _name(part.get("track_id")) or _name(part.get("idx"))
        (nameless if person is None else people[person]).append(seen)
    found = sorted(people.items())
    found += [
        (f"unnamed {number}" if people else str(number), one) for number, one in enumerate(linked(nameless, _ways))
    ]
    return [_person(person, one, size) for person, one in found]


def _name(mark: Any) -> str | None:
    """Return a person's name from a whole number, a text, or lists of these; None for any other value."""
    while isinstance(mark, list | tuple) and mark:
        mark = mark[0]
    if isinstance(mark, bool) or not isinstance(mark, int | float | str) or mark in ("", -1):
        return None
    return str(int(mark)) if isinstance(mark, float) and mark.is_integer() else text_of(mark)


def _ways(before: list[_Detection], now: list[_Detection]) -> Float[Array, "b n"]:
    """Return the distance between keypoints that are reliable in both, in steps of a person of that size."""
    if len({one.points.shape for one in (*before, *now)}) > 1:
        raise InputError("its people have different numbers of keypoints; give those of one model")
    old, new = (np.stack([trusted(one.points) for one in people]) for people in (before, now))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no keypoint is reliable in both: NaN, which links nobody
        away_px = np.nanmedian(np.linalg.norm(old[:, None] - new, axis=-1), -1)
        old_px, new_px = ((np.nanmax(one, 1) - np.nanmin(one, 1)).max(-1) for one in (old, new))
    return away_px / np.maximum(_REACH * np.fmax(old_px[:, None], new_px), 1e-6)


def _is_number(image: Any) -> bool:
    return isinstance(image, int) and not isinstance(image, bool)


def _number(image: Any) -> int:
    """Return an image's number: its id, or the last number of its name."""
    if _is_number(image):
        return int(image)
    number = number_in(text_of(image))
    if number is None:
        raise InputError(f"its image_id {text_of(image)[:40]} has no number in it")
    return number


def _points(value: Any) -> Float[Array, "J 3"]:
    flat = numbers(value, None)
    if len(flat) % 3:
        raise InputError(f"it has a list of {len(flat)} numbers for keypoints; x, y, confidence of each are expected")
    return flat.reshape(-1, 3)


def _person(
    name: str, found: list[_Detection], size: tuple[int, int], names: tuple[str, ...] | None = None
) -> PoseTrack:
    """Build a track with an assumed camera whose focal length is the image's diagonal; only sizes depend on it."""
    found = sorted(found, key=lambda detection: detection.number)
    height, width = size
    K = pinhole(math.hypot(height, width), width / 2, height / 2)
    pixels = np.stack([keypoints_as_24(one.points, names) for one in found])
    frames = np.array([one.number for one in found], np.int64)
    images = tuple(one.image for one in found if one.image is not None)
    return PoseTrack(
        SYSTEM,
        name,
        frames,
        size,
        pixels=pixels,
        K=np.tile(K, (len(found), 1, 1)),
        images=images if len(images) == len(found) else None,
    )
