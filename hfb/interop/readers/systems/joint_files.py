"""Any system's 3D joints: an .npz or JSON with `joints` (frames, 24 | 17 | 14, 3) in the camera's axes (y down) [m].

joints        SMPL's 24, Human3.6M's 17 or the usual 14; or as many as joint_names has; NaN where unknown, or 0 0 0
              but for one joint that is the origin of all frames. Also joints3d, joints_3d, keypoints3d,
              keypoints_3d, or an array alone
joint_names   SMPL's names (pelvis, left_hip, ...), for joints in another order or number
K             (3, 3) or (frames, 3, 3), where the joints are placed before a camera; else only the pose is taken
frame_index   the video's frame numbers, from 0 on; each row is the next frame where it is missing
y_up          true where y points up and z towards the viewer

Millimetres and centimetres are recognised by the bones' lengths.
"""

from typing import Any

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.initialization.joint_layouts import JOINT_COUNTS, joints_as_24
from hfb.interop.readers.parts import numbers_at
from hfb.interop.readers.pose_track import PoseTrack
from hfb.interop.readers.units import in_metres
from hfb.io.safe.contents import array_in, frame_numbers, named, numbers, text_of
from hfb.typing import Array, Float

SYSTEM = "joints"
_NAMES = ("joints", "joints3d", "joints_3d", "keypoints3d", "keypoints_3d")


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the one person of a joints file; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    array = _joint_array(content, one)
    if array is None or "poses" in one:
        return None
    joints = _joints(array, one)
    if "y_up" in one and bool(numbers_at(one, "y_up", 1)[0]):
        joints = joints * np.array([1.0, -1.0, -1.0])
    frames = numbers_at(one, "frame_index", len(joints)) if "frame_index" in one else np.arange(len(joints))
    K = _cameras(one["K"], len(joints)) if "K" in one else None
    return [PoseTrack(SYSTEM, "0", frame_numbers(frames), size, joints=in_metres(joints), K=K)]


def _joint_array(content: Any, one: dict[str, Any]) -> Float[Array, "..."] | None:
    """Return the joints by their name, or an array alone that can be nothing else."""
    name = next((name for name in _NAMES if name in one), None)
    if name is not None:
        return array_in(one[name])
    alone = one.get("arr_0") if len(one) == 1 else content  # numpy.savez's name for an array without one
    if alone is None or isinstance(alone, dict):
        return None
    try:
        array = array_in(alone)
    except InputError:
        return None
    return array if array.ndim == 3 and array.shape[1] in JOINT_COUNTS and array.shape[2] == 3 else None


def _cameras(value: Any, count: int) -> Float[Array, "R 3 3"]:
    array = array_in(value)
    if array.ndim == 2:
        return np.tile(numbers(array, 3, 3), (count, 1, 1))
    return numbers(array, count, 3, 3, finite=False)


def _without_zeros(array: Float[Array, "..."]) -> Float[Array, "..."]:
    """Replace points at 0 0 0, which stand for lost ones, by NaN; keep the joint about which all frames are centred."""
    lost = (array == 0).all(-1)
    centre = lost.all(0)
    return np.where((lost & ~(centre & (centre.sum() == 1)))[..., None], np.nan, array)


def _joints(array: Float[Array, "..."], one: dict[str, Any]) -> Float[Array, "R 24 3"]:
    if array.ndim != 3 or array.shape[2] != 3 or not len(array):
        raise InputError(f"its joints are {array.shape} instead of (frames, 24, 3)")
    array = _without_zeros(array)
    if "joint_names" not in one:
        return np.stack([joints_as_24(row) for row in array])
    names = [text_of(name) for name in one["joint_names"]]
    if len(names) != array.shape[1]:
        raise InputError(f"it has {array.shape[1]} joints and {len(names)} joint_names")
    full = np.full((len(array), 24, 3), np.nan)
    known = [(at, JOINT_NAMES.index(name)) for at, name in enumerate(names) if name in JOINT_NAMES]
    if not known:
        raise InputError(f"none of its joint_names is one of SMPL's: {', '.join(JOINT_NAMES[:6])} ...")
    for at, joint in known:
        full[:, joint] = array[:, at]
    return full
