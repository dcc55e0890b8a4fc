"""Resampling of a recorded motion: a blurred frame needs more instants than a recording has."""

import numpy as np

from hfb.datasets.motions.motion_clip import MotionClip
from hfb.geometry.quaternions import align_signs, from_axis_angle, to_axis_angle
from hfb.typing import Array, Float

_FAST = 0.9
"""Frames whose quaternions' product with the next one's is below this turn by 52 degrees or more: too far to tell how
fast, as a jump of the recording is."""

_ROUNDING_S = 1e-9

_FASTEST_RAD_S = 55.0
"""3150 degrees per second: kicks and runs in recordings stay below 2700, a pitcher's forearm alone turns faster."""

_FASTEST_M_S = 20.0
"""Sprinters reach 12.5 m/s; takes that were joined or looped leap to another place in one frame."""


def resample(clip: MotionClip, times_s: Float[Array, "S"]) -> tuple[Float[Array, "S 24 3"], Float[Array, "S 3"]]:
    """Return joint rotations (axis-angle [rad], angles in [0, pi]) and translations [m] at the given instants.

    Catmull-Rom splines (Catmull & Rom, A Class of Local Interpolating Splines, 1974): through the clip's own frames,
    with a continuous velocity. Rotations are interpolated as quaternions of one hemisphere and normalised.

    Args:
        clip: the recorded motion.
        times_s: seconds from the clip's first frame, in any order, within [0, (F - 1) / fps].

    Raises:
        ValueError: an instant lies outside the clip.
    """
    last = len(clip.poses) - 1
    at = times_s * clip.fps
    tolerance = _ROUNDING_S * clip.fps
    if last < 1 or not np.all((at >= -tolerance) & (at <= last + tolerance)):
        raise ValueError(
            f"motion {clip.name!r} lasts {last / clip.fps:.3f} s and is asked for instants outside of it "
            f"({times_s.min():.3f} to {times_s.max():.3f} s)"
        )
    at = np.clip(at, 0, last)
    nearest = np.rint(at)
    at = np.where(np.abs(at - nearest) < 1e-6, nearest, at)  # a frame's own instant gives that frame, to the bit
    left = np.minimum(at.astype(np.int64), last - 1)
    first, end = max(int(left.min()) - 1, 0), min(int(left.max()) + 3, last + 1)
    quaternions = align_signs(from_axis_angle(clip.poses[first:end].astype(np.float64)))
    step = (quaternions[1:] * quaternions[:-1]).sum(-1, keepdims=True)
    rotations = _spline(quaternions, step >= _FAST, left - first, at - left)
    translations = clip.translations[first:end].astype(np.float64)
    return to_axis_angle(rotations), _spline(translations, np.ones((len(step), 1), bool), left - first, at - left)


def _spline(
    values: Float[Array, "W *n c"], slow: np.ndarray, left: np.ndarray, share: Float[Array, "S"]
) -> Float[Array, "S *n c"]:
    """Evaluate a cubic Hermite spline with velocities of parabolas through neighbours, zero beside a sudden step."""
    steps = np.diff(values, axis=0)
    turns = np.diff(steps, axis=0) / 2 if len(steps) > 1 else np.zeros_like(steps)
    velocities = np.concatenate([steps[:1] - turns[:1], steps[:-1] + turns[: len(steps) - 1], steps[-1:] + turns[-1:]])
    calm = np.concatenate([slow[:1], slow[1:] & slow[:-1], slow[-1:]])
    velocities = velocities * calm
    u = share.reshape(-1, *[1] * (values.ndim - 1))
    start, finish, leaving, arriving = values[left], values[left + 1], velocities[left], velocities[left + 1]
    smooth = u * u * (3 - 2 * u)
    return start + smooth * (finish - start) + u * (1 - u) * ((1 - u) * leaving - u * arriving)


def has_jump(clip: MotionClip, start_s: float, end_s: float) -> bool:
    """Return whether a joint turns, or the person moves, from one frame to the next faster than a person can.

    Published conversions have limbs that turn by half a turn within a frame; such a window shows no motion but an error
    of the recording.

    Args:
        clip: the recorded motion.
        start_s: start of the window, seconds from the clip's first frame.
        end_s: end of the window, likewise.
    """
    first = max(int(np.floor(start_s * clip.fps)), 0)
    rows = slice(first, int(np.ceil(end_s * clip.fps)) + 1)
    quaternions = from_axis_angle(clip.poses[rows].astype(np.float64))
    cosine = np.abs((quaternions[1:] * quaternions[:-1]).sum(-1)).min(initial=1.0)
    fastest = 2 * np.arccos(min(float(cosine), 1.0)) * clip.fps
    moved_m = np.linalg.norm(np.diff(clip.translations[rows].astype(np.float64), axis=0), axis=-1).max(initial=0.0)
    return bool(fastest > _FASTEST_RAD_S or moved_m * clip.fps > _FASTEST_M_S)
