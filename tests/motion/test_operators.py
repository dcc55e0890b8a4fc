"""Compiled motions against the readable formulas."""

import pytest
import torch

from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.kernels.dispatch import readable_formulas
from hfb.kernels.motion.motion_operators import move, rotation_vectors
from hfb.motion.trajectory import Trajectory


def test_motions_and_gradients_are_the_readable_ones() -> None:
    generator = torch.Generator().manual_seed(0)
    rotation = torch.randn(2, 3, 24, 4, generator=generator, dtype=torch.float64).requires_grad_()
    translation = torch.randn(2, 3, 4, generator=generator, dtype=torch.float64).requires_grad_()
    trajectory = Trajectory(rotation, translation, origin=0.3)
    clock = torch.rand(5, generator=generator, dtype=torch.float64)
    weights = torch.randn(2, 5, 24, 3, 3, generator=generator, dtype=torch.float64)
    pulls = torch.randn(2, 5, 3, generator=generator, dtype=torch.float64)
    fast = trajectory.at(clock)
    with readable_formulas():
        slow = trajectory.at(clock)
    torch.testing.assert_close(fast, slow, rtol=0, atol=1e-13)
    gradients = [
        torch.autograd.grad((matrices * weights).sum() + (path * pulls).sum(), (rotation, translation))
        for matrices, path in (fast, slow)
    ]
    for ours, expected in zip(*gradients, strict=True):
        assert (ours - expected).norm() <= 1e-13 * expected.norm()


def test_the_operator_is_well_formed() -> None:
    generator = torch.Generator().manual_seed(0)
    rotation = torch.randn(1, 3, 24, 4, generator=generator, dtype=torch.float64).requires_grad_()
    translation = torch.randn(1, 3, 4, generator=generator, dtype=torch.float64).requires_grad_()
    clock = torch.tensor([0.5, 1.5], dtype=torch.float64)
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(move.registered, (rotation, translation, clock, 0.5), test_utils=checks)
    some = rotation[:, :, :3].detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda *given: move(*given, clock, 0.5), (some, translation))


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 0.5, 3.0, torch.pi - 1e-3])
def test_logarithms_and_their_gradients_are_the_readable_ones(angle: float) -> None:
    """At all angles, in every direction (each pivot of Shepperd's method is the largest somewhere near pi)."""
    generator = torch.Generator().manual_seed(0)
    axes = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator, dtype=torch.float64), dim=-1)
    weights = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    results = []
    for compiled in (True, False):
        given = (angle * axes).requires_grad_()
        matrices = axis_angle_to_matrix(given)
        below = torch.stack([matrices.detach(), matrices], 1)[:, None]  # of two joints, the root first
        vectors = rotation_vectors(below, 1)[:, 0, 0] if compiled else matrix_to_axis_angle(matrices)
        (vectors * weights).sum().backward()
        results.append((vectors.detach(), given.grad))
    torch.testing.assert_close(results[0][0], angle * axes, rtol=0, atol=2e-8 if angle < 1e-6 else 1e-10)
    torch.testing.assert_close(results[0][1], weights, rtol=0, atol=1e-6)
    if angle > 1e-6:
        torch.testing.assert_close(results[0][1], results[1][1], rtol=0, atol=1e-6)


def test_the_logarithm_is_well_formed() -> None:
    matrices = axis_angle_to_matrix(torch.tensor([[0.1, 0.2, 0.3], [0.0, 3.0, 0.0]], dtype=torch.float64))
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    whole = matrices.expand(2, 4, 2, 3, 3).contiguous().requires_grad_()
    torch.library.opcheck(rotation_vectors.registered, (whole, 3), test_utils=checks)
    vectors = rotation_vectors(whole, 3)
    torch.testing.assert_close(vectors, matrix_to_axis_angle(whole[:, :3, 1:]), rtol=0, atol=1e-9)
    vectors.sum().backward()
    assert whole.grad[:, :3, 1:].any()
    assert not whole.grad[:, 3].any()
    assert not whole.grad[:, :, 0].any()
