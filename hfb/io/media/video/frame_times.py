"""Intervals between frames: the usual one, irregular ones, and clocks that are too coarse."""

import numpy as np

from hfb.io.media.video.video_packets import ASSUMED_FPS
from hfb.typing import Array, Float

_JITTER = 0.25
_FEWEST_PULLED_DOWN, _ALTERNATING_SHARE = 4, 0.9
_NOISE_S, _ONE_TICK = 1e-9, 1.001


def nominal_interval(times_s: Float[Array, "T"]) -> float:
    """Return the usual interval [s]: the mean of those within a quarter of their median; 1/30 s for one frame.

    Args:
        times_s: time stamps, ascending.
    """
    if len(times_s) < 2:
        return 1 / ASSUMED_FPS
    steps = np.diff(times_s)
    usual = float(np.median(steps))
    near = np.abs(steps - usual) <= _JITTER * usual
    return float(steps[near].mean()) if usual > 0 and near.any() else 1 / ASSUMED_FPS


def even_times(times_s: Float[Array, "t"], fps: float, tick_s: float) -> Float[Array, "t"]:
    """Return time stamps of a constant rate made even where the clock is too coarse for that rate.

    Matroska and ASF count milliseconds: 60 frames per second are 17, 16, 17 ms apart.

    Args:
        times_s: time stamps, ascending.
        fps: as the file states it.
        tick_s: the clock's resolution.
    """
    even = times_s[:1] + np.arange(len(times_s)) / fps
    apart = float(np.abs(times_s - even).max(initial=0.0))
    return even if _NOISE_S < apart <= tick_s * _ONE_TICK else times_s


def is_pulled_down(times_s: Float[Array, "t"]) -> bool:
    """Return whether frames are shown for two and three fields in turn, as film is on television: it was taken evenly.

    Args:
        times_s: time stamps, ascending.
    """
    steps = np.diff(times_s)
    if len(steps) < _FEWEST_PULLED_DOWN or steps.min() <= 0:
        return False
    long = steps > 1.25 * steps.min()
    usual = np.where(long, 1.5, 1.0) * np.median(steps[~long])
    alternates = (long[1:] != long[:-1]).mean() > _ALTERNATING_SHARE
    return bool(alternates and (np.abs(steps - usual) <= 0.1 * usual).all())


def irregular(times_s: Float[Array, "T"], interval_s: float) -> list[str]:
    """Return a sentence where some intervals are not the usual one.

    Args:
        times_s: time stamps, ascending.
        interval_s: the usual one.
    """
    odd = int((np.abs(np.diff(times_s) - interval_s) > _JITTER * interval_s).sum())
    if not odd:
        return []
    return [
        f"{odd} of {len(times_s) - 1} intervals between frames are not the usual {interval_s:.4g} s: the result has "
        "their true times, the fit takes each for the usual one"
    ]
