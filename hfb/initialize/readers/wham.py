"""WHAM: wham_output.pkl, {person: {pose, trans, betas, frame_ids, pose_world, ...}}.

`pose` and `trans` are SMPL's in the camera's axes, before a camera whose focal length is the picture's diagonal.
"""

import math
from typing import Any

import numpy as np

from hfb.initialize.readers.contents import named, numbers
from hfb.initialize.readers.pose_track import PoseTrack, pinhole

SYSTEM = "WHAM"


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """The persons of a wham_output.pkl; None where it is something else."""
    people = {name: named(one) for name, one in named(content).items()}
    if not people or not all({"pose", "trans", "betas", "frame_ids"} <= one.keys() for one in people.values()):
        return None
    height, width = size
    K = pinhole(math.hypot(height, width), width / 2, height / 2)
    tracks = []
    for name, one in people.items():
        poses = numbers(one["pose"], None, 72)
        count = len(poses)
        tracks.append(
            PoseTrack(
                SYSTEM,
                name,
                numbers(one["frame_ids"], count).astype(np.int64),
                size,
                poses=poses.reshape(count, 24, 3),
                trans=numbers(one["trans"], count, 3),
                betas=numbers(one["betas"], count, 10),
                K=np.tile(K, (count, 1, 1)),
            )
        )
    return tracks
