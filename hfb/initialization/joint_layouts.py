"""Joints of other layouts as SMPL's 24, unknown ones as NaN."""

import numpy as np

from hfb.body.skeleton import H36M_14, JOINT_COUNT, JOINT_NAMES
from hfb.errors import InputError
from hfb.typing import Array, Float

# Human3.6M's usual 17 joints (pelvis, right leg, left leg, torso, neck, nose, head, left arm, right arm), as the 14
# of `H36M_14` in that order.
_14_OF_17 = (3, 2, 1, 4, 5, 6, 16, 15, 14, 11, 12, 13, 8, 10)
_LEFT_HIP, _RIGHT_HIP = 1, 2

JOINT_COUNTS: tuple[int, ...] = (JOINT_COUNT, 17, 14)
"""Numbers of joints of the known layouts."""

MHR70_AS_24: dict[int, int] = {
    JOINT_NAMES.index(name): keypoint
    for name, keypoint in {
        "left_shoulder": 5,
        "right_shoulder": 6,
        "left_elbow": 7,
        "right_elbow": 8,
        "left_hip": 9,
        "right_hip": 10,
        "left_knee": 11,
        "right_knee": 12,
        "left_ankle": 13,
        "right_ankle": 14,
        "right_wrist": 41,
        "left_wrist": 62,
        "neck": 69,
    }.items()
}
"""SMPL's joint -> the keypoint of SAM 3D Body's 70 that lies at it."""


def joints_as_24(joints: Float[Array, "J 3"]) -> Float[Array, "24 3"]:
    """Return SMPL's 24 joints from 24, from Human3.6M's 17 or from the usual 14; unknown ones are NaN.

    The pelvis of the 14 is the middle of the hips, the centre of the metrics.

    Args:
        joints: joints in one of the layouts of `JOINT_COUNTS`, any unit.

    Raises:
        InputError: another number of joints.
    """
    if len(joints) == JOINT_COUNT:
        return joints
    if len(joints) not in JOINT_COUNTS:
        raise InputError(f"{len(joints)} joints are of no known layout; give 24, 17 or 14")
    full = np.full((JOINT_COUNT, 3), np.nan, joints.dtype)
    full[list(H36M_14)] = joints if len(joints) == 14 else joints[list(_14_OF_17)]
    full[0] = joints[0] if len(joints) == 17 else (full[_LEFT_HIP] + full[_RIGHT_HIP]) / 2
    return full
