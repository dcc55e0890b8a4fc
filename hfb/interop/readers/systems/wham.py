"""WHAM: wham_output.pkl, {person: {pose, trans, betas, frame_ids, pose_world, ...}}.

`pose` and `trans` are SMPL's in the camera's axes, before a camera whose focal length is the image's diagonal.
"""

import math
from typing import Any

import numpy as np

from hfb.interop.readers.parts import numbers_at, read_people
from hfb.interop.readers.pose_track import PoseTrack, pinhole
from hfb.io.safe.contents import frame_numbers

SYSTEM = "WHAM"


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the persons of a wham_output.pkl; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    return read_people(content, {"pose", "trans", "betas", "frame_ids"}, lambda name, one: _person(name, one, size))


def _person(name: str, one: dict[str, Any], size: tuple[int, int]) -> PoseTrack:
    height, width = size
    poses = numbers_at(one, "pose", None, 72, finite=False)
    count = len(poses)
    K = pinhole(math.hypot(height, width), width / 2, height / 2)
    return PoseTrack(
        SYSTEM,
        name,
        frame_numbers(numbers_at(one, "frame_ids", count)),
        size,
        poses=poses.reshape(count, 24, 3),
        trans=numbers_at(one, "trans", count, 3, finite=False),
        betas=numbers_at(one, "betas", count, 10, finite=False),
        K=np.tile(K, (count, 1, 1)),
    )
