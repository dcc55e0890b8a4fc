"""Rotations obey the axioms of their group, round trips and finite differences: uniformly, near 0 and near pi."""

import math
from collections.abc import Callable

import pytest
import torch

from hfb.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    in_hemisphere_of,
    matrix_to_axis_angle,
    matrix_to_quaternion,
    multiply_quaternions,
    normalize_quaternion,
    quaternion_to_axis_angle,
    quaternion_to_matrix,
    six_d_to_matrix,
)
from tests.angles import angle_between

COUNT = 200


def _unit(count: int, size: int, generator: torch.Generator) -> torch.Tensor:
    vectors = torch.randn(count, size, dtype=torch.float64, generator=generator)
    return vectors / vectors.norm(dim=-1, keepdim=True)


def _sample(where: str, seed: int = 0) -> torch.Tensor:
    """(COUNT, 3) axis-angle vectors [rad]."""
    generator = torch.Generator().manual_seed(seed)
    axes = _unit(COUNT, 3, generator)
    jitter = torch.rand(COUNT, 1, dtype=torch.float64, generator=generator)
    match where:
        case "uniform":  # a uniform direction in R^4 is a uniform rotation
            return quaternion_to_axis_angle(_unit(COUNT, 4, generator))
        case "tangent":
            return torch.randn(COUNT, 3, dtype=torch.float64, generator=generator)
        case "near zero":
            return axes * 1e-7 * jitter
        case "around the series' border":
            return axes * 2e-4 * (0.9 + 0.2 * jitter)
        case "near pi":
            return axes * (math.pi - 1e-7 * jitter)
        case "about the axes by pi":
            return torch.eye(3, dtype=torch.float64).repeat(COUNT, 1)[:COUNT] * math.pi
        case "zero":
            return torch.zeros(COUNT, 3, dtype=torch.float64)
    raise AssertionError(where)


PLACES = ["uniform", "tangent", "near zero", "around the series' border", "near pi", "about the axes by pi", "zero"]


@pytest.fixture(params=PLACES)
def axis_angle(request: pytest.FixtureRequest) -> torch.Tensor:
    return _sample(request.param)


def close(actual: torch.Tensor, expected: torch.Tensor, atol: float = 1e-14) -> None:
    torch.testing.assert_close(actual, expected, atol=atol, rtol=1e-12)


def test_matrices_are_rotations(axis_angle: torch.Tensor) -> None:
    matrix = axis_angle_to_matrix(axis_angle)
    close(matrix @ matrix.mT, torch.eye(3, dtype=torch.float64).expand_as(matrix))
    close(torch.linalg.det(matrix), torch.ones(COUNT, dtype=torch.float64))


def test_rodrigues_is_the_exponential_of_the_cross_product(axis_angle: torch.Tensor) -> None:
    x, y, z = axis_angle.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    close(axis_angle_to_matrix(axis_angle), torch.linalg.matrix_exp(cross))


def test_the_axis_stays(axis_angle: torch.Tensor) -> None:
    close((axis_angle_to_matrix(axis_angle) @ axis_angle[..., None]).squeeze(-1), axis_angle)


def test_quaternions_are_units(axis_angle: torch.Tensor) -> None:
    close(axis_angle_to_quaternion(axis_angle).norm(dim=-1), torch.ones(COUNT, dtype=torch.float64))
    close(matrix_to_quaternion(axis_angle_to_matrix(axis_angle)).norm(dim=-1), torch.ones(COUNT, dtype=torch.float64))


def test_round_trips_of_the_matrix(axis_angle: torch.Tensor) -> None:
    """Exact for every rotation, also where the axis-angle vector is ambiguous."""
    matrix = axis_angle_to_matrix(axis_angle)
    close(quaternion_to_matrix(matrix_to_quaternion(matrix)), matrix)
    close(axis_angle_to_matrix(matrix_to_axis_angle(matrix)), matrix)
    close(axis_angle_to_matrix(quaternion_to_axis_angle(axis_angle_to_quaternion(axis_angle))), matrix)


