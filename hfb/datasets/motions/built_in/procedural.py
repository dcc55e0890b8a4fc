"""Motions that need no file: seeded walks, runs, jumps, kicks, throws and dances from key poses."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.motions.built_in.gestures import (
    CHANNELS,
    GESTURES,
    LEG_CHANNELS,
    LIMB_COUNT,
    RANGES,
    SIDED,
    STANDING,
    TRUNK_COUNT,
    Gesture,
)
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.skeletons.kinematics import joint_positions, rest_joints, to_world
from hfb.geometry.quaternions import from_axis_angle, multiply, to_axis_angle
from hfb.typing import Array, Float

FPS = 120.0
_ROUNDS = 2
"""Number of appearances of each gesture, with different tempo, size, side and small deviations."""
_MIXED = 12
"""Clips that take the legs of one gesture and the arms and trunk of another."""

_SMOOTHING_S = 0.02
_KEY_NOISE_DEG = 3.5
_SOFT_DEG = 4.0
_FEET = tuple(JOINT_NAMES.index(name) for name in ("left_ankle", "right_ankle", "left_foot", "right_foot"))
_SOLE_M = (0.07, 0.07, 0.02, 0.02)
"""Distance of the sole below each of these joints."""
_CONTACT_M = 0.015


class ProceduralMotions:
    """A `MotionSource` whose clips are functions of the seed and their number alone.

    Args:
        seed: seed of all clips.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed

    @cached_property
    def _plans(self) -> list[tuple[str, Gesture, Gesture | None]]:
        rng = np.random.default_rng(np.random.SeedSequence([self._seed, len(GESTURES)]))
        plans: list[tuple[str, Gesture, Gesture | None]] = []
        for _ in range(_ROUNDS):
            plans += [(gesture.name, gesture, None) for gesture in GESTURES]
        for _ in range(_MIXED):
            legs, arms = (GESTURES[i] for i in rng.choice(len(GESTURES), 2, replace=False))
            plans.append((f"{legs.name} with {arms.name}", legs, arms))
        return [(f"{number:03d} {name}", legs, arms) for number, (name, legs, arms) in enumerate(plans)]

    def names(self) -> Sequence[str]:
        """Return the gesture of every clip, with its number."""
        return [name for name, _, _ in self._plans]

    def load(self, index: int) -> MotionClip:
        """Make one motion: 2.2 to 4 s at 120 frames per second.

        Args:
            index: number of the motion in `names`.
        """
        name, legs, arms = self._plans[index]
        rng = np.random.default_rng(np.random.SeedSequence([self._seed, index]))
        times_s = np.arange(int(rng.uniform(2.2, 4.0) * FPS)) / FPS
        angles = _perform(legs, times_s, rng)
        if arms is not None:
            with_arms = _perform(arms, times_s, rng)
            with_arms[:, LEG_CHANNELS] = angles[:, LEG_CHANNELS]
            angles = with_arms
        angles = _within_ranges(gaussian_filter1d(angles, _SMOOTHING_S * FPS, axis=0, mode="nearest"))
        angles[:, CHANNELS.index("yaw")] += rng.uniform(0, 360)
        local = _rotations(angles)
        translations = _travel(local, angles[:, CHANNELS.index("hop")])
        return MotionClip(name, to_axis_angle(local), translations, FPS)


def _perform(gesture: Gesture, times_s: Float[Array, "F"], rng: np.random.Generator) -> Float[Array, "F 30"]:
    """Repeat the gesture: every key pose varies a little, with a random tempo and size."""
    seconds = gesture.seconds / rng.uniform(0.9, 1.3)
    size = rng.uniform(0.85, 1.1)
    start = rng.uniform(0, seconds)
    side = rng.random() < 0.5
    keys = [(share, _pose(changes, size)) for share, changes in gesture.keys]
    if gesture.mirrored:
        keys += [(share, _mirror(pose)) for share, pose in keys]
    shares = np.array([share for share, _ in keys])
    cycles = int((times_s[-1] + start) / seconds) + 2
    durations = np.tile(shares / shares.sum() * seconds, cycles) * rng.uniform(0.93, 1.07, len(keys) * cycles)
    poses = np.tile(np.stack([pose for _, pose in keys]), (cycles, 1))
    moving = np.ones(len(CHANNELS))
    moving[CHANNELS.index("hop")] = 0
    poses = poses + moving * rng.normal(0, _KEY_NOISE_DEG, poses.shape)
    poses[:, CHANNELS.index("yaw")] += gesture.turning / len(keys) * np.arange(len(poses))
    at_s = np.concatenate([[0], np.cumsum(durations)[:-1]])
    angles = PchipInterpolator(at_s, poses, axis=0)(np.minimum(times_s + start, at_s[-1]))
    return _mirror(angles) if side else angles


def _pose(changes: dict[str, float], size: float) -> Float[Array, "30"]:
    values = dict.fromkeys(CHANNELS, 0.0) | STANDING
    pose = {name: standing + size * (changes.get(name, standing) - standing) for name, standing in values.items()}
    return np.array([pose[name] for name in CHANNELS])


