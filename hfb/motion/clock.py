"""The only source of sub-frame times: every part of the body is evaluated on this one clock."""

import numpy as np
import torch

from hfb.typing import Array, Float, Int, Tensor


def subframe_clock(subframes: int, dtype: torch.dtype = torch.float32) -> Float[Tensor, "S"]:
    """Return u = (i - 1) / (N - 1), i = 1..N: sub-frame times in units of the exposure, both ends included.

    Args:
        subframes: N, per exposure.
        dtype: precision of u.
    """
    if subframes < 2:
        raise ValueError(f"an exposure needs at least 2 sub-frames, not {subframes}")
    return torch.linspace(0, 1, subframes, dtype=dtype)


def subframe_times_s(
    frames: int, subframes: int, exposure_s: float, interval_s: float
) -> tuple[Float[Array, "R"], Int[Array, "R"]]:
    """Return times [s] of all R = frames * subframes instants, frame after frame, and the frame each belongs to.

    Time zero is the opening of the shutter for the first frame; frame k opens at k * interval_s.

    Args:
        frames: number of frames.
        subframes: N, per exposure.
        exposure_s: time that the shutter is open.
        interval_s: time from one opening of the shutter to the next.
    """
    u = subframe_clock(subframes, torch.float64).numpy()
    index = np.repeat(np.arange(frames), subframes)
    return index * interval_s + np.tile(u, frames) * exposure_s, index


def next_opening(exposure_s: float, interval_s: float) -> float:
    """Return the time, on this frame's clock u, at which the next frame's shutter opens.

    With an exposure gap of tau sub-frames this is 1 + tau / (N - 1), whatever N is.

    Args:
        exposure_s: time that the shutter is open.
        interval_s: time from one opening of the shutter to the next.
    """
    return interval_s / exposure_s
