"""Windows of a clip whose motion is known, as fits would leave them: each with errors of its own."""

from dataclasses import replace

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.fitting.clip.windows import WindowFit, plan_windows
from hfb.fitting.identity import Identity
from hfb.geometry.rotations import axis_angle_to_matrix, axis_angle_to_quaternion
from hfb.io.media.timing import Timing
from hfb.motion.trajectory import Trajectory

INTERVAL_S = 1 / 30
PERSON = Identity(torch.linspace(-0.5, 0.5, 10), torch.full((8, 8, 3), 0.5))


def timing(frames: int, shutter: float = 1.0, openings_s: np.ndarray | None = None) -> Timing:
    openings = np.arange(frames) * INTERVAL_S if openings_s is None else openings_s
    return Timing(shutter * INTERVAL_S, INTERVAL_S, openings, 0.0, "a test")


def motion_at(times_s: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Every joint swings about an axis of its own, one period in a fifth of a second or longer; the body walks."""
    generator = torch.Generator().manual_seed(4)
    axes = torch.nn.functional.normalize(torch.randn(24, 3, generator=generator, dtype=torch.float64), dim=-1)
    rates = 4 + 20 * torch.rand(24, generator=generator, dtype=torch.float64)
    phases = 6.28 * torch.rand(24, generator=generator, dtype=torch.float64)
    angles = 0.5 * torch.sin(times_s[:, None] * rates + phases)
    poses = angles[..., None] * axes
    poses[:, 0] += torch.tensor([3.0, 0.3, 0.0], dtype=torch.float64)
    path = torch.stack([1.5 * times_s, 0.05 * torch.sin(12 * times_s), 4 + 0 * times_s], -1)
    return poses, path


def true_joints(clock: Timing, subframes: int = 8) -> np.ndarray:
    """(frames * subframes, 24, 3) at the instants of a joined motion."""
    u = torch.linspace(0, 1, subframes, dtype=torch.float64)
    times = (torch.from_numpy(clock.openings_s)[:, None] + u * clock.exposure_s).flatten()
    poses, path = motion_at(times)
    shaped = load_default_body().to(torch.float64).shape(PERSON.betas.double())
    return shaped.joints_of(axis_angle_to_matrix(poses), path).numpy()


def window_fits(
    clock: Timing, length: int = 2, noise: float = 0.0, usable: np.ndarray | None = None, seed: int = 0
) -> list[WindowFit]:
    """Quadratics nearest to the true motion in every frame of every window, plus errors [rad, m] of that size."""
    frames = len(clock.openings_s)
    generator = torch.Generator().manual_seed(seed)
    fits = []
    for window in plan_windows(np.ones(frames, bool) if usable is None else usable, length):
        pieces = [_quadratic(clock.openings_s[frame], clock.exposure_s) for frame in window.frames]
        rotation, path = (torch.stack(parts) for parts in zip(*pieces, strict=True))
        rotation = rotation + noise * torch.randn(rotation.shape, generator=generator, dtype=torch.float64)
        path = path + noise * torch.randn(path.shape, generator=generator, dtype=torch.float64)
        trajectory = Trajectory(rotation.float(), path.float(), "quaternion", 0.5)
        fits.append(WindowFit(window.frames, window.segment, trajectory, PERSON.betas, None, None, 0.0, 0.0))
    return fits


def with_radius(fits: list[WindowFit], subframes: int = 8) -> list[WindowFit]:
    return [
        replace(found, joint_radius_mm=np.full((len(found.frames), subframes, 24), 10.0 + index))
        for index, found in enumerate(fits)
    ]


def _quadratic(opening_s: float, exposure_s: float) -> tuple[torch.Tensor, torch.Tensor]:
    u = torch.linspace(0, 1, 9, dtype=torch.float64)
    poses, path = motion_at(opening_s + u * exposure_s)
    quaternions = axis_angle_to_quaternion(poses)
    quaternions = torch.where((quaternions * quaternions[4]).sum(-1, keepdim=True) < 0, -quaternions, quaternions)
    powers = (u - 0.5)[:, None] ** torch.arange(3)
    solve = torch.linalg.pinv(powers)
    rotation = torch.einsum("ds,sjc->djc", solve, quaternions)
    translation = torch.cat([solve @ path, torch.zeros(3, 1, dtype=torch.float64)], -1)
    return rotation, translation
