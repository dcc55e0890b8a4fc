"""PHALP and 4D-Humans: results/*.pkl, {frame: {time, tid, tracked_time, smpl, camera, size, ...}}.

`camera` is the translation before a camera of 5000 px for an image of 256, whose longer side the frame fills: the
focal length is 5000 / 256 max(W, H), through the middle. `smpl` holds matrices.
"""

from collections import defaultdict
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.interop.readers.foreign_rotations import from_matrices
from hfb.interop.readers.parts import MAX_PEOPLE, named_all, numbers_at
from hfb.interop.readers.pose_track import PoseTrack, pinhole
from hfb.io.safe.contents import numbers

SYSTEM = "PHALP"
_FOCAL_PX, _PICTURE_PX = 5000.0, 256.0
_Row = tuple[int, dict[str, Any], Any, tuple[int, int]]


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the persons of a result file; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    frames = named_all(content.values(), {"tid", "smpl", "camera"}) if isinstance(content, dict) else None
    if not frames:
        return None
    if sum(len(frame["tid"]) for frame in frames) > MAX_PEOPLE:
        raise InputError(f"it holds people more than {MAX_PEOPLE} times")
    seen = [(index, frame, at) for index, frame in enumerate(frames) for at in _seen(frame)]
    bodies = named_all((frame["smpl"][at] for _, frame, at in seen), {"global_orient", "body_pose", "betas"})
    if not seen:
        raise InputError("it holds nobody")
    if bodies is None:
        raise InputError("it holds people without global_orient, body_pose and betas")
    rows: dict[int, list[_Row]] = defaultdict(list)
    for (index, frame, at), body in zip(seen, bodies, strict=True):
        number = int(numbers_at(frame, "time", 1)[0]) if "time" in frame else index
        person = int(numbers(frame["tid"][at], 1)[0])
        rows[person].append((number, body, frame["camera"][at], _sides(frame, at, size)))
    return [_person(str(person), found) for person, found in sorted(rows.items())]


def _seen(frame: dict[str, Any]) -> list[int]:
    """Return the places of those who are visible in a frame."""
    count = min(len(frame[name]) for name in ("tid", "smpl", "camera"))
    return [at for at in range(count) if not _stale(frame, at)]


def _stale(frame: dict[str, Any], at: int) -> bool:
    """Return whether the track only remembers the person from an earlier frame."""
    waited = frame.get("tracked_time")
    return isinstance(waited, list) and at < len(waited) and bool(numbers(waited[at], 1)[0] != 0)


def _sides(frame: dict[str, Any], at: int, size: tuple[int, int]) -> tuple[int, int]:
    sizes = frame.get("size")
    if not isinstance(sizes, list) or at >= len(sizes):
        return size
    height, width = numbers(sizes[at], 2)
    return int(height), int(width)


def _person(name: str, found: list[_Row]) -> PoseTrack:
    sides = {one for *_, one in found}
    if len(sides) != 1:
        raise InputError("it is about pictures of several sizes; hfb needs those of one camera")
    height, width = sides.pop()
    root = [numbers_at(smpl, "global_orient", 1, 3, 3, finite=False) for _, smpl, *_ in found]
    limbs = [numbers_at(smpl, "body_pose", 23, 3, 3, finite=False) for _, smpl, *_ in found]
    K = pinhole(_FOCAL_PX / _PICTURE_PX * max(height, width), width / 2, height / 2)
    return PoseTrack(
        SYSTEM,
        name,
        np.array([number for number, *_ in found], np.int64),
        (height, width),
        poses=from_matrices(np.concatenate([np.stack(root), np.stack(limbs)], 1)),
        trans=np.stack([numbers(camera, 3, finite=False) for _, _, camera, _ in found]),
        betas=np.stack([numbers_at(smpl, "betas", 10, finite=False) for _, smpl, *_ in found]),
        K=np.tile(K, (len(found), 1, 1)),
    )