@pytest.mark.parametrize("where", ["uniform", "near zero", "around the series' border", "near pi", "zero"])
def test_round_trips_of_the_vector(where: str) -> None:
    axis_angle = _sample(where)
    assert (axis_angle.norm(dim=-1) <= math.pi).all()
    close(quaternion_to_axis_angle(axis_angle_to_quaternion(axis_angle)), axis_angle)
    close(matrix_to_axis_angle(axis_angle_to_matrix(axis_angle)), axis_angle)


def test_a_long_vector_comes_back_shortened() -> None:
    axis_angle = _sample("tangent") * 3
    shortened = matrix_to_axis_angle(axis_angle_to_matrix(axis_angle))
    assert (shortened.norm(dim=-1) <= math.pi + 1e-12).all()
    close(axis_angle_to_matrix(shortened), axis_angle_to_matrix(axis_angle), atol=1e-13)


def test_inverse_and_identity(axis_angle: torch.Tensor) -> None:
    quaternion, inverse = axis_angle_to_quaternion(axis_angle), axis_angle_to_quaternion(-axis_angle)
    one = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).expand(COUNT, 4)
    close(multiply_quaternions(quaternion, inverse), one)
    close(multiply_quaternions(quaternion, one), quaternion)
    close(multiply_quaternions(one, quaternion), quaternion)
    close(axis_angle_to_matrix(-axis_angle), axis_angle_to_matrix(axis_angle).mT)


def test_products_associate_and_agree_with_matrices(axis_angle: torch.Tensor) -> None:
    a, b, c = (
        axis_angle_to_quaternion(v) for v in (axis_angle, _sample("uniform", seed=1), _sample("tangent", seed=2))
    )
    close(multiply_quaternions(multiply_quaternions(a, b), c), multiply_quaternions(a, multiply_quaternions(b, c)))
    close(quaternion_to_matrix(multiply_quaternions(a, b)), quaternion_to_matrix(a) @ quaternion_to_matrix(b))


def test_opposite_quaternions_are_one_rotation(axis_angle: torch.Tensor) -> None:
    quaternion = axis_angle_to_quaternion(axis_angle)
    close(quaternion_to_matrix(-quaternion), quaternion_to_matrix(quaternion))
    reference = axis_angle_to_quaternion(_sample("uniform", seed=3))
    near = in_hemisphere_of(quaternion, reference)
    assert ((near * reference).sum(-1) >= 0).all()
    close(in_hemisphere_of(-quaternion, reference), near)
    generic = quaternion[:, :1].abs() > 1e-3  # at half a turn the two logarithms point opposite ways
    logarithms = quaternion_to_axis_angle(quaternion), quaternion_to_axis_angle(-quaternion)
    close(torch.where(generic, logarithms[0], 0.0), torch.where(generic, logarithms[1], 0.0))


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 1.0, math.pi - 1e-7, math.pi])
def test_an_angle_between_rotations_is_accurate_everywhere(angle: float) -> None:
    left = axis_angle_to_matrix(_sample("uniform"))
    turn = _unit(COUNT, 3, torch.Generator().manual_seed(4)) * angle
    measured = angle_between(left, left @ axis_angle_to_matrix(turn))
    close(measured, torch.full((COUNT,), angle, dtype=torch.float64), atol=1e-14)


def test_six_d_is_the_first_two_columns(axis_angle: torch.Tensor) -> None:
    matrix = axis_angle_to_matrix(axis_angle)
    six_d = matrix[..., :2].mT.flatten(-2)
    close(six_d_to_matrix(six_d), matrix)
    skewed = torch.cat([2 * six_d[..., :3], 0.5 * six_d[..., 3:] + 3 * six_d[..., :3]], -1)
    close(six_d_to_matrix(skewed), matrix, atol=1e-13)


