"""The rest pose of a foreign skeleton and its axes."""

from dataclasses import dataclass

import numpy as np

from hfb.datasets.motions.files.bvh import BvhMotion
from hfb.datasets.motions.skeletons.joint_names import JointMap
from hfb.datasets.motions.skeletons.trunk_frames import trunk_offsets
from hfb.datasets.motions.skeletons.world_axes import find_up
from hfb.errors import InputError
from hfb.geometry.quaternions import between, conjugate, from_axes, from_axis_angle, multiply, rotate, unit
from hfb.typing import Array, Float

_STILL = np.array([1.0, 0, 0, 0])
_FLAT_FOOT = np.array([0, -np.sin(np.deg2rad(13.5)), np.cos(np.deg2rad(13.5))])
"""Direction of Character Creator's feet while they stand; used where the rest pose does not determine it."""


@dataclass(frozen=True)
class Rest:
    """Facts about a skeleton's rest pose, in SMPL's axes (x to the person's left, y up, z forward).

    Attributes:
        axes: rotation from the rest pose's axes to SMPL's.
        world: rotation from the file's world to one with y up.
        upright: whether all angles zero make an upright person, so that every joint's frame is the world's there.
        trunk: rotations from SMPL's axes to the frames of `pelvis`, `chest` and `head`.
        collars: rotation of each collar's frame at rest; None where it is not known.
        foot: direction from ankle to toes of a foot that is flat on the ground.
        leg_length: length of thigh and shin together, in the file's unit.
        remarks: remarks for the user about the file.
    """

    axes: Float[Array, "4"]
    world: Float[Array, "4"]
    upright: bool
    trunk: dict[str, Float[Array, "4"]]
    collars: dict[str, Float[Array, "4"] | None]
    foot: Float[Array, "3"]
    leg_length: float
    remarks: tuple[str, ...] = ()


def find_rest(motion: BvhMotion, joints: JointMap) -> Rest:
    """Derive the rest pose from the offsets, and from the motion where the offsets are not enough.

    Args:
        motion: motion of the foreign skeleton.
        joints: numbers of a person's joints in it.

    Raises:
        InputError: legs have no length, or the vertical axis is undetermined.
    """
    turned, moved = motion.world()
    hips, knees, ankles = _legs(moved, joints)
    bones = np.median(np.linalg.norm([*(knees - hips), *(ankles - knees)], axis=-1), axis=-1)
    if bones.min() < 1e-6 or np.median(np.linalg.norm(moved[:, joints.head] - hips.mean(0), axis=-1)) < 1e-6:
        raise InputError("its legs or trunk have no length")
    leg_length = float(bones.sum() / 2)
    places = motion.rest()
    hips, _, ankles = _legs(places, joints)
    trunk, across = places[joints.head] - hips.mean(0), hips[0] - hips[1]
    # Skeletons are set up along the axes: the nearest ones are used.
    up = _nearest_axis(trunk)
    sideways = across - (across @ up) * up
    shown = bool(min(np.linalg.norm(trunk), np.linalg.norm(sideways)) > 1e-3 * leg_length)
    left = _nearest_axis(sideways) if shown else _nearest_axis(np.roll(up, 1))
    axes = conjugate(from_axes(left, up, np.cross(left, up)))
    upright = shown and bool(unit(trunk) @ unit((hips - ankles).mean(0)) > 0.7)
    above = find_up(moved, joints, up, upright)
    world = multiply(between(rotate(axes, above), np.array([0.0, 1.0, 0.0])), axes)
    chest, collars = _STILL, {"left": _STILL if upright else None, "right": _STILL if upright else None}
    known = not upright and any(name.startswith("CC_Base_") for name in motion.names)
    if known:
        chest = _CC_CHEST
        collars = {side: multiply(_CC_CHEST, turn) for side, turn in _CC_COLLARS.items()}
    still = conjugate(axes)
    at_rest = {"pelvis": still, "chest": multiply(still, conjugate(chest)), "head": still} if shown else {}
    offsets, corrected = trunk_offsets(multiply(world, turned), rotate(world, moved), joints, at_rest, upright or known)
    remarks = []
    if above @ up < 0.5:
        remarks.append("up in its world is not up in its rest pose: taken is where the person stands")
    if corrected:
        remarks.append(f"its rest pose does not tell how it turns {', '.join(corrected)}: taken from the motion")
        if "chest" in corrected:
            collars = {"left": None, "right": None}
    return Rest(axes, world, upright, offsets, collars, _FLAT_FOOT, leg_length, tuple(remarks))


def _legs(places: Float[Array, "*n N 3"], joints: JointMap) -> tuple[Float[Array, "2 *n 3"], ...]:
    """Return hips, knees and ankles, left and right."""
    parts = [[joints.limbs[f"{side}_{part}"] for side in ("left", "right")] for part in ("hip", "knee", "ankle")]
    return tuple(np.stack([places[..., joint, :] for joint in part]) for part in parts)


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
