"""Distance of two motions, such as a run's and its repetition's."""

from dataclasses import dataclass

import numpy as np

from hfb.motion.motion_file import motion_arrays
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float


@dataclass(frozen=True)
class MotionDifference:
    """Distances of joints in camera coordinates, nothing aligned.

    Attributes:
        bit_equal: every array of the two is the same, bit for bit.
        mean_mm: mean over joints and instants; None where the two share no frame.
        max_mm: largest distance; None where the two share no frame.
        instants_s: the shared instants [s], on the first motion's clock.
        joints_mm: distances at these instants.
    """

    bit_equal: bool
    mean_mm: float | None
    max_mm: float | None
    instants_s: Float[Array, "R"]
    joints_mm: Float[Array, "R 24"]


def motion_difference(one: SampledMotion, other: SampledMotion) -> MotionDifference:
    """Compare two motions at the first one's instants, in the frames that both have.

    A motion with other sub-frames is interpolated linearly within each frame's exposure; both clocks run from the
    opening of a frame's shutter to its end.

    Args:
        one: the motion whose instants are used.
        other: the motion that is compared with it.
    """
    frames = [int(frame) for frame in np.intersect1d(one.frame_index, other.frame_index)]
    chosen = np.concatenate([one.rows_of(frame) for frame in frames] or [np.zeros(0, np.int64)])
    theirs = np.concatenate([_beside(one, other, frame) for frame in frames] or [np.zeros((0, 24, 3))])
    distances = 1000 * np.linalg.norm(one.joints[chosen].astype(np.float64) - theirs, axis=-1)
    return MotionDifference(
        bit_equal=_same(one, other),
        mean_mm=float(distances.mean()) if distances.size else None,
        max_mm=float(distances.max()) if distances.size else None,
        instants_s=one.times_s[chosen].astype(np.float64),
        joints_mm=distances,
    )


def _beside(one: SampledMotion, other: SampledMotion, frame: int) -> Float[Array, "S 24 3"]:
    """Return the other motion's joints at one motion's instants of a frame."""
    mine, theirs = one.rows_of(frame), other.rows_of(frame)
    joints = other.joints[theirs].astype(np.float64)
    if len(mine) == len(theirs):
        return joints
    wanted, known = _shares(one.times_s[mine]), _shares(other.times_s[theirs])
    flat = joints.reshape(len(theirs), -1)
    return np.stack([np.interp(wanted, known, column) for column in flat.T], 1).reshape(len(mine), *joints.shape[1:])


def _shares(times_s: Float[Array, "S"]) -> Float[Array, "S"]:
    """Return u in [0, 1] over the exposure."""
    length_s = times_s[-1] - times_s[0]
    return (times_s - times_s[0]) / length_s if length_s > 0 else np.zeros(len(times_s))


def _same(one: SampledMotion, other: SampledMotion) -> bool:
    """Return whether two motions are equal bit for bit: the sign of a zero counts, and NaN equals NaN."""
    mine, theirs = motion_arrays(one, ""), motion_arrays(other, "")
    return mine.keys() == theirs.keys() and all(
        mine[name].shape == theirs[name].shape
        and mine[name].dtype == theirs[name].dtype
        and mine[name].tobytes() == theirs[name].tobytes()
        for name in mine
    )
