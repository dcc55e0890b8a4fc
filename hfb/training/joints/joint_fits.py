"""Draw fits to learn from: `hfb train joints-fits --mocap DIR --backgrounds DIR --out f1 --count 2000`.

Every row is an image and a fit's rendering of it before the full-resolution stages: the point at which the joint
network compares the two.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.body.height import height_m
from hfb.config import FitConfig, Stage, preset
from hfb.datasets.network_errors import draw_turns
from hfb.evidence.joint_network import Window, picture_channels
from hfb.fitting.fit import fit
from hfb.fitting.refine import compose_blurred, render_blurred
from hfb.fitting.variables import Variables
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.static_pose import FirstBody
from hfb.priors.load import load_pose_prior
from hfb.rendering.observation import Observation
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.blurred_people import LEAST_PX, Sample, Shot, Studio, as_file, matte_of, until_found
from hfb.training.joints.joint_bank import Rows, draw_rows, split
from hfb.training.joints.people import draw_amplitude

_INSTANTS = 23
_ONE, _TWO = ((0, 22),), ((0, 10), (12, 22))
"""First and last instant of every exposure."""
_PAIRS = 0.5
_SECONDS = (0.02, 0.7)
_HASTE, _SUBFRAMES = (0.25, 0.7), 4
_HASTE_WHOLE, _SUBFRAMES_WHOLE = (0.3, 0.8), 5
"""Share of the shipped iterations, and number of sub-frames: other fits of an image are as good to learn from."""


@dataclass(frozen=True)
class Watched:
    """A person in one or two exposures: first and last instant of each, the estimated mattes, and the truth."""

    shot: Shot
    exposures: tuple[tuple[int, int], ...]
    seen: Observation
    alphas: np.ndarray


class Gym(Studio):
    """A studio whose images are fitted."""

    def __init__(self, mocap: Path, backgrounds: Path, clips: list[str], seed: int, frame_px: int) -> None:
        """Read the named clips and make the scenes.

        Args:
            mocap: folder of clips, BVH files.
            backgrounds: folder of photographs.
            clips: names of clips.
            seed: of the scenes.
            frame_px: side of the images [px].
        """
        super().__init__(mocap, backgrounds, clips, seed, frame_px)
        self.prior = load_pose_prior(None)
        self.hasty = hasty

    def rows(self, rng: np.random.Generator) -> list[Sample]:
        """Draw one or two frames of one person and fit them; draws without a visible person are repeated.

        Args:
            rng: of the person.
        """
        return until_found(lambda: self._fitted(rng))

    def _fitted(self, rng: np.random.Generator) -> list[Sample] | None:
        watched = self._watched(rng)
        return None if watched is None else self._samples(watched, rng)

    def _watched(self, rng: np.random.Generator, pairs: float = _PAIRS) -> Watched | None:
        """Draw a person in one or two exposures; None where no matte finds the person."""
        exposures = _TWO if rng.random() < pairs else _ONE
        shot = self._shot(rng, _SECONDS, _INSTANTS)
        if shot is None:
            return None
        noise, gain = rng.uniform(0.002, 0.012), float(np.exp(rng.normal(0, 0.03)))
        plate = as_file(shot.plate, noise / 2, rng)
        frames, mattes, alphas = [], [], []
        for first, last in exposures:
            picture, alpha = self._exposed(shot, slice(first, last + 1))
            frames.append(as_file(picture, noise, rng))
            mattes.append(self._matte(frames[-1], plate * gain, alpha, rng))
            alphas.append(alpha)
            if mattes[-1].sum() < LEAST_PX:
                return None
        (first, last), opens = exposures[0], exposures[-1][0]
        step_s = 1 / 30 / (opens or last)
        seen = Observation(
            torch.from_numpy(np.stack(frames)).float(),
            torch.from_numpy(plate).float(),
            torch.from_numpy(np.stack(mattes)).float(),
            shot.lens,
            (last - first) * step_s,
            (opens or last) * step_s,
        )
        return Watched(shot, exposures, seen, np.stack(alphas))

    def _matte(self, frame: np.ndarray, plate: np.ndarray, alpha: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return matte_of(frame, plate, alpha, rng)

    def _fit(self, watched: Watched, rng: np.random.Generator) -> tuple[list[FirstBody], Variables]:
        """Return the fit's first bodies, and its variables before the full-resolution stages."""
        firsts = self._first_bodies(watched.exposures, watched.shot, rng)
        result = fit(watched.seen, firsts, self.body, self.hasty(rng), int(rng.integers(1 << 30)), self.prior)
        betas = torch.from_numpy(result.motion.betas).float()
        return firsts, Variables(result.trajectory, betas, result.texture)

    def _drawn(self, found: Variables, seen: Observation) -> torch.Tensor:
        """Render the fit (T, H, W, 4)."""
        return render_blurred(
            found, seen.camera, body=self.body, rasterizer=self.rasterizer, subframes=preset("best").fit.subframes
        )

    def _samples(self, watched: Watched, rng: np.random.Generator) -> list[Sample]:
        seen, shot, exposures = watched.seen, watched.shot, watched.exposures
        windows = [Window.around(matte.numpy(), seen.camera, rng.normal(0, 0.02, 3)) for matte in seen.mattes]
        firsts, found = self._fit(watched, rng)
        again = compose_blurred(self._drawn(found, seen), seen)
        turns, places = found.trajectory.at(torch.tensor([0.0, 0.5, 1.0]))
        person = self.body.shape(found.betas)
        samples = []
        for number, ((first, last), window, start) in enumerate(zip(exposures, windows, firsts, strict=True)):
            pictures = [
                picture_channels(
                    one.frames_linear[number].numpy(), seen.plate_linear.numpy(), one.mattes[number].numpy(), window
                )
                for one in (seen, again)
            ]
            middle = (first + last) // 2
            fitted = person.joints_of(turns[number], places[number])
            truth = torch.stack([window.to_units(one) for one in (shot.joints[[first, middle, last]], fitted)])
            tall = np.array([float(height_m(self.body, betas)) for betas in (shot.betas, found.betas)])
            unit_m = float(shot.joints[middle, 0, 2]) * window.units_to_tangents()
            start_units = window.to_units(self._guessed(start)).numpy()[None]
            samples.append(Sample(np.stack(pictures), truth.numpy(), start_units, unit_m, tall))
        return samples

    def _guessed(self, first: FirstBody) -> torch.Tensor:
        """Return joints (24, 3) of a first body, camera coordinates [m]."""
        return self.mean.joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0]

    def _first_bodies(
        self, exposures: tuple[tuple[int, int], ...], shot: Shot, rng: np.random.Generator
    ) -> list[FirstBody]:
        """Return a static estimator's bodies: mean shape, the same errors in all frames, slightly displaced."""
        count = len(exposures)
        at = [int(np.clip(round(rng.normal((a + b) / 2, 0.2 * (b - a))), a, b)) for a, b in exposures]
        erring = self.erring(shot.poses[at], draw_turns(count, rng), np.full(count, draw_amplitude(rng)))
        stills = self.mean.joints_of(axis_angle_to_matrix(erring), torch.zeros(count, 3))
        nearer, aside = np.exp(rng.normal(0, 0.05)), rng.normal(0, 0.08 * rng.uniform(0, 1) ** 2, 2)
        bodies = []
        for pose, still, row in zip(erring, stills, at, strict=True):
            still = still - still[:1]
            distance = float(shot.joints[row, 0, 2]) * float(nearer * np.exp(rng.normal(0, 0.02)))
            depth = still[:, 2:] + distance
            seen = (shot.joints[row, :, :2] / shot.joints[row, :, 2:]).mean(0) + torch.from_numpy(aside).float() * 0.3
            across = (seen - (still[:, :2] / depth).mean(0)) / (1 / depth).mean(0)
            pelvis = torch.cat([across, torch.tensor([distance])])
            bodies.append(FirstBody(pose, pelvis - self.mean.joints[0].float(), torch.zeros(10), "simulated"))
        return bodies


