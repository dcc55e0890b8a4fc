"""Retargeting of a foreign skeleton's motion to SMPL's skeleton.

The directions of the limbs' bones are kept exactly; trunk, head, collars and feet keep their rotations relative to the
skeleton's rest pose. The rotation of an arm or a leg about its own bone follows from the plane in which elbow or knee
bend: these are hinges, whatever axes the foreign skeleton's frames have (see `Limb`).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.motions.files.bvh import BvhMotion
from hfb.datasets.motions.skeletons.joint_names import JointMap, map_joints
from hfb.datasets.motions.skeletons.kinematics import rest_joints, to_local
from hfb.datasets.motions.skeletons.limbs import Limb, align_frame
from hfb.datasets.motions.skeletons.plausibility import without_impossible_ends
from hfb.datasets.motions.skeletons.rest_pose import Rest, find_rest
from hfb.errors import InputError
from hfb.geometry.quaternions import (
    between,
    conjugate,
    from_axis_angle,
    multiply,
    rotate,
    share_of,
    to_axis_angle,
    unit,
)
from hfb.typing import Array, Float

_J = {name: number for number, name in enumerate(JOINT_NAMES)}
_SIDES = ("left", "right")
_FORWARD = np.array([0, 0, 1.0])
_FLEXION = {
    "left_hip": np.array([1.0, 0, 0]),
    "right_hip": np.array([1.0, 0, 0]),
    "left_shoulder": np.array([0, -1.0, 0]),
    "right_shoulder": np.array([0, 1.0, 0]),
}
"""Axes about which SMPL's knees and elbows bend, at rest."""
_AT_ELBOW = 0.6
_MOST_PRONATION = np.deg2rad(110)
_WRIST = np.deg2rad([[-5, -25, -60], [5, 35, 60]])
"""Smallest and largest angles of a left wrist about SMPL's axes; see `hfb.priors.anatomy`."""


@dataclass(frozen=True)
class _Source:
    """The recording in SMPL's axes: world rotation and position of every joint."""

    motion: BvhMotion
    joints: JointMap
    rest: Rest
    frames: Float[Array, "F N 4"]
    places: Float[Array, "F N 3"]

    def since_rest(self, joint: int) -> Float[Array, "F 4"]:
        """Return how a joint has turned since the rest pose, where all its angles are zero."""
        return multiply(self.frames[:, joint], conjugate(self.rest.axes))

    def part(self, name: str) -> Float[Array, "F 4"]:
        """Return world rotation of pelvis, chest or head."""
        return multiply(self.frames[:, getattr(self.joints, name)], self.rest.trunk[name])


class Retargeted(NamedTuple):
    """Poses (axis-angle [rad], y up) and translations [m], with remarks for the user."""

    poses: Float[Array, "F 24 3"]
    translations: Float[Array, "F 3"]
    remarks: tuple[str, ...]


def retarget(motion: BvhMotion) -> Retargeted:
    """Retarget a motion to a person with the embedded body's rest joints.

    Lengths are scaled by the ratio of the legs, so that standing feet do not slide.

    Args:
        motion: motion of the foreign skeleton.

    Raises:
        InputError: a person's joints are not all there, have no length between them, or are turned as no person's;
            or what is up cannot be told.
    """
    joints = map_joints(motion.names, motion.parents)
    rest = find_rest(motion, joints)
    rotations, places = motion.world()
    source = _Source(motion, joints, rest, multiply(rest.world, rotations), rotate(rest.world, places))
    world = np.zeros((len(places), len(JOINT_NAMES), 4))
    _set_trunk(world, source)
    backwards = [_set_leg(world, source, side) for side in _SIDES]
    if all(backwards):
        raise InputError(
            "both of its knees bend backwards: left and right are exchanged, or the motion is mirrored; export it "
            "again, or rename its joints"
        )
    for side in _SIDES:
        _set_arm(world, source, side)
        world[:, _J[f"{side}_hand"]] = world[:, _J[f"{side}_wrist"]]
        world[:, _J[f"{side}_foot"]] = world[:, _J[f"{side}_ankle"]]
    poses, ends = without_impossible_ends(to_axis_angle(to_local(world)))
    if ends:
        left_out = f"{', '.join(ends)}: turned as no person can in most frames, left at rest"
        rest = replace(rest, remarks=(*rest.remarks, left_out))
    return Retargeted(poses, _translations(world[:, 0], source), rest.remarks)


