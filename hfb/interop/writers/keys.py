"""A motion for animation formats: increasing instants, rotations without sign jumps, an even rate.

A motion of hfb has the instants of exposures: dense while the shutter is open, none while it is closed, and the same
instant twice where one exposure begins as the last one ends. Here each exposure is a cubic spline through its
sub-frames; over a closed shutter a cubic continues both sides with their velocities; over frames without the person
the body moves from one side to the other, starting and ending at rest, and is marked as absent.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from hfb.body.skeleton import PARENTS
from hfb.errors import InputError
from hfb.geometry.quaternions import align_signs
from hfb.geometry.rotations import axis_angle_to_quaternion, quaternion_to_matrix
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float, Int

_SAME_INSTANT = 0.01  # of the time between sub-frames
_ABSENT_INTERVALS = 1.5  # where openings are further apart than this many frame intervals, frames are missing
_MOST_KEYS = 240_000  # of 333,000 the text of a .bvh took 2.5 GB
_AT_ONCE = 1 << 13  # keys between which a cubic is evaluated at a time: its coefficients take far more than it does


@dataclass(frozen=True)
class MotionKeys:
    """A motion at increasing instants, in camera coordinates.

    Attributes:
        times_s: since the first shutter opened.
        quaternions: quaternions of each joint in its parent's frame (w, x, y, z), each in the hemisphere of the one
            before.
        places: positions of the joints [m].
        translations: SMPL's translation [m].
        observed: the shutter was open.
        present: the person was there, at least in frames on both sides.
    """

    times_s: Float[Array, "F"]
    quaternions: Float[Array, "F 24 4"]
    translations: Float[Array, "F 3"]
    places: Float[Array, "F 24 3"]
    observed: Bool[Array, "F"]
    present: Bool[Array, "F"]


@dataclass(frozen=True)
class _Knots:
    """Distinct instants with all interpolated values, and the exposure of each."""

    times_s: Float[Array, "M"]
    values: Float[Array, "M c"]
    slopes: Float[Array, "M c"]
    opening: Int[Array, "E"]
    closing: Int[Array, "E"]
    frames: Int[Array, "E"]


def exact_keys(motion: SampledMotion) -> MotionKeys:
    """Return the motion at its own instants; where two exposures share one, the mean of both poses.

    Args:
        motion: camera coordinates.

    Raises:
        InputError: the instants are not in order.
    """
    knots = _knots(motion)
    return _keys(knots, knots.times_s)


def even_keys(motion: SampledMotion, rate_hz: float) -> MotionKeys:
    """Return the motion at steps of 1 / rate_hz [s] from its first instant to its last.

    Args:
        motion: camera coordinates.
        rate_hz: keys per second.

    Raises:
        InputError: the instants are not in order, or so many keys that no program would open them.
    """
    knots = _knots(motion)
    first, last = float(knots.times_s[0]), float(knots.times_s[-1])
    steps = np.floor((last - first) * rate_hz + _SAME_INSTANT)
    if not steps < _MOST_KEYS:
        raise InputError(
            f"{steps:.4g} keys at {rate_hz:g} per second are too many: export csv or glb, which have the sub-frames "
            "alone, or a shorter part"
        )
    return _keys(knots, np.minimum(first + np.arange(int(steps) + 1) / rate_hz, last))


def keys_at(motion: SampledMotion, times_s: Float[Array, "F"]) -> MotionKeys:
    """Return the motion at any instants from its first to its last.

    Args:
        motion: camera coordinates.
        times_s: instants from the motion's first to its last, in order.

    Raises:
        InputError: the motion's own instants are not in order.
    """
    return _keys(_knots(motion), times_s)


def present_at(motion: SampledMotion, times_s: Float[Array, "F"]) -> Bool[Array, "F"]:
    """Return `MotionKeys.present` at any instants, without the poses.

    Args:
        motion: camera coordinates.
        times_s: instants from the motion's first to its last, in order.

    Raises:
        InputError: the motion's own instants are not in order.
    """
    present = np.ones(len(times_s), bool)
    for _, inside in _absences(_knots(motion), times_s):
        present[inside] = False
    return present


def subframe_rate_hz(motion: SampledMotion) -> float:
    """Return the sub-frames per second while the shutter is open; rounding errors are removed.

    Args:
        motion: camera coordinates.

    Raises:
        InputError: no frame has two sub-frames at different times.
    """
    steps = np.diff(motion.times_s)[np.diff(motion.frame_index) == 0]
    steps = steps[steps > 0]
    if not len(steps):
        raise InputError("the motion has fewer than two sub-frames per frame: there is nothing to animate")
    rate = 1 / float(np.median(steps))
    return float(round(rate)) if abs(rate - round(rate)) < 1e-6 * rate else rate


def rest_joints(motion: SampledMotion) -> Float[Array, "24 3"]:
    """Return the person's joints in the rest pose [m], from the motion alone.

    A bone is the same vector in its parent joint's frame at every instant, and the pelvis is at its rest position plus
    SMPL's translation.

    Args:
        motion: camera coordinates.
    """
    local = axis_angle_to_quaternion(torch.from_numpy(motion.poses).unflatten(1, (24, 3)))
    world = list(quaternion_to_matrix(local).numpy().transpose(1, 0, 2, 3))
    rest = np.zeros((24, 3))
    rest[0] = (motion.joints[:, 0] - motion.trans).mean(0)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            bone = motion.joints[:, joint] - motion.joints[:, parent]
            rest[joint] = rest[parent] + np.einsum("rji,rj->ri", world[parent], bone).mean(0)
            world[joint] = world[parent] @ world[joint]
    return rest


def turned(quaternions: Float[Array, "F 24 4"], by: Float[Array, "4"]) -> Float[Array, "F 24 4"]:
    """Return the poses in another world: the root's rotation followed by a rotation from the camera's frame to it.

    Args:
        quaternions: quaternions of each joint (w, x, y, z).
        by: rotation from the camera's frame to the other world (w, x, y, z).
    """
    w, x, y, z = by
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    result = quaternions.copy()
    result[:, 0] = quaternions[:, 0] @ left.T
    return result


def _knots(motion: SampledMotion) -> _Knots:
    times, frames = motion.times_s, motion.frame_index
    rounding = 1e-9 * max(1.0, float(np.abs(times).max(initial=0.0)))
    if len(times) < 2 or np.any(np.diff(times) < -rounding) or np.any(np.diff(frames) < 0):
        raise InputError("the motion's instants are not in order: it is damaged; make it again with `hfb fit`")
    quaternions = axis_angle_to_quaternion(torch.from_numpy(motion.poses).unflatten(1, (24, 3))).numpy()
    values = np.concatenate(
        [align_signs(quaternions).reshape(len(times), 96), motion.trans, motion.joints.reshape(len(times), 72)], 1
    )
    del quaternions
    runs, slopes = _runs(frames), np.empty_like(values)
    for rows in runs:
        slopes[rows] = _slopes(times[rows], values[rows])
    tolerance = _SAME_INSTANT / subframe_rate_hz(motion)
    new = np.concatenate([[True], np.diff(times) > tolerance])
    key = np.cumsum(new) - 1
    return _Knots(
        times[new],
        _means(values, new),
        _means(slopes, new),
        key[[run.start for run in runs]],
        key[[run.stop - 1 for run in runs]],
        frames[[run.start for run in runs]],
    )


def _means(values: Float[Array, "R c"], new: Bool[Array, "R"]) -> Float[Array, "M c"]:
    """Return the mean of every run of rows that starts at a new instant."""
    starts = np.flatnonzero(new)
    if len(starts) == len(values):
        return values
    summed = np.add.reduceat(values, starts)
    summed /= np.diff(starts, append=len(values))[:, None]
    return summed


def _runs(frames: Int[Array, "R"]) -> list[slice]:
    """Return the rows of one frame after another."""
    edges = [0, *(np.flatnonzero(np.diff(frames)) + 1).tolist(), len(frames)]
    return [slice(start, stop) for start, stop in pairwise(edges)]


def _slopes(times: Float[Array, "n"], values: Float[Array, "n c"]) -> Float[Array, "n c"]:
    """Return velocities of the cubic spline through one exposure's sub-frames."""
    if len(times) < 2 or np.any(np.diff(times) <= 0):
        return np.zeros_like(values)
    return CubicSpline(times, values, axis=0)(times, 1)


