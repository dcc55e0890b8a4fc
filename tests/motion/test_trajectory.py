"""Laws of the polynomial motion and its one clock."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.clock import next_opening, subframe_clock, subframe_times_s
from hfb.motion.trajectory import Trajectory, move_towards_neighbours, trajectory_at_rest

KINDS = ("quaternion", "axis-angle")


def random_poses(frames: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    poses = torch.randn(frames, 24, 3, generator=generator, dtype=torch.float64) * 0.6
    translations = torch.randn(frames, 3, generator=generator, dtype=torch.float64)
    return poses, translations


def moving(trajectory: Trajectory, seed: int = 1, size: float = 0.2) -> Trajectory:
    generator = torch.Generator().manual_seed(seed)
    rotation, translation = trajectory.rotation.clone(), trajectory.translation.clone()
    for coefficients in (rotation, translation):
        coefficients[:, 1:] = size * torch.randn(coefficients[:, 1:].shape, generator=generator, dtype=torch.float64)
    return trajectory.with_coefficients(rotation, translation)


@given(st.integers(2, 64))
def test_the_clock_covers_the_exposure_evenly(subframes: int) -> None:
    u = subframe_clock(subframes, torch.float64).numpy()
    assert u[0] == 0
    assert u[-1] == 1
    np.testing.assert_allclose(np.diff(u), 1 / (subframes - 1))


def test_times_of_several_frames() -> None:
    times_s, index = subframe_times_s(2, 3, exposure_s=0.02, interval_s=0.05)
    np.testing.assert_allclose(times_s, [0, 0.01, 0.02, 0.05, 0.06, 0.07])
    assert index.tolist() == [0, 0, 0, 1, 1, 1]


def test_the_gap_in_subframes_is_the_papers() -> None:
    """The next opening, tau sub-frames after the end, is at u = 1 + tau / (N - 1)."""
    subframes, exposure_s = 8, 0.02
    tau = 3.5
    interval_s = exposure_s + tau * exposure_s / (subframes - 1)
    assert next_opening(exposure_s, interval_s) == pytest.approx(1 + tau / (subframes - 1))


@pytest.mark.parametrize("kind", KINDS)
def test_at_rest_every_subframe_is_the_first_body(kind: str) -> None:
    poses, translations = random_poses(3)
    rotations, path = trajectory_at_rest(poses, translations, 2, kind).at(subframe_clock(5, torch.float64))
    expected = axis_angle_to_matrix(poses)
    torch.testing.assert_close(rotations, expected[:, None].expand_as(rotations), atol=1e-6, rtol=0)
    torch.testing.assert_close(path, translations[:, None].expand_as(path), atol=1e-6, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_at_rest_a_body_can_move_to_all_sides(kind: str) -> None:
    """A distance counted from the start would be 0, and its direction without effect."""
    poses, translations = random_poses(1)
    still = trajectory_at_rest(poses, translations, 2, kind)

    def place(constants: torch.Tensor) -> torch.Tensor:
        translation = torch.cat([constants, still.translation[0, 1:]])[None]
        return still.with_coefficients(still.rotation, translation).at(torch.zeros(1, dtype=torch.float64))[1][0, 0]

    moves = torch.autograd.functional.jacobian(place, still.translation[0, :1])
    assert torch.linalg.matrix_rank(moves.flatten(1)) == 3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("origin", [0.0, 0.5])
def test_rotations_are_rotations(kind: str, origin: float) -> None:
    trajectory = moving(trajectory_at_rest(*random_poses(2), 3, kind, origin))
    rotations, _ = trajectory.at(subframe_clock(6, torch.float64))
    identity = torch.eye(3, dtype=torch.float64).expand_as(rotations)
    torch.testing.assert_close(rotations @ rotations.mT, identity, atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(2, 6, 24, dtype=torch.float64))


def test_reversed_time_visits_the_same_bodies() -> None:
    """c(u) -> c(1 - u) of a polynomial about the middle flips the odd coefficients."""
    trajectory = moving(trajectory_at_rest(*random_poses(1), 3, "quaternion", 0.5))
    sign = torch.tensor([1.0, -1, 1, -1], dtype=torch.float64)
    backwards = trajectory.with_coefficients(
        trajectory.rotation * sign[:, None, None], trajectory.translation * sign[:, None]
    )
    u = subframe_clock(8, torch.float64)
    for ahead, back in zip(trajectory.at(u), backwards.at(u), strict=True):
        torch.testing.assert_close(ahead, back.flip(1))


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_at_rest_are_finite_and_match_finite_differences(kind: str) -> None:
    poses, translations = random_poses(1)
    poses[:, :3] = 0  # the singular angle must not matter
    trajectory = trajectory_at_rest(poses, translations, 2, kind)
    u = subframe_clock(3, torch.float64)

    def values(rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        rotations, path = trajectory.with_coefficients(rotation, translation).at(u)
        return torch.cat([rotations.flatten(), path.flatten()])

    inputs = (trajectory.rotation.requires_grad_(), trajectory.translation.requires_grad_())
    assert torch.autograd.gradcheck(values, inputs, fast_mode=True)


def test_neighbours_give_the_first_velocity() -> None:
    """Frames along a straight line at constant speed: every frame starts with that speed."""
    poses = torch.zeros(4, 24, 3, dtype=torch.float64)
    velocity = torch.tensor([0.3, -0.1, 0.2], dtype=torch.float64)
    interval_u = 1.25
    translations = torch.arange(4, dtype=torch.float64)[:, None] * velocity * interval_u
    trajectory = move_towards_neighbours(trajectory_at_rest(poses, translations, 2), interval_u)
    torch.testing.assert_close(trajectory.translation[:, 1, :3], velocity.expand(4, 3))
    assert trajectory.rotation[:, 1].abs().max() == 0
