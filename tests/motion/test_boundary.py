"""The boundary restriction is zero exactly for motions that continue."""

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.motion.trajectory import Trajectory, trajectory_at_rest
from hfb.objective.boundary import boundary_loss
from tests.motion.test_trajectory import moving, random_poses


def split_quadratic(interval_u: float) -> Trajectory:
    """One quadratic path of the translation, cut into three exposures."""
    poses = random_poses(1)[0].expand(3, 24, 3)
    first, velocity, acceleration = torch.randn(3, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    trajectory = trajectory_at_rest(poses, torch.zeros(3, 3, dtype=torch.float64), 2)
    translation = trajectory.translation.clone()
    for frame in range(3):
        t = frame * interval_u
        translation[frame, 0, :3] = first + velocity * t + acceleration * t**2
        translation[frame, 1, :3] = velocity + 2 * acceleration * t
        translation[frame, 2, :3] = acceleration
    return trajectory.with_coefficients(trajectory.rotation, translation)


@pytest.mark.parametrize("interval_u", [1.0, 1.4])
def test_a_continuing_motion_costs_nothing(interval_u: float) -> None:
    shaped = load_default_body(torch.float64).shape(torch.zeros(10, dtype=torch.float64))
    trajectory = split_quadratic(interval_u)
    assert boundary_loss(trajectory, shaped, interval_u) < 1e-9
    assert boundary_loss(trajectory, shaped, interval_u + 0.3) > 1e-3


def test_a_single_frame_has_no_boundary() -> None:
    shaped = load_default_body().shape(torch.zeros(10))
    trajectory = trajectory_at_rest(torch.zeros(1, 24, 3), torch.zeros(1, 3), 2)
    assert boundary_loss(trajectory, shaped, 1.0) == 0


def test_quaternion_signs_do_not_matter() -> None:
    shaped = load_default_body(torch.float64).shape(torch.zeros(10, dtype=torch.float64))
    trajectory = moving(trajectory_at_rest(*random_poses(2), 2))
    rotation = trajectory.rotation.clone()
    rotation[1] *= -1
    flipped = trajectory.with_coefficients(rotation, trajectory.translation)
    torch.testing.assert_close(boundary_loss(trajectory, shaped, 1.2), boundary_loss(flipped, shaped, 1.2))


def test_its_gradient_matches_finite_differences() -> None:
    shaped = load_default_body(torch.float64).shape(torch.zeros(10, dtype=torch.float64))
    trajectory = moving(trajectory_at_rest(*random_poses(2), 2))

    def loss(rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        return boundary_loss(trajectory.with_coefficients(rotation, translation), shaped, 1.2)

    inputs = (trajectory.rotation.requires_grad_(), trajectory.translation.requires_grad_())
    assert torch.autograd.gradcheck(loss, inputs, fast_mode=True)
