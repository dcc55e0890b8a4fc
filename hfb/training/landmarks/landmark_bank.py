"""Draw what the landmark network says of people with known joints: `hfb train landmarks-bank --out b1.npz ...`."""

import argparse
from dataclasses import replace

import numpy as np
import torch

from hfb.datasets.synthetic.viewpoints import View, draw_view
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.landmark_lift import world_in_camera
from hfb.initialization.landmarks import Landmarks, PoseNetworks, Region
from hfb.initialization.registration import attach_landmarks, follow_chain
from hfb.motion.motion_file import write_arrays
from hfb.photometry import linear_to_srgb
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.blurred_people import LEAST_PX, Shot, Studio, as_file, until_found
from hfb.training.joints.joint_bank import split
from hfb.training.joints.people import INSTANTS
from hfb.training.schedule import Counter

_SECONDS = (0.004, 0.25)
_SHARP, _ALONE, _GRAY = 0.3, 0.35, 0.5
_ASLANT, _ELEVATION_DEG, _ROLL_DEG = 0.7, (-15.0, 40.0), 12.0
_LEAST_SCORE = 0.5


class Sightings(Studio):
    """People before photographs, and what a landmark network says of their blurred images."""

    networks: PoseNetworks
    bend_rad = 0.3

    def sight(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Return landmarks and the truth at mid-exposure; draws in which no person is found are repeated.

        ``rays`` (33, 2) pixels as tangents, ``world`` (33, 3) camera axes [m], ``visibility`` (33,), ``truth``
        (L, 3) the same points on the body, camera coordinates [m].

        Args:
            rng: of the sample.
        """
        return until_found(lambda: self._sighted(rng))

    def _view(self, rng: np.random.Generator) -> View:
        """Draw a camera of any azimuth, more often tilted and rolled than those of a rendered set."""
        view = replace(draw_view(rng), azimuth_deg=float(rng.uniform(-180, 180)))
        if rng.random() < _ASLANT:
            view = replace(
                view, elevation_deg=float(rng.uniform(*_ELEVATION_DEG)), roll_deg=float(rng.normal(0, _ROLL_DEG))
            )
        return view

    def _sighted(self, rng: np.random.Generator) -> dict[str, np.ndarray] | None:
        shot = self._shot(rng, _SECONDS)
        if shot is None:
            return None
        picture, alpha = self._exposed(
            shot, slice(None) if rng.random() < 0.7 else slice(INSTANTS // 2, INSTANTS // 2 + 1)
        )
        if alpha.sum() < LEAST_PX:
            return None
        frame = linear_to_srgb(as_file(picture, rng.uniform(0.002, 0.012), rng)).astype(np.float32)
        if rng.random() < _ALONE:
            frame = frame * alpha[..., None] + _GRAY * (1 - alpha[..., None])
        found = self._located(frame, alpha, rng)
        if found is None:
            return None
        lens = shot.lens
        return {
            "rays": (found.pixels - (lens.cx, lens.cy)) / (lens.fx, lens.fy),
            "world": world_in_camera(found, lens),
            "visibility": found.visibility,
            "truth": self._points(shot),
        }

    def _located(self, frame: np.ndarray, alpha: np.ndarray, rng: np.random.Generator) -> Landmarks | None:
        rows, columns = (np.flatnonzero(alpha.max(axis) > 0.3) for axis in (1, 0))
        if not len(rows) or not len(columns):
            return None
        side = 1.25 * max(np.ptp(rows), np.ptp(columns)) * float(np.exp(rng.normal(0, 0.1)))
        x, y = (float(one[0] + one[-1]) / 2 + rng.normal(0, 0.03) * side for one in (columns, rows))
        found = self.networks.locate(frame, Region(x, y, side, float(rng.normal(0, 0.1)), 1.0))
        if found.score >= _LEAST_SCORE and rng.random() < 0.7:
            found = self.networks.locate(frame, found.next_region)
        return found if found.score >= _LEAST_SCORE else None

    def _points(self, shot: Shot) -> np.ndarray:
        middle = INSTANTS // 2
        shaped = self.body.shape(shot.betas)
        joints, turns = follow_chain(
            shaped.joints, axis_angle_to_matrix(torch.from_numpy(shot.poses[middle]).float()), torch.zeros(3)
        )
        joints = joints + (shot.joints[middle, 0] - joints[0])
        return attach_landmarks(shaped).positions(joints, turns).numpy()


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser, 10_000)
    add = parser.add_argument
    add("--landmarks", default="auto", choices=("auto", "full", "heavy"), help="which landmark network [auto: heavy]")
    add("--first", type=int, default=0, metavar="N", help="number of the first person [0]")


def run(options: argparse.Namespace) -> None:
    """Write everything drawn as one file.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    clips = split(options.mocap, options.split)
    people = Sightings(options.mocap, options.backgrounds, clips, options.seed, options.frame_px)
    people.networks = PoseNetworks(options.landmarks)
    counter, drawn = Counter("people", 250), []
    for number in range(options.first, options.first + options.count):
        drawn.append(people.sight(np.random.default_rng([options.seed, number])))
        counter.reached(len(drawn))
    write_arrays(options.out, {name: np.stack([one[name] for one in drawn]).astype(np.float32) for name in drawn[0]})
