"""Motions with known poses at every instant, for what reads exported files back."""

import numpy as np
import torch

from hfb.body.model import Body
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion

SUBFRAMES = 8


def pose_at(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(axis-angle (F, 72), translation (F, 3)) of somebody who turns and swings arms and legs, any instants."""
    generator = np.random.default_rng(3)
    size, phase = generator.uniform(-0.5, 0.5, (24, 3)), generator.uniform(0, 6, (24, 3))
    poses = size * np.sin(9 * times_s[:, None, None] + phase)
    poses[:, 0] = [np.pi, 0, 0] + 0.6 * np.sin(4 * times_s[:, None] + np.array([np.pi - 0.15, 0, 2]))
    places = np.stack([np.sin(3 * times_s), 0.1 + 0.2 * np.sin(5 * times_s), 3.5 + 0.5 * times_s], -1)
    return poses.reshape(len(times_s), 72), places


def joints_at(times_s: np.ndarray, body: Body, betas: np.ndarray) -> np.ndarray:
    """The joints (F, 24, 3) of `pose_at` [m]."""
    poses, places = pose_at(times_s)
    rotations = axis_angle_to_matrix(torch.from_numpy(poses).unflatten(1, (24, 3)))
    shaped = body.to(torch.float64).shape(torch.from_numpy(betas))
    return shaped.joints_of(rotations, torch.from_numpy(places)).numpy()


def motion_of(
    body: Body, frames: int = 3, exposure_s: float = 0.02, interval_s: float = 1 / 30, missing: tuple[int, ...] = ()
) -> SampledMotion:
    """`pose_at` as a fit would leave it: sub-frames of exposures, without the frames in which nobody is there."""
    times_s, frame_index = subframe_times_s(frames, SUBFRAMES, exposure_s, interval_s)
    kept = ~np.isin(frame_index, missing)
    times_s, frame_index = times_s[kept], frame_index[kept]
    betas = np.linspace(-1, 1, 10)
    poses, places = pose_at(times_s)
    radius = np.linspace(5, 60, len(times_s) * 24).reshape(-1, 24)
    K = np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]])
    joints = joints_at(times_s, body, betas)
    # As a fit writes them: angles of at most pi, so that the root of somebody upright turns round and round.
    rotations = axis_angle_to_matrix(torch.from_numpy(poses).unflatten(1, (24, 3)))
    poses = matrix_to_axis_angle(rotations).flatten(1).numpy()
    return SampledMotion(poses, places, betas, joints, times_s, frame_index, K, radius)
