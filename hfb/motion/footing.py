"""Feet that stand on the floor, how far they slide there, and how high the floor is."""

from dataclasses import replace

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.geometry.placement import floor_slant_deg, in_world, row_of, z_up
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float, Int

FEET = (JOINT_NAMES.index("left_foot"), JOINT_NAMES.index("right_foot"))
"""Joints at the roots of the toes, which stay while the heel rises."""

FEET_AND_ANKLES = (*FEET, JOINT_NAMES.index("left_ankle"), JOINT_NAMES.index("right_ankle"))
SOLES_M = (0.01, 0.01, 0.08, 0.08)
"""How far below these joints the soles of a foot that stands are; those of posed bodies are there to 2 cm."""

_NEAR_M = 0.1  # of the floor: errors of depth become errors of height
_ASLANT_DEG = 5.0
_STILL_M_S, _SLOW_M_S = 0.5, 1.5  # where the floor tells which feet stand, errors of depth may count as speed
_LOWER_M = 0.12  # a foot that is held up is higher above the other one than an error of the fit


def standing_feet(motion: SampledMotion, up: Float[Array, "3"]) -> Bool[Array, "R 2"]:
    """Return at which instants the left and the right foot stand: still, and not above the other one.

    Args:
        motion: camera coordinates.
        up: roughly, in camera coordinates.
    """
    height = motion.joints[:, FEET] @ (up / np.linalg.norm(up))
    return (_speeds_m_s(motion) < _STILL_M_S) & (height - height.min(1, keepdims=True) < _LOWER_M)


def _speeds_m_s(motion: SampledMotion) -> Float[Array, "R 2"]:
    """Return the feet's speeds within each exposure; infinite where it has no two instants."""
    feet = motion.joints[:, FEET]
    speed = np.full(feet.shape[:2], np.inf)
    for rows in _frames(motion):
        times = motion.times_s[rows]
        if len(rows) > 1 and (np.diff(times) > 0).all():
            speed[rows] = np.linalg.norm(np.gradient(feet[rows], times, axis=0), axis=-1)
    return speed


def sole_heights_m(motion: SampledMotion) -> Float[Array, "R 2"]:
    """Return how high the lowest point of each foot is in the motion's world, above the floor where there is one.

    Args:
        motion: camera coordinates.
    """
    heights = z_up(motion.export_world).points(motion.joints[:, FEET_AND_ANKLES])[..., 2] - SOLES_M
    return heights.reshape(-1, 2, 2).min(1)


def foot_contacts(motion: SampledMotion) -> Bool[Array, "R 2"]:
    """Return at which instants the left and the right foot stand: as `standing_feet`, or near a known floor and slow.

    Args:
        motion: camera coordinates.
    """
    world = motion.export_world
    if world.floor is None:
        return standing_feet(motion, z_up(world).R[2])
    return (np.abs(sole_heights_m(motion)) < _NEAR_M) & (_speeds_m_s(motion) < _SLOW_M_S)


def lowest_soles_m(motion: SampledMotion) -> float:
    """Return the median height of standing soles; where nobody stands, that of the lowest sole of each exposure.

    Args:
        motion: camera coordinates.
    """
    heights, standing = sole_heights_m(motion), standing_feet(motion, z_up(motion.export_world).R[2])
    if standing.any():
        return float(np.median(heights[standing]))
    return float(np.median([heights[rows].min() for rows in _frames(motion)]))


def stand(motion: SampledMotion) -> SampledMotion:
    """Return the motion with the floor at its standing feet, where its world asks for it; its up stays.

    Args:
        motion: camera coordinates.
    """
    world = motion.world
    if world is None or world.floor_source != "feet" or world.floor is not None:
        return motion
    up = in_world(world).R @ z_up(world).R[2]
    return replace(motion, world=world.model_copy(update={"floor": (*row_of(up), lowest_soles_m(motion))}))


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


def floor_fault(motion: SampledMotion) -> str | None:
    """Return how the floor contradicts feet or gravity, and the remedy, as a sentence; None where it does not.

    Args:
        motion: camera coordinates.
    """
    world = motion.export_world
    if world.floor is None:
        return None
    if world.floor_source == "feet":
        if standing_feet(motion, z_up(world).R[2]).any():
            return None
        return "no foot stands still, so the floor is taken at the lowest soles: give its plane with --camera.floor"
    slant, off_m = floor_slant_deg(world), lowest_soles_m(motion)
    if world.source != "level" and slant > _ASLANT_DEG:
        return (
            f"the floor that is given is {slant:.0f} degrees aslant to the world's {world.up} axis, which is up: check "
            "its normal in --camera.floor, or the camera's pose"
        )
    if abs(off_m) > _NEAR_M:
        return (
            f"the soles are {100 * abs(off_m):.0f} cm {'above' if off_m > 0 else 'below'} the floor that is given: "
            "check the height in --camera.floor and the camera's pose, and give --fit.height-m, on which distances hang"
        )
    return None


def _frames(motion: SampledMotion) -> list[Int[Array, "S"]]:
    """Return the rows of each exposure."""
    return np.split(np.arange(len(motion.frame_index)), np.flatnonzero(np.diff(motion.frame_index)) + 1)
