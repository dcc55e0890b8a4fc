"""Compiled quaternion polynomials against the readable formula."""

import pytest
import torch

from hfb.motion.operators import rotation_vectors, turn
from hfb.rotations import axis_angle_to_matrix, matrix_to_axis_angle, normalize_quaternion, quaternion_to_matrix


def test_matrices_and_gradients_are_the_readable_ones() -> None:
    generator = torch.Generator().manual_seed(0)
    coefficients = torch.randn(2, 3, 24, 4, generator=generator, dtype=torch.float64).requires_grad_()
    powers = torch.rand(5, 1, generator=generator, dtype=torch.float64) ** torch.arange(3)
    weights = torch.randn(2, 5, 24, 3, 3, generator=generator, dtype=torch.float64)
    fast = turn(coefficients, powers)
    slow = quaternion_to_matrix(normalize_quaternion(torch.einsum("sd,tdjc->tsjc", powers, coefficients)))
    torch.testing.assert_close(fast, slow, rtol=0, atol=1e-13)
    gradients = [torch.autograd.grad((matrices * weights).sum(), coefficients)[0] for matrices in (fast, slow)]
    assert (gradients[0] - gradients[1]).norm() <= 1e-13 * gradients[1].norm()


def test_the_operator_is_well_formed() -> None:
    coefficients = torch.randn(1, 3, 24, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    powers = torch.tensor([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0]], dtype=torch.float64)
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(turn.registered, (coefficients.requires_grad_(), powers), test_utils=checks)
    assert torch.autograd.gradcheck(
        lambda given: turn(given, powers), (coefficients[:, :, :3].detach().requires_grad_(),)
    )


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 0.5, 3.0, torch.pi - 1e-3])
def test_logarithms_and_their_gradients_are_the_readable_ones(angle: float) -> None:
    """At all angles, in every direction (each pivot of Shepperd's method is the largest somewhere near pi)."""
    generator = torch.Generator().manual_seed(0)
    axes = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator, dtype=torch.float64), dim=-1)
    weights = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    results = []
    for logarithm in (rotation_vectors, matrix_to_axis_angle):
        given = (angle * axes).requires_grad_()
        vectors = logarithm(axis_angle_to_matrix(given))
        (vectors * weights).sum().backward()
        results.append((vectors.detach(), given.grad))
    torch.testing.assert_close(results[0][0], angle * axes, rtol=0, atol=2e-8 if angle < 1e-6 else 1e-10)
    torch.testing.assert_close(results[0][1], weights, rtol=0, atol=1e-6)
    if angle > 1e-6:
        torch.testing.assert_close(results[0][1], results[1][1], rtol=0, atol=1e-6)


def test_the_logarithm_is_well_formed() -> None:
    matrices = axis_angle_to_matrix(torch.tensor([[0.1, 0.2, 0.3], [0.0, 3.0, 0.0]], dtype=torch.float64))
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(rotation_vectors.registered, (matrices.requires_grad_(),), test_utils=checks)
