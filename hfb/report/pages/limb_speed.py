"""Top speed of each limb during the exposure, its interval, and the length of its motion blur.

The interval is calibrated, not derived: on synthetic cases with known truth the error of a limb's top speed scales
with the joint's radius over the exposure's length. `hfb train limb-speeds` fits the factors that contain 80 % of the
true speeds.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hfb.motion.sampled import SampledMotion
from hfb.report.pages.page import page_file
from hfb.typing import Array, Float

LIMB_ENDS: Mapping[str, int] = {
    "left wrist": 20,
    "right wrist": 21,
    "left ankle": 7,
    "right ankle": 8,
    "head": 15,
    "whole body": 0,
}
"""Joint that represents each limb; the pelvis represents the whole body."""

SHUTTER_SPEEDS = (30, 60, 125, 250, 500, 1000, 2000, 4000, 8000)
"""Common exposures of cameras, as denominators [1/s]."""

_ROUNDING = 1 + 1e-9


@dataclass(frozen=True)
class LimbSpeed:
    """The fastest moment of a limb.

    Attributes:
        peak_m_s: its highest speed, in camera coordinates.
        interval_m_s: contains 80 % of true speeds; None where the fit gives no joint radius.
        peak_s: time of the highest speed.
        frame: number of the frame at that time.
        mean_m_s: mean speed over all exposures.
        smear_px: longest path in the image during one exposure.
        smear_frame: number of that exposure's frame.
        peak_px_s: highest speed in the image.
    """

    limb: str
    peak_m_s: float
    interval_m_s: tuple[float, float] | None
    peak_s: float
    frame: int
    mean_m_s: float
    smear_px: float
    smear_frame: int
    peak_px_s: float


def limb_speeds(motion: SampledMotion) -> list[LimbSpeed]:
    """Return the speed of every limb; empty where no frame has two instants.

    Args:
        motion: fitted motion.
    """
    times, speeds, frames = instant_speeds(motion)
    return [_speed_of(motion, limb, times, speeds[:, at], frames) for at, limb in enumerate(LIMB_ENDS) if len(times)]


def instant_speeds(motion: SampledMotion) -> tuple[Float[Array, "M"], Float[Array, "M 6"], Float[Array, "M"]]:
    """Return (times [s], speeds [m/s] of `LIMB_ENDS`, frames) between neighbouring sub-frames of one exposure.

    Args:
        motion: fitted motion.
    """
    rows = np.flatnonzero((np.diff(motion.frame_index) == 0) & (np.diff(motion.times_s) > 0))
    ends = motion.joints[:, list(LIMB_ENDS.values())]
    steps = motion.times_s[rows + 1] - motion.times_s[rows]
    speeds = np.linalg.norm(ends[rows + 1] - ends[rows], axis=-1) / steps[:, None]
    middle = (motion.times_s[rows + 1] + motion.times_s[rows]) / 2
    return middle, speeds, motion.frame_index[rows].astype(np.float64)


def shutter_for(peak_px_s: float, allowed_px: float) -> int | None:
    """Return n of the longest common exposure 1/n s that limits motion blur; None where none is short enough.

    Args:
        peak_px_s: highest speed in the image.
        allowed_px: longest acceptable motion blur.
    """
    return next((speed for speed in SHUTTER_SPEEDS if peak_px_s <= allowed_px * speed * _ROUNDING), None)


def exposure_s(motion: SampledMotion) -> float:
    """Return the median exposure of the motion's frames [s].

    Args:
        motion: fitted motion.
    """
    spans = [float(np.ptp(motion.times_s[motion.rows_of(frame)])) for frame in np.unique(motion.frame_index).tolist()]
    return float(np.median(spans))


def _speed_of(
    motion: SampledMotion, limb: str, times: Float[Array, "M"], speeds: Float[Array, "M"], frames: Float[Array, "M"]
) -> LimbSpeed:
    joint = LIMB_ENDS[limb]
    fastest = int(speeds.argmax())
    frame = int(frames[fastest])
    rows = np.flatnonzero((np.diff(motion.frame_index) == 0) & (np.diff(motion.times_s) > 0))
    seen = motion.joints[:, joint] @ motion.K.T
    pixels = seen[:, :2] / np.maximum(seen[:, 2:], 1e-6)
    steps_px = np.linalg.norm(pixels[rows + 1] - pixels[rows], axis=-1)
    travelled = np.bincount(motion.frame_index[rows], weights=steps_px)
    return LimbSpeed(
        limb=limb,
        peak_m_s=float(speeds[fastest]),
        interval_m_s=_interval(motion, joint, frame, float(speeds[fastest])),
        peak_s=float(times[fastest]),
        frame=frame,
        mean_m_s=float(speeds.mean()),
        smear_px=float(travelled.max()),
        smear_frame=int(travelled.argmax()),
        peak_px_s=float((steps_px / (motion.times_s[rows + 1] - motion.times_s[rows])).max()),
    )


def _interval(motion: SampledMotion, joint: int, frame: int, peak_m_s: float) -> tuple[float, float] | None:
    """Return the interval of 80 % of true top speeds."""
    rows = motion.rows_of(frame)
    scale = sureness_m_s(motion, joint, rows)
    if not np.isfinite(scale):
        return None
    several = len(np.unique(motion.frame_index)) > 1
    factors = json.loads(page_file("limb_speed.json"))["several" if several else "single"]
    lower, upper = factors["pelvis" if joint == 0 else "limbs"]
    return max(0.0, peak_m_s + lower * scale), peak_m_s + upper * scale


def sureness_m_s(motion: SampledMotion, joint: int, rows: Array) -> float:
    """Return the joint's radius over the exposure's length [m/s]; for the pelvis the mean over all joints.

    Args:
        motion: fitted motion; NaN is returned where it has no radii.
        joint: index in the SMPL layout.
        rows: rows of one exposure.
    """
    if motion.joint_radius_mm is None:
        return float("nan")
    radii = motion.joint_radius_mm[rows][:, joint] if joint else motion.joint_radius_mm[rows]
    return float(radii.mean() / 1000 / np.ptp(motion.times_s[rows]))
