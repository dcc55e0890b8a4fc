"""The vertical axis of a recording, by the person's posture in it and by the rest pose.

Exporters write skeletons whose rest pose has another vertical axis than the world (y up beside z up), and rest poses
that are no pose, with all bones along one axis.
"""

import numpy as np

from hfb.datasets.motions.skeletons.joint_names import JointMap
from hfb.errors import InputError
from hfb.geometry.quaternions import unit
from hfb.typing import Array, Float

_TRUNK, _LEGS = 0.7, 0.2
"""Cosines of trunk and legs with what is up, above which somebody is upright, in a chair too."""
_SOMETIMES, _MOSTLY = 0.2, 0.6
"""Shares of frames: whoever is upright so often by the rest pose's up leaves no doubt; so often by another one is not
lying."""
_ON_FLOOR, _FLAT, _TRAVEL = 0.25, 0.8, 1.0
"""Lengths relative to a leg: height of the floor, height of a lying person, distance that nobody moves on their
back."""


def find_up(
    places: Float[Array, "F N 3"], joints: JointMap, rest_up: Float[Array, "3"], is_pose: bool
) -> Float[Array, "3"]:
    """Return the coordinate axis of the file's world that points up.

    Args:
        places: positions of every joint in the file's world.
        joints: numbers of a person's joints.
        rest_up: the axis along which the trunk points at rest.
        is_pose: whether the rest pose is an upright person.

    Raises:
        InputError: the motion does not determine it.
    """
    sides = ("left", "right")
    hips, ankles = (places[:, [joints.limbs[f"{side}_{part}"] for side in sides]].mean(1) for part in ("hip", "ankle"))
    trunk, legs = unit(places[:, joints.head] - hips), unit(hips - ankles)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    upright = ((trunk @ axes.T > _TRUNK) & (legs @ axes.T > _LEGS)).mean(0)
    by_rest = float(upright[int((axes @ rest_up).argmax())])
    best, often = axes[int(upright.argmax())], float(upright.max())
    if by_rest >= (_SOMETIMES if is_pose else max(_SOMETIMES, often / 2)):
        return rest_up
    if often < _MOSTLY:
        if is_pose:  # crawling, wheels, exercises on the floor: most files have one up for both
            return rest_up
        raise InputError(
            "its rest pose is no pose, and in its motion the person is seldom upright, so that up is not known; export "
            "it with a T-pose as the rest pose, or with more of the recording"
        )
    if is_pose and _lies(places, hips, float(np.linalg.norm(hips - ankles, axis=-1).max()), best, rest_up):
        return rest_up
    return best


def _lies(
    places: Float[Array, "F N 3"],
    hips: Float[Array, "F 3"],
    leg: float,
    best: Float[Array, "3"],
    rest_up: Float[Array, "3"],
) -> bool:
    """Return whether a person who is stretched along `best` all the time lies in a world whose up is `rest_up`.

    Raises:
        InputError: the motion does not determine it.
    """
    way = np.ptp(hips - (hips @ best)[:, None] * best, axis=0)
    if np.linalg.norm(way) > _TRAVEL * leg:
        return False
    heights = places @ rest_up
    lies = abs(np.percentile(heights.min(1), 5)) < _ON_FLOOR * leg and np.ptp(heights, axis=1).max() < _FLAT * leg
    stands = abs(np.percentile((places @ best).min(1), 5)) < _ON_FLOOR * leg
    if lies == stands:
        raise InputError(
            "its person lies all the time, or the world has another up than the rest pose: export it with the same up "
            "for both"
        )
    return bool(lies)
