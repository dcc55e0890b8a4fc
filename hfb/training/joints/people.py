"""People with known joints in front of a random camera, with erroneous starts; motions are mocap and generated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import MIRROR
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.resampling import has_jump, resample
from hfb.datasets.motions.sources import open_motions
from hfb.datasets.network_errors import pose_errors
from hfb.datasets.synthetic.viewpoints import View, draw_view
from hfb.evidence.joint_network import Window
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.priors.anatomy import AnatomicalPrior

STARTS = 2
INSTANTS = 11
_MIXED, _BENT, _FROM_BEHIND = 0.6, 0.5, 0.15
_PARTS = ((9, 12, 15), (13, 16, 18, 20, 22), (14, 17, 19, 21, 23), (1, 4, 7, 10, 2, 5, 8, 11), (3, 6))
"""Head, left arm, right arm, both legs, waist: parts that are exchanged between motions."""
SECONDS = (0.02, 0.5)


class People:
    """Motions and the body; everything drawn from them is a function of the generator."""

    bend_rad = 0.2
    """Standard deviation of the turns by which joints are offset."""

    def __init__(self, mocap: Path, clips: list[str], seed: int, frame_px: int) -> None:
        """Read the named clips.

        Args:
            mocap: folder of clips, BVH files.
            clips: names of clips.
            seed: of the generated motions.
            frame_px: side of the images [px].
        """
        self.frame_px = frame_px
        source = open_motions(mocap, seed)
        named = [index for index, name in enumerate(source.names()) if Path(name).stem in clips]
        made = open_motions(None, seed)
        self.recorded = [source.load(index) for index in named]
        self.made = [made.load(index) for index in range(len(made.names()))]
        self.body = load_default_body()
        self.mean = self.body.shape(torch.zeros(10))

    def _motion(
        self,
        rng: np.random.Generator,
        seconds_range: tuple[float, float] = SECONDS,
        instants: int = INSTANTS,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        clips = self.recorded if rng.random() < 0.75 else self.made
        seconds = float(np.exp(rng.uniform(*np.log(seconds_range))))
        piece = _piece(clips[rng.integers(len(clips))], seconds, instants, rng)
        if piece is None:
            return None
        poses, places = piece
        if rng.random() < _MIXED:
            for part in _PARTS:
                other = _piece(self.recorded[rng.integers(len(self.recorded))], seconds, instants, rng)
                if other is not None and rng.random() < 0.5:
                    poses[:, part] = other[0][:, part]
        if rng.random() < _BENT:
            poses = _bent(poses, self.bend_rad, rng)
        return (poses[:, MIRROR] * (1, -1, -1), places * (-1, 1, 1)) if rng.random() < 0.5 else (poses, places)

    def _view(self, rng: np.random.Generator) -> View:
        view = draw_view(rng)
        if rng.random() < _FROM_BEHIND:
            view = replace(view, azimuth_deg=float(rng.uniform(-180, 180)))
        return view

    def _starts(
        self,
        erring: torch.Tensor,
        at: np.ndarray,
        truth: np.ndarray,
        window: Window,
        joints: torch.Tensor,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Return static estimators' joints in the window at some moments of one exposure."""
        return np.stack(
            [
                self._placed(still, float(joints[row, 0, 2]), truth[1], window, rng)
                for row, still in zip(at, self.stills(erring), strict=True)
            ]
        )

    def stills(self, erring: torch.Tensor) -> torch.Tensor:
        """Return joints (S, 24, 3) from the pelvis, of the mean body [m].

        Args:
            erring: (S, 24, 3) axis-angle [rad].
        """
        stills = self.mean.joints_of(axis_angle_to_matrix(erring), torch.zeros(len(erring), 3))
        return stills - stills[:, :1]

    def erring(self, poses: np.ndarray, turns: np.ndarray, amplitudes: np.ndarray) -> torch.Tensor:
        """Return poses (S, 24, 3) with the errors of pose networks, axis-angle [rad].

        Args:
            poses: (S, 24, 3) true poses, axis-angle [rad].
            turns: random rotations of the errors.
            amplitudes: (S,) scale of the errors.
        """
        errors = pose_errors(torch.from_numpy(poses).float(), turns)
        errors = replace(errors, turns=errors.turns * torch.from_numpy(amplitudes)[:, None, None].float())
        return errors.poses_at(torch.tensor([0.5, 1.0]))[-1]

    def _placed(
        self, still: torch.Tensor, distance: float, truth: np.ndarray, window: Window, rng: np.random.Generator
    ) -> np.ndarray:
        """Return one of them in its window's units (24, 3), slightly displaced from the truth."""
        depth = distance * float(np.exp(rng.normal(0, 0.05)))
        start = window.to_units(still + torch.tensor([0.0, 0.0, depth])).numpy()
        wander = rng.uniform(0, 1) ** 2 * 0.3
        start[:, :2] += (truth - start)[:, :2].mean(0) + rng.normal(0, wander, 2) * (1, 0.5)
        return start.astype(np.float32)


def draw_moments(rng: np.random.Generator) -> np.ndarray:
    """Draw the instants of an exposure that static estimators respond to.

    Args:
        rng: of the sample.
    """
    return np.clip(np.round(rng.normal(0.5, 0.2, STARTS) * (INSTANTS - 1)), 0, INSTANTS - 1).astype(int)


def draw_amplitude(rng: np.random.Generator) -> float:
    """Draw the scale of a pose network's errors, from nearly none to more than any network's.

    Args:
        rng: of the sample.
    """
    return float(rng.uniform(0.05, 1.3)) if rng.random() < 0.93 else 0.01


def _bent(poses: np.ndarray, bend_rad: float, rng: np.random.Generator) -> np.ndarray:
    """Return the motion with every joint offset a little, where anatomy allows."""
    turns = torch.from_numpy(rng.normal(0, bend_rad, (1, 24, 3)) * (np.arange(24) > 0)[None, :, None]).float()
    rotations = axis_angle_to_matrix(torch.from_numpy(poses).float()) @ axis_angle_to_matrix(turns)
    bent = matrix_to_axis_angle(rotations).double().numpy()
    before, after = (
        AnatomicalPrior().limit_penalty(torch.from_numpy(one[:, 1:]).float()).max() for one in (poses, bent)
    )
    return bent if after <= max(float(before), 2.0) else poses


def _piece(
    clip: MotionClip, seconds: float, instants: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return poses and translations at the instants of a random exposure."""
    length = (len(clip.poses) - 1) / clip.fps
    seconds = min(seconds, length)
    start = rng.uniform(0, length - seconds)
    if has_jump(clip, start, start + seconds):
        return None
    return resample(clip, np.clip(np.linspace(start, start + seconds, instants), 0, length))