def _set_trunk(world: Float[Array, "F 24 4"], source: _Source) -> None:
    """Set pelvis, chest, collars and head; the joints between share the bend evenly."""
    pelvis, chest, head = (source.part(name) for name in ("pelvis", "chest", "head"))
    bend, nod = multiply(conjugate(pelvis), chest), multiply(conjugate(chest), head)
    world[:, _J["pelvis"]], world[:, _J["spine3"]], world[:, _J["head"]] = pelvis, chest, head
    world[:, _J["spine1"]] = multiply(pelvis, share_of(bend, 1 / 3))
    world[:, _J["spine2"]] = multiply(pelvis, share_of(bend, 2 / 3))
    world[:, _J["neck"]] = multiply(chest, share_of(nod, 1 / 2))
    for side in _SIDES:
        joint, at_rest = source.joints.collars[side], source.rest.collars[side]
        if joint is None or at_rest is None:
            world[:, _J[f"{side}_collar"]] = chest
        else:
            world[:, _J[f"{side}_collar"]] = multiply(source.since_rest(joint), conjugate(at_rest))


@dataclass(frozen=True)
class _Turned:
    """World rotations of a limb's upper and lower joint, its hinge, and the correction about the upper bone."""

    upper: Float[Array, "F 4"]
    lower: Float[Array, "F 4"]
    hinge: Float[Array, "F 3"]
    repair: Float[Array, "F 4"] | None


def _turn_limb(source: _Source, side: str, parts: tuple[str, str, str], away: Float[Array, "F 3"]) -> _Turned:
    """Set both bones' directions as recorded; bends towards `away` where neither bends nor rest pose determine it."""
    names = [f"{side}_{part}" for part in parts]
    joints = [source.joints.limbs[name] for name in names]
    start, middle, end = (source.places[:, joint] for joint in joints)
    limb = Limb(unit(middle - start), unit(end - middle), source.frames[:, joints[0]], source.motion.fps)
    rest = [rest_joints()[_J[name]] for name in names]
    flexion, repair = _FLEXION[names[0]], None
    if source.rest.upright:
        bone = np.subtract(*source.motion.rest()[[joints[1], joints[0]]])
        at_rest = rotate(between(unit(rest[1] - rest[0]), unit(rotate(source.rest.axes, bone))), flexion)
        expected = rotate(source.since_rest(joints[0]), at_rest)
        if limb.bends_backward(expected):
            limb, repair = limb.turned_round(), from_axis_angle(np.pi * limb.upper)
    else:
        expected = np.cross(limb.upper, away)
    hinge = limb.hinge(expected)
    upper = align_frame(limb.upper, hinge, rest[1] - rest[0], flexion)
    return _Turned(upper, align_frame(limb.lower, hinge, rest[2] - rest[1], flexion), hinge, repair)


def _set_leg(world: Float[Array, "F 24 4"], source: _Source, side: str) -> bool:
    """Set a leg's rotations; return whether the knee bent backwards and was turned round."""
    leg = _turn_limb(source, side, ("hip", "knee", "ankle"), rotate(world[:, 0], -_FORWARD))
    world[:, _J[f"{side}_hip"]], world[:, _J[f"{side}_knee"]] = leg.upper, leg.lower
    ankle, toe = source.joints.limbs[f"{side}_ankle"], source.joints.toes[side]
    if source.rest.upright:
        world[:, _J[f"{side}_ankle"]] = source.since_rest(ankle)  # both stand flat on the ground at rest
        return leg.repair is not None
    tip = source.motion.ends[ankle] if toe is None else source.motion.offsets[toe]
    foot = source.rest.foot
    toes = rotate(source.frames[:, ankle], unit(tip)) if np.linalg.norm(tip) > 0 else rotate(leg.lower, foot)
    world[:, _J[f"{side}_ankle"]] = align_frame(toes, leg.hinge, foot, _FLEXION[f"{side}_hip"])
    return False