def _mirror(angles: Float[Array, "*n 30"]) -> Float[Array, "*n 30"]:
    """Exchange left and right."""
    mirrored = angles.copy()
    mirrored[..., SIDED] *= -1
    left = slice(TRUNK_COUNT, TRUNK_COUNT + LIMB_COUNT)
    right = slice(TRUNK_COUNT + LIMB_COUNT, TRUNK_COUNT + 2 * LIMB_COUNT)
    mirrored[..., left], mirrored[..., right] = angles[..., right], angles[..., left]
    return mirrored


def _within_ranges(angles: Float[Array, "F 30"]) -> Float[Array, "F 30"]:
    """Limit angles smoothly to every joint's range: unchanged well inside, never beyond."""
    low, high = np.array([RANGES[name.removeprefix("l_").removeprefix("r_")] for name in CHANNELS]).T
    soft = np.where(np.array(CHANNELS) == "hop", 1e-3, _SOFT_DEG)
    above = low + soft * np.logaddexp(0, (angles - low) / soft)
    return high - soft * np.logaddexp(0, (high - above) / soft)


def _turn(axis: str, degrees: Float[Array, "F"]) -> Float[Array, "F 4"]:
    rotation = np.zeros((len(degrees), 3))
    rotation[:, "xyz".index(axis)] = np.deg2rad(degrees)
    return from_axis_angle(rotation)


def _chain(*turns: Float[Array, "F 4"]) -> Float[Array, "F 4"]:
    total = turns[0]
    for turn in turns[1:]:
        total = multiply(total, turn)
    return total


def _rotations(angles: Float[Array, "F 30"]) -> Float[Array, "F 24 4"]:
    """Convert anatomical angles to SMPL's joint rotations (see the signs in `hfb.priors.anatomy`)."""
    word = {name: angles[:, column] for column, name in enumerate(CHANNELS)}
    local = np.zeros((len(angles), len(JOINT_NAMES), 4))
    local[..., 0] = 1
    joint = {name: index for index, name in enumerate(JOINT_NAMES)}
    local[:, 0] = _chain(_turn("y", word["yaw"]), _turn("x", word["pitch"]), _turn("z", -word["roll"]))
    for name in ("spine1", "spine2", "spine3"):
        bend, lean, twist = (word[part] / 3 for part in ("bend", "lean", "twist"))
        local[:, joint[name]] = _chain(_turn("x", bend), _turn("z", -lean), _turn("y", twist))
    for name in ("neck", "head"):
        nod, tilt, look = (word[part] / 2 for part in ("nod", "tilt", "look"))
        local[:, joint[name]] = _chain(_turn("x", nod), _turn("z", -tilt), _turn("y", look))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        part = {name: word[f"{side[0]}_{name}"] for name in ("hip", "out", "turn", "knee", "toes")}
        local[:, joint[f"{side}_hip"]] = _chain(
            _turn("x", -part["hip"]), _turn("z", sign * part["out"]), _turn("y", sign * part["turn"])
        )
        local[:, joint[f"{side}_knee"]] = _turn("x", part["knee"])
        local[:, joint[f"{side}_ankle"]] = _turn("x", -part["toes"])
        part = {name: word[f"{side[0]}_{name}"] for name in ("arm", "wide", "spin", "elbow", "palm")}
        # An arm above the horizontal is raised by the shoulder blade too, a third of the way.
        raised = np.maximum(0, np.maximum(part["wide"], part["arm"]) - 70) / 3
        local[:, joint[f"{side}_collar"]] = _turn("z", sign * np.minimum(raised, 30))
        sideways = part["wide"] - np.minimum(raised, 30) * (part["wide"] > part["arm"])
        local[:, joint[f"{side}_shoulder"]] = _chain(
            _turn("x", -part["arm"]), _turn("z", sign * (sideways - 90)), _turn("x", -part["spin"])
        )
        local[:, joint[f"{side}_elbow"]] = _chain(_turn("y", -sign * part["elbow"]), _turn("x", -part["palm"]))
    return local


def _travel(local: Float[Array, "F 24 4"], hop_m: Float[Array, "F"]) -> Float[Array, "F 3"]:
    """Return the body's translation: the lowest foot is on the ground except in hops, and stays where it stands."""
    rest = rest_joints()
    world = to_world(local)
    joints = joint_positions(world, np.zeros((len(local), 3)), rest)
    feet = joints[:, _FEET] - np.array(_SOLE_M)[:, None] * np.array([0, 1.0, 0])
    lowest = feet[..., 1].min(1, keepdims=True)
    share = np.exp((lowest - feet[..., 1]) / _CONTACT_M)
    share = share / share.sum(1, keepdims=True)
    height = (share * feet[..., 1]).sum(1)
    velocity = np.gradient(feet, axis=0) * share[..., None]
    steps = -gaussian_filter1d(velocity.sum(1), _SMOOTHING_S * FPS, axis=0, mode="nearest")
    path = np.cumsum(steps, axis=0)
    path[:, 1] = gaussian_filter1d(hop_m - height, _SMOOTHING_S * FPS, mode="nearest")
    path[:, [0, 2]] -= path[0, [0, 2]]
    return path
