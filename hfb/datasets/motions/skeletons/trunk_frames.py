"""Rotations of pelvis, chest and head within their joints' frames.

A joint's frame determines the rotation of a part of the body only where the part's rotation within that frame is known.
It follows from the rest pose, where this is a standing person. Else it follows from the motion: on average hips,
shoulders and spine show the part's own axes.
"""

import numpy as np

from hfb.datasets.motions.skeletons.joint_names import JointMap
from hfb.geometry.quaternions import conjugate, from_axes, multiply, unit
from hfb.typing import Array, Float

_FAR, _NEAR = (np.cos(np.deg2rad(angle) / 2) for angle in (45, 20))
"""How far pelvis or chest lie at most from where hips, shoulders and spine say, on average: where the rest pose is
trusted, and where it may be none."""
_HEAD = np.cos(np.deg2rad(60) / 2)
"""Nor the head so far from the chest in most frames."""


def trunk_offsets(
    rotations: Float[Array, "F N 4"],
    places: Float[Array, "F N 3"],
    joints: JointMap,
    at_rest: dict[str, Float[Array, "4"]],
    trusted: bool,
) -> tuple[dict[str, Float[Array, "4"]], list[str]]:
    """Estimate how pelvis, chest and head are turned within their joints' frames.

    Args:
        rotations: rotations of every joint, in a world with y up.
        places: positions of every joint [m], in a world with y up.
        joints: numbers of a person's joints.
        at_rest: offsets by the rest pose.
        trusted: whether the rest pose is an upright person, or of a known skeleton.

    Returns:
        what takes SMPL's axes into each joint's frame, by `pelvis`, `chest`, `head`; the parts in which the motion
        contradicted the rest pose.
    """
    sides = ("left", "right")
    hips, shoulders = ([places[:, joints.limbs[f"{side}_{part}"]] for side in sides] for part in ("hip", "shoulder"))
    above = places[:, joints.head]
    middle = (hips[0] + hips[1]) / 2
    seen = {
        "pelvis": _frame(hips[0] - hips[1], (shoulders[0] + shoulders[1]) / 2 - middle),
        "chest": _frame(shoulders[0] - shoulders[1], above - middle),
    }
    offsets, corrected = {}, []
    for part, joint in (("pelvis", joints.pelvis), ("chest", joints.chest)):
        shown = _mean(multiply(conjugate(rotations[:, joint]), seen[part]))
        known = at_rest.get(part)
        if known is not None and abs(float(known @ shown)) >= (_FAR if trusted else _NEAR):
            offsets[part] = known
        else:
            offsets[part] = shown
            corrected.append(part)
    chest = multiply(rotations[:, joints.chest], offsets["chest"])
    straight = _mean(multiply(conjugate(rotations[:, joints.head]), chest))
    known = at_rest.get("head")
    # cosines of half the angle between the head so turned and the chest
    cosines = None if known is None else np.abs((multiply(rotations[:, joints.head], known) * chest).sum(-1))
    usual = cosines is not None and np.median(cosines) >= _HEAD
    offsets["head"] = known if known is not None and usual else straight
    return offsets, corrected if usual else [*corrected, "head"]


def _frame(left: Float[Array, "F 3"], up: Float[Array, "F 3"]) -> Float[Array, "F 4"]:
    """Return the rotation of SMPL's axes: x to the left exactly, y as nearly up as that allows."""
    x = unit(left)
    y = unit(up - (up * x).sum(-1, keepdims=True) * x)
    return from_axes(x, y, np.cross(x, y))


def _mean(rotations: Float[Array, "F 4"]) -> Float[Array, "4"]:
    """Return the mean rotation: the quaternion with the largest sum of squared products (Markley et al., 2007)."""
    _, vectors = np.linalg.eigh(rotations.T @ rotations)
    return vectors[:, -1]
