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

COCO_17: tuple[str, ...] = (
    *("nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow"),
    *("right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee"),
    *("left_ankle", "right_ankle"),
)
"""COCO's keypoints; a joint that is SMPL's has its name."""
MORE_THAN_COCO: dict[int, dict[int, str]] = {
    26: {20: "left_foot_index", 21: "right_foot_index", 24: "left_heel", 25: "right_heel"},
    133: {
        **{17: "left_foot_index", 19: "left_heel", 20: "right_foot_index", 22: "right_heel"},
        **{96: "left_index", 117: "right_index"},
    },
    136: {20: "left_foot_index", 21: "right_foot_index", 24: "left_heel", 25: "right_heel"},
}
"""Layouts by their number of keypoints that begin with COCO's 17 (Halpe's 26 and 136, COCO-WholeBody's 133), and the
ends of hands and feet among the others."""
_OPENPOSE_15 = (
    *("nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist"),
    *("pelvis", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle"),
)
_LAYOUTS: dict[int, tuple[str, ...]] = {17: COCO_17, 24: JOINT_NAMES, 25: (*_OPENPOSE_15, *10 * ("",))}
_LEAST_CONFIDENCE = 0.2


def trusted(points: Float[Array, "J c"]) -> Float[Array, "J 2"]:
    """Return keypoints [px] without their confidence, NaN where it is low and where detectors that saw none put 0, 0.

    Args:
        points: x, y and, where there is a third column, the confidence.
    """
    seen = (points[:, :2] != 0).any(1, keepdims=True) & (points[:, 2:] >= _LEAST_CONFIDENCE).all(1, keepdims=True)
    return np.where(seen, points[:, :2], np.nan)


def keypoints_as_24(points: Float[Array, "J c"], names: tuple[str, ...] | None = None) -> Float[Array, "24 2"]:
    """Return SMPL's joints [px], NaN where unknown or unreliable; pelvis and neck between hips and shoulders.

    Args:
        points: x, y and confidence, see `trusted`.
        names: names of the keypoints; None for a layout that their number tells.

    Raises:
        InputError: a number of keypoints of no known layout, or other than that of the names.
    """
    if names is None:
        count = 17 if len(points) in MORE_THAN_COCO else len(points)
        if count not in _LAYOUTS:
            raise InputError(
                f"{len(points)} keypoints are of no known layout: give COCO's 17, OpenPose's 25, SMPL's 24, or any "
                "with joint_names"
            )
        points, names = points[:count], _LAYOUTS[count]
    if len(names) != len(points):
        raise InputError(f"it has {len(points)} keypoints and {len(names)} joint_names")
    full = np.full((JOINT_COUNT, 2), np.nan)
    for point, name in zip(trusted(points), names, strict=True):
        if name in JOINT_NAMES and np.isfinite(point).all():
            full[JOINT_NAMES.index(name)] = point
    for middle, sides in (("pelvis", "hip"), ("neck", "shoulder")):
        at = JOINT_NAMES.index(middle)
        if np.isnan(full[at]).any():
            full[at] = (full[JOINT_NAMES.index(f"left_{sides}")] + full[JOINT_NAMES.index(f"right_{sides}")]) / 2
    return full


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
