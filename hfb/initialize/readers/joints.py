"""Any system's 3D joints: an .npz or JSON with `joints` (frames, 24 | 17 | 14, 3) [m] in the camera's axes (y down).

joints        SMPL's 24, Human3.6M's 17 or the usual 14; or as many as joint_names has
joint_names   SMPL's names (pelvis, left_hip, ...), for joints in another order or number
K             (3, 3) or (frames, 3, 3), where the joints are placed before a camera; else only the pose is taken
frame_index   the video's frame numbers, from 0 on; each row is the next frame where it is missing
y_up          true where y points up and z towards the viewer
"""

from typing import Any

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.initialize.joint_layouts import joints_as_24
from hfb.initialize.readers.contents import array_in, named, numbers, text_of
from hfb.initialize.readers.pose_track import PoseTrack
from hfb.shapes import Array, Float

SYSTEM = "joints"


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """The one person of a joints file; None where it is something else."""
    one = named(content)
    if "joints" not in one or "poses" in one:
        return None
    joints = _joints(one)
    if "y_up" in one and bool(numbers(one["y_up"], 1)[0]):
        joints = joints * np.array([1.0, -1.0, -1.0])
    frames = numbers(one["frame_index"], len(joints)) if "frame_index" in one else np.arange(len(joints))
    K = None
    if "K" in one:
        given = array_in(one["K"])
        K = np.tile(numbers(given, 3, 3), (len(joints), 1, 1)) if given.ndim == 2 else numbers(given, len(joints), 3, 3)
        if (joints[..., 2] <= 0).any():
            raise InputError("it has a camera K, but joints behind it")
    return [PoseTrack(SYSTEM, "0", frames.astype(np.int64), size, joints=joints, K=K)]


def _joints(one: dict[str, Any]) -> Float[Array, "R 24 3"]:
    given = array_in(one["joints"])
    if given.ndim != 3 or given.shape[2] != 3 or not len(given):
        raise InputError(f"its joints are {given.shape} instead of (frames, 24, 3)")
    if "joint_names" not in one:
        return np.stack([joints_as_24(row) for row in given])
    names = [text_of(name) for name in one["joint_names"]]
    if len(names) != given.shape[1]:
        raise InputError(f"it has {given.shape[1]} joints and {len(names)} joint_names")
    full = np.full((len(given), 24, 3), np.nan)
    known = [(at, JOINT_NAMES.index(name)) for at, name in enumerate(names) if name in JOINT_NAMES]
    if not known:
        raise InputError(f"none of its joint_names is one of SMPL's: {', '.join(JOINT_NAMES[:6])} ...")
    for at, joint in known:
        full[:, joint] = given[:, at]
    return full