def test_normalizing_zero_is_finite() -> None:
    zero = torch.zeros(2, 4, requires_grad=True)
    unit = normalize_quaternion(zero)
    unit.sum().backward()
    assert torch.isfinite(unit).all()
    assert zero.grad is not None
    assert torch.isfinite(zero.grad).all()
    close(
        normalize_quaternion(torch.tensor([[0.0, 0, 3, 4]], dtype=torch.float64)),
        torch.tensor([[0.0, 0, 0.6, 0.8]], dtype=torch.float64),
    )


def _logarithm_of_product(axis_angle: torch.Tensor) -> torch.Tensor:
    """A composite as in a fit: turn, multiply, back to a vector (away from half a turn, where it jumps)."""
    half = axis_angle_to_matrix(axis_angle / 2)
    return matrix_to_axis_angle(half @ axis_angle_to_matrix(torch.full_like(axis_angle, 0.1)))


@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize(
    "function", [axis_angle_to_quaternion, axis_angle_to_matrix, _logarithm_of_product], ids=lambda f: f.__name__
)
def test_gradients_are_finite_differences(function: Callable, where: str) -> None:
    _check_gradient(function, _sample(where)[:40])


@pytest.mark.parametrize("where", ["uniform", "near zero", "around the series' border", "zero"])
def test_gradient_of_the_logarithm(where: str) -> None:
    """With respect to a quaternion that need not stay a unit, and to the entries of a matrix."""
    quaternion = axis_angle_to_quaternion(_sample(where)[:40])
    _check_gradient(lambda q: quaternion_to_axis_angle(normalize_quaternion(q)), quaternion)
    _check_gradient(matrix_to_quaternion, quaternion_to_matrix(quaternion))
    _check_gradient(six_d_to_matrix, quaternion_to_matrix(quaternion)[..., :2].mT.flatten(-2))


def _check_gradient(function: Callable, at: torch.Tensor) -> None:
    at = at.clone().requires_grad_()
    generator = torch.Generator().manual_seed(5)
    value = function(at)
    probe = torch.randn(value.shape, dtype=torch.float64, generator=generator)
    (gradient,) = torch.autograd.grad((probe * value).sum(), at)
    assert torch.isfinite(gradient).all()
    direction = torch.randn(at.shape, dtype=torch.float64, generator=generator)
    rows = tuple(range(1, at.dim()))
    value_rows = tuple(range(1, value.dim()))
    step = 1e-5
    with torch.no_grad():
        ahead, behind = ((probe * function(at + s * step * direction)).sum(value_rows) for s in (1, -1))
    expected = (ahead - behind) / (2 * step)
    torch.testing.assert_close((gradient * direction).sum(rows), expected, rtol=1e-6, atol=1e-7)


def test_float32_is_accurate(axis_angle: torch.Tensor) -> None:
    single = axis_angle.float()
    matrix = axis_angle_to_matrix(single)
    assert matrix.dtype == torch.float32
    torch.testing.assert_close(matrix.double(), axis_angle_to_matrix(axis_angle), atol=1e-6, rtol=0)
    back = axis_angle_to_matrix(matrix_to_axis_angle(matrix))
    torch.testing.assert_close(back, matrix, atol=2e-6, rtol=0)
    single = single.clone().requires_grad_()
    matrix_to_axis_angle(axis_angle_to_matrix(single)).square().sum().backward()
    assert single.grad is not None
    assert torch.isfinite(single.grad).all()


def test_any_leading_dimensions() -> None:
    for shape in ((), (1,), (2, 0), (2, 3, 4)):
        axis_angle = torch.zeros(*shape, 3)
        assert axis_angle_to_matrix(axis_angle).shape == (*shape, 3, 3)
        assert matrix_to_axis_angle(axis_angle_to_matrix(axis_angle)).shape == (*shape, 3)
