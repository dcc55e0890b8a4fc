"""Feet that stand on the floor, and how far they slide there."""

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float, Int

FEET = (JOINT_NAMES.index("left_foot"), JOINT_NAMES.index("right_foot"))
"""Joints at the roots of the toes, which stay while the heel rises."""

_STILL_M_S = 0.5
_LOWER_M = 0.12  # a foot that is held up is higher above the other one than an error of the fit


def standing_feet(motion: SampledMotion, up: Float[Array, "3"]) -> Bool[Array, "R 2"]:
    """Return at which instants the left and the right foot stand: still, and not above the other one.

    Args:
        motion: camera coordinates.
        up: roughly, in camera coordinates.
    """
    feet = motion.joints[:, FEET]
    speed = np.full(feet.shape[:2], np.inf)
    for rows in _frames(motion):
        times = motion.times_s[rows]
        if len(rows) > 1 and (np.diff(times) > 0).all():
            speed[rows] = np.linalg.norm(np.gradient(feet[rows], times, axis=0), axis=-1)
    height = feet @ (up / np.linalg.norm(up))
    return (speed < _STILL_M_S) & (height - height.min(1, keepdims=True) < _LOWER_M)


def foot_skate_mm(motion: SampledMotion, up: Float[Array, "3"]) -> float | None:
    """Return how far a foot slides over the floor during an exposure through which it stands, in the mean.

    None where no foot stands through a whole exposure.

    Args:
        motion: camera coordinates.
        up: direction of up in camera coordinates.
    """
    up = up / np.linalg.norm(up)
    feet, standing = motion.joints[:, FEET], standing_feet(motion, up)
    level = feet - (feet @ up)[..., None] * up
    slid = [
        np.linalg.norm(np.diff(level[rows, foot], axis=0), axis=-1).sum()
        for rows in _frames(motion)
        for foot in range(len(FEET))
        if standing[rows, foot].all()
    ]
    return 1000 * float(np.mean(slid)) if slid else None


def _frames(motion: SampledMotion) -> list[Int[Array, "S"]]:
    """Return the rows of each exposure."""
    return np.split(np.arange(len(motion.frame_index)), np.flatnonzero(np.diff(motion.frame_index)) + 1)