def _set_arm(world: Float[Array, "F 24 4"], source: _Source, side: str) -> None:
    forward = rotate(world[:, _J["spine3"]], _FORWARD)
    arm = _turn_limb(source, side, ("shoulder", "elbow", "wrist"), forward)
    elbow, wrist = (source.joints.limbs[f"{side}_{part}"] for part in ("elbow", "wrist"))
    along = unit(rest_joints()[_J[f"{side}_wrist"]] - rest_joints()[_J[f"{side}_elbow"]])
    if source.rest.upright:
        ends, offsets = source.motion.ends, source.motion.offsets
        tip = ends[wrist] if np.linalg.norm(ends[wrist]) > 0 else offsets[wrist]
        hand = multiply(source.since_rest(wrist), between(along, unit(rotate(source.rest.axes, tip))))
        hand = hand if arm.repair is None else multiply(arm.repair, hand)
    else:  # forearm and hand lie nearly in one line at rest, so that their frames are alike there
        hand = multiply(multiply(source.frames[:, wrist], conjugate(source.frames[:, elbow])), arm.lower)
    # SMPL's forearm is one bone: most of the hand's turn about it happens at the elbow.
    twist, swing = _pronation(multiply(conjugate(arm.lower), hand), along, 1.0 if side == "left" else -1.0)
    world[:, _J[f"{side}_shoulder"]] = arm.upper
    world[:, _J[f"{side}_elbow"]] = multiply(arm.lower, from_axis_angle(_AT_ELBOW * twist[:, None] * along))
    hand = multiply(from_axis_angle(swing), from_axis_angle(twist[:, None] * along))
    world[:, _J[f"{side}_wrist"]] = multiply(arm.lower, hand)


def _pronation(
    turn: Float[Array, "F 4"], along: Float[Array, "3"], sign: float
) -> tuple[Float[Array, "F"], Float[Array, "F 3"]]:
    """Return a hand's turn against the forearm: about it [rad], then across it (a rotation vector).

    Both are limited to a hand's range: larger values are errors of the recording (often of half a turn) that the arm's
    bones do not show.
    """
    twist = np.unwrap(2 * np.arctan2((turn[:, 1:] * along).sum(-1), turn[:, 0]))
    swing = to_axis_angle(multiply(turn, from_axis_angle(-twist[:, None] * along)))
    twist = twist - np.pi * np.rint(np.median(twist) / np.pi)
    mirror = np.array([1.0, sign, sign])
    swing = mirror * np.clip(mirror * swing, *_WRIST)
    return np.clip(twist, -_MOST_PRONATION, _MOST_PRONATION), swing


def _translations(pelvis: Float[Array, "F 4"], source: _Source) -> Float[Array, "F 3"]:
    """Return SMPL's translation that brings the middle between the hips to where it is in the recording."""
    rest = rest_joints()
    hips = [_J[f"{side}_hip"] for side in _SIDES]
    knees, ankles = ([_J[f"{side}_{part}"] for side in _SIDES] for part in ("knee", "ankle"))
    bones = np.linalg.norm([*(rest[knees] - rest[hips]), *(rest[ankles] - rest[knees])], axis=-1)
    scale = bones.sum() / 2 / source.rest.leg_length
    middle = source.places[:, [source.joints.limbs[f"{side}_hip"] for side in _SIDES]].mean(1)
    return scale * middle - rest[0] - rotate(pelvis, rest[hips].mean(0) - rest[0])