def _keys(knots: _Knots, times_s: Float[Array, "F"]) -> MotionKeys:
    values = np.empty((len(times_s), knots.values.shape[1]))
    for start in range(0, len(times_s), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        values[some] = _between(knots, times_s[some])
    opens, closes = knots.times_s[knots.opening], knots.times_s[knots.closing]
    tolerance = 1e-9 * max(1.0, float(knots.times_s[-1]))
    exposure = np.clip(np.searchsorted(opens, times_s + tolerance, side="right") - 1, 0, None)
    observed = times_s <= closes[exposure] + tolerance
    absent = np.zeros(len(times_s), bool)
    for left, inside in _absences(knots, times_s):
        share = ((times_s[inside] - closes[left]) / (opens[left + 1] - closes[left]))[:, None]
        smooth = share * share * (3 - 2 * share)
        begin, end = knots.values[knots.closing[left]], knots.values[knots.opening[left + 1]]
        values[inside] = begin + smooth * (end - begin)
        absent[inside] = True
    quaternions = values[:, :96].reshape(-1, 24, 4)
    return MotionKeys(
        times_s=times_s.copy(),
        quaternions=quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True),
        translations=values[:, 96:99].copy(),
        places=values[:, 99:].reshape(-1, 24, 3).copy(),
        observed=observed,
        present=~absent,
    )


def _between(knots: _Knots, times_s: Float[Array, "n"]) -> Float[Array, "n c"]:
    """Evaluate the cubics through the knots at increasing instants."""
    first, last = np.searchsorted(knots.times_s, times_s[[0, -1]], side="right")
    near = slice(int(np.clip(first - 1, 0, len(knots.times_s) - 2)), int(max(last, first)) + 1)
    return CubicHermiteSpline(knots.times_s[near], knots.values[near], knots.slopes[near], axis=0)(times_s)


def _absences(knots: _Knots, times_s: Float[Array, "F"]) -> Iterator[tuple[int, slice]]:
    """Yield (the exposure before it, the instants in it) of every stretch in which the person is missing."""
    opens, closes = knots.times_s[knots.opening], knots.times_s[knots.closing]
    tolerance = 1e-9 * max(1.0, float(knots.times_s[-1]))
    interval = float(np.median(np.diff(opens) / np.diff(knots.frames))) if len(opens) > 1 else np.inf
    for left in np.flatnonzero(np.diff(opens) > _ABSENT_INTERVALS * interval).tolist():
        first = int(np.searchsorted(times_s, closes[left] + tolerance, side="right"))
        yield left, slice(first, max(first, int(np.searchsorted(times_s, opens[left + 1] - tolerance))))
