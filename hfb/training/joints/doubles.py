"""Draw people with doubles: `hfb train joints-doubles --mocap DIR --backgrounds DIR --out d1 --count 9000`.

Comparing an image with a fit's rendering is learned from fits (`joint_fits`), each of which takes most of a second. A
double is a fast substitute for a fit: the person in a slightly different pose and shape, in blurred clothes, with less
motion.
"""

import argparse
from dataclasses import replace

import cv2
import numpy as np
import torch

from hfb.body.height import height_m
from hfb.datasets.network_errors import draw_turns
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.rendering.formation import compose
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.blurred_people import Sample, Seen, Shot, Studio
from hfb.training.joints.joint_bank import Rows, draw_rows, split
from hfb.training.joints.people import INSTANTS, STARTS, draw_amplitude, draw_moments

_AMPLITUDES, _MOTION, _BLUR_PX = (0.03, 0.4), (0.3, 1.05), (0.3, 3.0)
"""Ranges: scale of a network's errors; share of the motion that is kept; blur of the texture of 128 px."""
_SUBFRAMES = 7
_KEPT, _SHAPE = 0.8, 0.45
"""Share of the true betas that is kept, and scale of their errors."""
_NOBODY = 0.01  # of a pixel, as in hfb.fitting.refine


class DoublesStudio(Studio):
    """A studio in which every person has a double."""

    def _try(self, rng: np.random.Generator) -> Sample | None:
        shot = self._shot(rng)
        seen = None if shot is None else self._seen(shot, rng)
        if shot is None or seen is None:
            return None
        at, middle = draw_moments(rng), INSTANTS // 2
        *erring, other = self.erring(
            shot.poses[[*at, middle]],
            np.concatenate([draw_turns(STARTS, rng), draw_turns(1, rng)]),
            np.array([*[draw_amplitude(rng)] * STARTS, rng.uniform(*_AMPLITUDES)]),
        )
        double = self._double(shot, other, rng)
        again = self._beside(seen, double)
        distance = float(shot.joints[middle, 0, 2])
        of_shot = seen.window.to_units(shot.joints[[0, middle, -1]])
        of_double = seen.window.to_units(double.joints[[0, _SUBFRAMES // 2, -1]])
        starts = self._starts(torch.stack(erring), at, of_shot.numpy(), seen.window, shot.joints, rng)
        return Sample(
            np.stack([seen.channels(), again.channels()]),
            torch.stack([of_shot, of_double]).numpy(),
            starts,
            distance * seen.window.units_to_tangents(),
            np.array([float(height_m(self.body, one.betas)) for one in (shot, double)]),
        )

    def _double(self, shot: Shot, pose: torch.Tensor, rng: np.random.Generator) -> Shot:
        """Return a person in that pose (24, 3) at u = 1/2 who covers about the same pixels: taller if further away."""
        share = rng.uniform(*_MOTION) * np.linspace(-1, 1, _SUBFRAMES)
        middle = INSTANTS // 2
        at = np.round(middle * (1 + share)).astype(int).clip(0, INSTANTS - 1)
        true = axis_angle_to_matrix(torch.from_numpy(shot.poses).float())
        rotations = true[at] @ (true[middle].transpose(-1, -2) @ axis_angle_to_matrix(pose))
        betas = _KEPT * shot.betas + torch.from_numpy(rng.normal(0, _SHAPE, 10)).float()
        person = self.body.shape(betas)
        larger = float(height_m(self.body, betas) / height_m(self.body, shot.betas))
        depth = shot.joints[at, :1, 2:] * larger * float(np.exp(rng.normal(0, 0.005)))
        still = person.joints_of(rotations, torch.zeros(_SUBFRAMES, 3))
        away = depth + still[..., 2:] - still[:, :1, 2:]
        seen = (shot.joints[at][..., :2] / shot.joints[at][..., 2:]).mean(1) + torch.from_numpy(
            rng.normal(0, 0.002, 2)
        ).float()
        across = (seen - (still[..., :2] / away).mean(1)) / (1 / away).mean(1)
        places = torch.cat([across, depth[:, 0] - still[:, 0, 2:]], -1)
        texture = cv2.GaussianBlur(shot.texture.numpy(), (0, 0), float(rng.uniform(*_BLUR_PX)))
        tint = torch.from_numpy(np.exp(rng.normal(0, 0.04, 3))).float()
        return replace(
            shot,
            betas=betas,
            mesh=self.body.mesh,
            vertices=person.pose(rotations, places).vertices,
            poses=shot.poses[at],
            joints=still + places[:, None],
            texture=(torch.from_numpy(texture) * tint).clamp(0, 1),
        )

    def _beside(self, seen: Seen, double: Shot) -> Seen:
        """Return the double over the plate, as `hfb.fitting.comparison.drawn` renders a fit."""
        mean = self.rasterizer.render_mean(double.vertices, double.texture, double.lens, double.mesh)[seen.inner]
        alpha = mean[..., 3].numpy()
        composed = compose(mean, torch.from_numpy(seen.plate)).numpy()
        bare = np.maximum(alpha, seen.matte) < _NOBODY
        return replace(seen, frame=np.where(bare[..., None], seen.frame, composed), matte=alpha)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser)


def run(options: argparse.Namespace) -> None:
    """Write images and joints as two files; a person and a double per row.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    studio = DoublesStudio(
        options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px
    )
    draw_rows(Rows(options.out, options.count, (2,), STARTS), lambda rng: [studio.draw(rng)], options.seed)
