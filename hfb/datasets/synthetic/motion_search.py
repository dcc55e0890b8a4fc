"""Search for a piece of a motion, and a camera, of a wanted blur rate."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.model import ShapedBody
from hfb.datasets.blur_bins import Interval
from hfb.datasets.blur_rates import blur_rates
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.resampling import has_jump, resample
from hfb.datasets.synthetic.exposures import Clock, Shutter, draw_gap
from hfb.datasets.synthetic.viewpoints import PlacedCamera, View, draw_view, front_of, place
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.rendering.backends import make_rasterizer
from hfb.typing import Array, Float

_DRAWS, _DRAWS_PER_CLIP = 240, 4
_CORRECTIONS = 5
_COARSE_PX, _COARSE_INSTANTS = 64, 15
_EVERY = 13
"""Stride of the vertices that are used to aim the camera."""
_FIRST_GUESS_S = 0.15
_SEEN = 0.95
"""Few instants leave gaps in a fast union: a rough blur rate is a few percent too low."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A piece of a motion as a camera sees it.

    Attributes:
        clip: the motion.
        number: number of that motion in its source.
        blur_rate: roughly, from small images.
    """

    clip: MotionClip
    number: int
    clock: Clock
    view: View
    camera: PlacedCamera
    blur_rate: float


@dataclass(frozen=True)
class _Draw:
    """All random numbers of one attempt."""

    start: float
    gap: float
    level: float
    view: View


def candidates(
    load: Callable[[int], MotionClip],
    usable: Sequence[int],
    dressed: Callable[[MotionClip], ShapedBody],
    shutter: Shutter,
    wanted: Interval,
    any_length: bool,
    frames: int,
    size_px: int,
    rng: np.random.Generator,
) -> Iterator[Candidate]:
    """Yield pieces of motion whose approximate blur rate is wanted, as many as a few hundred draws give.

    A motion, a start, a gap and a camera are drawn; the exposure time follows from the wanted blur rate, which grows
    with it nearly in proportion.

    Args:
        load: a motion by its number.
        usable: the numbers to draw from.
        dressed: the person who makes the motion, on a mesh that is quick to draw.
        shutter: possible exposures.
        wanted: interval of blur rates.
        any_length: draw the exposure time too and take what blur comes of it.
        frames: exposures per case.
        size_px: side of the square images.
        rng: draws motions, times and cameras.
    """
    clip, number, person = None, -1, None
    for attempt in range(_DRAWS):
        if attempt % _DRAWS_PER_CLIP == 0:
            number = usable[int(rng.integers(len(usable)))]
            clip = load(number)
            person = dressed(clip)
        draw = _Draw(float(rng.uniform()), draw_gap(rng), float(rng.uniform()), draw_view(rng))
        assert clip is not None
        assert person is not None
        piece = _Piece(clip, person, shutter, frames, size_px, draw)
        found = piece.at_any_length(wanted) if any_length else piece.at_wanted_rate(wanted)
        if found is not None:
            clock, camera, rate = found
            times_s = clock.times_s()
            if not has_jump(clip, float(times_s[0]), float(times_s[-1])):  # an error of the recording
                yield Candidate(clip, number, clock, draw.view, camera, rate)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A start and a camera; only the exposure time is open."""

    clip: MotionClip
    person: ShapedBody
    shutter: Shutter
    frames: int
    size_px: int
    draw: _Draw

    def at_wanted_rate(self, wanted: Interval) -> tuple[Clock, PlacedCamera, float] | None:
        """Correct the exposure time by the ratio of the wanted blur rate to the one found."""
        low, high = wanted[0], wanted[1] * _SEEN
        target = low + (0.15 + 0.7 * self.draw.level) * (high - low)
        times = self.shutter.exposures_s
        longest = self._longest()
        exposure, tried = min(self.shutter.nearest(_FIRST_GUESS_S), longest), set[int]()
        for _ in range(_CORRECTIONS):
            if exposure < 0 or exposure in tried:
                return None
            tried.add(exposure)
            clock, camera, rate = self._look(exposure)
            if low <= rate < high:
                return clock, camera, rate
            corrected_s = times[exposure] * float(np.clip(target / max(rate, 1e-3), 0.2, 5))
            if not 0.7 * times[0] < corrected_s < 1.4 * times[longest]:
                return None
            exposure = min(self.shutter.nearest(corrected_s), longest)
        return None

    def at_any_length(self, wanted: Interval) -> tuple[Clock, PlacedCamera, float] | None:
        """Draw the exposure time, too."""
        longest = self._longest()
        if longest < 0:
            return None
        clock, camera, rate = self._look(int(self.draw.level * (longest + 1)))
        return (clock, camera, rate) if wanted[0] <= rate < wanted[1] else None

    def _duration_s(self) -> float:
        return (len(self.clip.poses) - 1) / self.clip.fps

    def _span_s(self, exposure: int) -> float:
        """Return the time from the first opening to the last closing, with a margin for rounding to a grid."""
        rounding_s = 0 if self.shutter.grid_hz is None else (self.frames + 1) / self.shutter.grid_hz
        return self.shutter.exposures_s[exposure] * (self.frames + (self.frames - 1) * self.draw.gap) + rounding_s

    def _longest(self) -> int:
        """Return the longest exposure that the motion allows; -1 where it is too short for any."""
        fitting = (index for index in range(len(self.shutter.exposures_s)) if self._span_s(index) <= self._duration_s())
        return max(fitting, default=-1)

    def _look(self, exposure: int) -> tuple[Clock, PlacedCamera, float]:
        """Return clock, camera and blur rate, from small silhouettes at few instants."""
        latest = self._duration_s() - self._span_s(exposure)
        start_s = min(self.draw.start * (self._duration_s() - self._span_s(0)), latest)
        coarse = replace(
            self.shutter.clock(exposure, start_s, self.draw.gap, self.frames, 0.0), instants=_COARSE_INSTANTS
        )
        poses, translations = resample(self.clip, coarse.times_s())
        rotations = axis_angle_to_matrix(torch.from_numpy(poses).float())
        posed = self.person.pose(rotations, torch.from_numpy(translations).float())
        points = posed.vertices[:, ::_EVERY].reshape(-1, 3).double().numpy()
        camera = place(self.draw.view, front_of(poses[len(poses) // 2, 0]), points, self.size_px)
        turn, offset = (torch.from_numpy(values).float() for values in (camera.R_camera_world, camera.offset))
        small = camera.lens.resize(_COARSE_PX, _COARSE_PX)
        rasterizer = make_rasterizer("coverage", "cpu", 1)
        seen = rasterizer.render(posed.vertices @ turn.T + offset, None, small, self.person.body.mesh)[..., 3].numpy()
        by_frame = seen.reshape(self.frames, _COARSE_INSTANTS, *seen.shape[1:])
        motion_px = self._fastest_px(posed.joints.double().numpy(), camera)
        clock = self.shutter.clock(exposure, start_s, self.draw.gap, self.frames, motion_px)
        return clock, camera, float(blur_rates(by_frame).mean())

    def _fastest_px(self, joints: Float[Array, "R 24 3"], camera: PlacedCamera) -> float:
        """Return the greatest speed of any joint in the full image [px per exposure]."""
        here = joints @ camera.R_camera_world.T + camera.offset
        screen = camera.lens.fx * here[..., :2] / np.maximum(here[..., 2:], 0.2)
        by_frame = screen.reshape(self.frames, _COARSE_INSTANTS, *screen.shape[1:])
        return float(np.linalg.norm(np.diff(by_frame, axis=1), axis=-1).max(1).max() * (_COARSE_INSTANTS - 1))
