"""Exposure times of K averaged frames of a video, on the clock of a fit.

A fit explains an image as the mean of instants at u = 0 .. 1, both ends included. The mean of K sharp frames is
exactly that with u = j / (K - 1), if u = 0 is the middle of the first frame's own exposure and u = 1 that of the
last. So the made-up shutter is open for (K - 1) / fps and opens every K / fps; between the last frame of one window
and the first of the next lies one interval of the video, as it should.

A single frame (K = 1) has no second instant. Its shutter is taken to be open for the whole interval, as long as it can
be, and the truth is known in the middle alone.
"""

from dataclasses import dataclass

import numpy as np

from hfb.motion.clock import subframe_times_s
from hfb.typing import Array, Float, Int


@dataclass(frozen=True)
class Shutter:
    """T exposures of K frames each, without a gap.

    Attributes:
        average: K, sharp frames per exposure.
        frames: T, number of exposures.
        fps: frame rate of the sharp video.
    """

    average: int
    frames: int
    fps: float

    @property
    def exposure_s(self) -> float:
        """From the middle of the first sharp frame to the middle of the last, of a single one its interval [s]."""
        return max(self.average - 1, 1) / self.fps

    @property
    def interval_s(self) -> float:
        """From one opening to the next [s]."""
        return self.average / self.fps

    def instants(self) -> tuple[Float[Array, "R"], Int[Array, "R"]]:
        """Return times [s] of the R = T * K sharp frames since the first shutter opened, and the window of each."""
        if self.average == 1:
            index = np.arange(self.frames)
            return index * self.interval_s + self.exposure_s / 2, index
        return subframe_times_s(self.frames, self.average, self.exposure_s, self.interval_s)
