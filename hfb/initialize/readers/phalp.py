"""PHALP and 4D-Humans: results/*.pkl, {frame: {time, tid, tracked_time, smpl, camera, size, ...}}.

`camera` is the translation before a camera of 5000 px for a picture of 256, whose longer side the frame fills: the
focal length is 5000 / 256 max(W, H), through the middle. `smpl` holds matrices.
"""

from collections import defaultdict
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.initialize.readers.contents import named, numbers
from hfb.initialize.readers.pose_track import PoseTrack, pinhole
from hfb.initialize.readers.rotations import from_matrices

SYSTEM = "PHALP"
_FOCAL_PX, _PICTURE_PX = 5000.0, 256.0


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """The persons of a result file; None where it is something else."""
    frames = [named(frame) for frame in named(content).values()]
    if not frames or not all({"tid", "smpl", "camera"} <= frame.keys() for frame in frames):
        return None
    rows: dict[int, list[tuple[int, dict[str, Any], Any, tuple[int, int]]]] = defaultdict(list)
    for index, frame in enumerate(frames):
        number = int(numbers(frame["time"], 1)[0]) if "time" in frame else index
        for at, person in enumerate(frame["tid"]):
            if _stale(frame, at) or at >= len(frame["smpl"]) or at >= len(frame["camera"]):
                continue
            sides = _sides(frame, at, size)
            rows[int(numbers(person, 1)[0])].append((number, named(frame["smpl"][at]), frame["camera"][at], sides))
    if not rows:
        raise InputError("it holds nobody")
    return [_person(str(person), found) for person, found in sorted(rows.items())]


def _stale(frame: dict[str, Any], at: int) -> bool:
    """Whether the track only remembers the person from an earlier frame."""
    waited = frame.get("tracked_time")
    return isinstance(waited, list) and at < len(waited) and bool(numbers(waited[at], 1)[0] != 0)


def _sides(frame: dict[str, Any], at: int, size: tuple[int, int]) -> tuple[int, int]:
    sizes = frame.get("size")
    if not isinstance(sizes, list) or at >= len(sizes):
        return size
    height, width = numbers(sizes[at], 2)
    return int(height), int(width)


def _person(name: str, found: list[tuple[int, dict[str, Any], Any, tuple[int, int]]]) -> PoseTrack:
    sides = {one for *_, one in found}
    if len(sides) != 1:
        raise InputError("it is about pictures of several sizes; hfb needs those of one camera")
    height, width = sides.pop()
    matrices = np.stack([
        np.concatenate([numbers(smpl["global_orient"], 1, 3, 3), numbers(smpl["body_pose"], 23, 3, 3)])
        for _, smpl, *_ in found
    ])  # fmt: skip
    K = pinhole(_FOCAL_PX / _PICTURE_PX * max(height, width), width / 2, height / 2)
    return PoseTrack(
        SYSTEM,
        name,
        np.array([number for number, *_ in found], np.int64),
        (height, width),
        poses=from_matrices(matrices),
        trans=np.stack([numbers(camera, 3) for _, _, camera, _ in found]),
        betas=np.stack([numbers(smpl["betas"], 10) for _, smpl, *_ in found]),
        K=np.tile(K, (len(found), 1, 1)),
    )
