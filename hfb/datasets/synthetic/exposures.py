"""The clocks of synthetic cases: possible exposures, and the instants of the truth."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hfb.motion.clock import subframe_times_s
from hfb.typing import Array, Float

_AMASS_HZ, _AMASS_FRAMES = 120, range(5, 61)
_CAPE_HZ = 600
_SEVENTHS = range(5, 11)
"""A frame has 7 k + 1 instants: 36 to 71, among them the eight of a fit with eight sub-frames."""
_LARGEST_GAP = 0.25
_STEP_PX = 2.0


@dataclass(frozen=True)
class Clock:
    """T exposures of one camera, in seconds of a recording.

    Attributes:
        start_s: first opening of the shutter, from the recording's first frame.
        exposure_s: length of each exposure.
        interval_s: time from opening to opening; exactly 1 / fps of the file that states it.
        instants: per exposure, both ends included.
    """

    start_s: float
    exposure_s: float
    interval_s: float
    frames: int
    instants: int

    @property
    def fps(self) -> float:
        """Images per second."""
        return 1 / self.interval_s

    def times_s(self) -> Float[Array, "R"]:
        """Return every instant in the recording's time, frame after frame."""
        return self.start_s + subframe_times_s(self.frames, self.instants, self.exposure_s, self.interval_s)[0]


@dataclass(frozen=True)
class Shutter:
    """The possible exposures of a set.

    Attributes:
        exposures_s: possible exposure times, ascending.
        grid_hz: grid of which all instants are multiples; None for any.
    """

    exposures_s: tuple[float, ...]
    grid_hz: int | None

    def nearest(self, exposure_s: float) -> int:
        """Return the number of the possible exposure that is nearest by ratio.

        Args:
            exposure_s: wanted exposure.
        """
        return int(np.abs(np.log(np.asarray(self.exposures_s) / exposure_s)).argmin())

    def clock(self, exposure: int, start_s: float, gap: float, frames: int, motion_px: float) -> Clock:
        """Return the clock of a possible exposure.

        Args:
            exposure: its number in `exposures_s`.
            start_s: first opening of the shutter in the motion.
            gap: between exposures, in units of an exposure.
            frames: number of exposures.
            motion_px: greatest speed of a joint [px per exposure]; it moves at most two pixels from instant to instant,
                as far as 71 instants allow.
        """
        exposure_s = self.exposures_s[exposure]
        gap_s = gap * exposure_s
        wanted = next((k for k in _SEVENTHS if 7 * k * _STEP_PX >= motion_px), _SEVENTHS[-1])
        if self.grid_hz is not None:
            start_s, gap_s = (int(value * self.grid_hz) / self.grid_hz for value in (start_s, gap_s))
            possible = _instant_sevenths(round(exposure_s * self.grid_hz))
            wanted = next((k for k in possible if k >= wanted), possible[-1])
        fps = 1 / (exposure_s + gap_s)
        if gap_s == 0:  # the reciprocal's rounding must not leave an interval shorter than the exposure
            fps = fps if 1 / fps >= exposure_s else math.nextafter(fps, 0)
        return Clock(start_s, exposure_s, 1 / fps, frames, 7 * wanted + 1)


def _instant_sevenths(steps: int) -> list[int]:
    """Return each k for which 7 k equal steps fill an exposure of that many grid steps."""
    return [k for k in _SEVENTHS if steps % (7 * k) == 0]


def shutter_of(name: Literal["bt-amass", "bc-cape"]) -> Shutter:
    """Return the shutter of a set.

    BT-AMASS: 5 to 60 frames of 120 fps. BC-CAPE: instants of 600 fps, 58 to 467 ms of them.

    Args:
        name: name of the set.
    """
    if name == "bt-amass":
        return Shutter(tuple(count / _AMASS_HZ for count in _AMASS_FRAMES), None)
    longest = _SEVENTHS[-1] * 4 * 7
    lengths = [steps for steps in range(1, longest + 1) if _instant_sevenths(steps)]
    return Shutter(tuple(steps / _CAPE_HZ for steps in lengths), _CAPE_HZ)


def draw_gap(rng: np.random.Generator) -> float:
    """Draw the time between two exposures, in units of one.

    Args:
        rng: draws the gap.
    """
    return float(rng.uniform(0, _LARGEST_GAP))