def hasty(rng: np.random.Generator) -> FitConfig:
    """Return the shipped options with fewer iterations, without the full-resolution stages.

    Args:
        rng: draws the share of the iterations.
    """
    config, haste = preset("best").fit, rng.uniform(*_HASTE)
    few = tuple(stage for stage in config.stages if stage.size_px < config.stages[-1].size_px)
    changed = {
        "multi_frame": config.multi_frame.model_copy(update={"image": 1.0}),  # that of the stages left out
        "compare": 0.0,
        "matte_again": False,  # as before the first stage of full size
        "subframes": _SUBFRAMES,
    }
    return _in_haste(config.model_copy(update=changed | {"stages": few}), haste)


def hasty_whole(rng: np.random.Generator) -> FitConfig:
    """Return the shipped options with fewer iterations.

    Args:
        rng: draws the share of the iterations.
    """
    config, haste = preset("best").fit, rng.uniform(*_HASTE_WHOLE)
    return _in_haste(config.model_copy(update={"subframes": _SUBFRAMES_WHOLE}), haste)


def _in_haste(config: FitConfig, haste: float) -> FitConfig:
    stages = tuple(
        Stage(**(stage.model_dump() | {"iterations": round(haste * stage.iterations)})) for stage in config.stages
    )
    changed = {
        "stages": stages,
        "directions": config.directions.model_copy(update={"search": False}),
        "settle": round(max(haste, 0.5) * config.settle),
    }
    return config.model_copy(update=changed)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser)


def run(options: argparse.Namespace) -> None:
    """Write images and joints as two files; one frame per row.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    gym = Gym(options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px)
    draw_rows(Rows(options.out, options.count, (2,), starts=1), gym.rows, options.seed)
