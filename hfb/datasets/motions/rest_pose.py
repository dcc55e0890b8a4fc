"""Which way a foreign skeleton looks when it is at rest."""

from dataclasses import dataclass

import numpy as np

from hfb.datasets.motions.bvh import BvhMotion
from hfb.datasets.motions.joint_names import JointMap
from hfb.datasets.motions.quaternions import conjugate, from_axes, from_axis_angle, multiply, unit
from hfb.errors import InputError
from hfb.shapes import Array, Float

_STILL = np.array([1.0, 0, 0, 0])
_FLAT_FOOT = np.array([0, -np.sin(np.deg2rad(13.5)), np.cos(np.deg2rad(13.5))])
"""As Character Creator's feet are while they stand; used where the rest pose does not show it."""


@dataclass(frozen=True)
class Rest:
    """What is known of a skeleton's rest pose, in SMPL's axes (x to the person's left, y up, z forward).

    Attributes:
        axes: rotation from the file's axes to SMPL's.
        upright: whether all angles zero make an upright person, so that every joint's frame is the world's there.
        chest: rotation of the chest's frame at rest.
        collars: rotation of each collar's frame at rest; None where it is not known.
        foot: direction from ankle to toes of a foot that is flat on the ground.
        leg_length: of thigh and shin together, in the file's unit.
    """

    axes: Float[Array, "4"]
    upright: bool
    chest: Float[Array, "4"]
    collars: dict[str, Float[Array, "4"] | None]
    foot: Float[Array, "3"]
    leg_length: float


def find_rest(motion: BvhMotion, joints: JointMap) -> Rest:
    """Read the rest pose off the offsets; where zero angles are no pose, from what is known of the skeleton's family.

    Raises:
        InputError: legs or trunk have no length.
    """
    places = motion.rest()
    hips, knees, ankles = (
        np.stack([places[joints.limbs[f"{side}_{part}"]] for side in ("left", "right")])
        for part in ("hip", "knee", "ankle")
    )
    trunk, across = places[joints.head] - hips.mean(0), hips[0] - hips[1]
    bones = np.linalg.norm([*(knees - hips), *(ankles - knees)], axis=-1)
    if min(*bones, np.linalg.norm(trunk), np.linalg.norm(across)) < 1e-6:
        raise InputError("its legs or trunk have no length")
    # Whoever sets up a skeleton does so along the axes: the nearest ones are meant.
    up = _nearest_axis(trunk)
    left = _nearest_axis(across - (across @ up) * up)
    axes = conjugate(from_axes(left, up, np.cross(left, up)))
    upright = bool(unit(trunk) @ unit((hips - ankles).mean(0)) > 0.7)
    leg_length = float(bones.sum() / 2)
    if upright:
        return Rest(axes, True, _STILL, {"left": _STILL, "right": _STILL}, _FLAT_FOOT, leg_length)
    if any(name.startswith("CC_Base_") for name in motion.names):
        collars = {side: multiply(_CC_CHEST, turn) for side, turn in _CC_COLLARS.items()}
        return Rest(axes, False, _CC_CHEST, {**collars}, _FLAT_FOOT, leg_length)
    return Rest(axes, False, _STILL, {"left": None, "right": None}, _FLAT_FOOT, leg_length)


def _nearest_axis(direction: Float[Array, "3"]) -> Float[Array, "3"]:
    axis = np.zeros(3)
    largest = int(np.abs(direction).argmax())
    axis[largest] = 1.0 if direction[largest] >= 0 else -1.0
    return axis


# Character Creator's bones have frames along themselves, so its zero angles are no pose. Its chest leans back while the
# person stands; its collars' rest is what files hold that never move them.
_CC_CHEST = from_axis_angle(np.deg2rad([-12.0, 0, 0]))
_CC_COLLARS = {
    "left": from_axes(np.array([0.03, -0.98, -0.19]), np.array([0.97, 0.07, -0.25]), np.array([0.26, -0.18, 0.95])),
    "right": from_axes(np.array([0.03, 0.98, 0.19]), np.array([-0.97, 0.07, -0.25]), np.array([-0.26, -0.18, 0.95])),
}
"""Relative to the chest's frame."""
