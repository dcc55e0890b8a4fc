"""Quaternion polynomials and logarithms as torch operators, so that autograd, torch.compile and export see them."""

from hfb.motion import kernels_curve as kernels
from hfb.motion import kernels_rotation
from hfb.shapes import Tensor
from hfb.torch_operator import operator


@operator("hfb::turn")
def turn(coefficients: Tensor, powers: Tensor) -> Tensor:
    """Rotation matrices (T, S, 24, 3, 3) of the normalised quaternion polynomials.

    Args:
        coefficients: (T, D1, 24, 4), (w, x, y, z). powers: (S, D1), the instants to the power of 0 ... D.
    """
    matrices = coefficients.new_empty(len(coefficients), len(powers), coefficients.shape[2], 3, 3)
    kernels.turn(coefficients.detach().contiguous().numpy(), powers.contiguous().numpy(), matrices.numpy())
    return matrices


@turn.register_fake
def _(coefficients: Tensor, powers: Tensor) -> Tensor:
    return coefficients.new_empty(coefficients.shape[0], powers.shape[0], coefficients.shape[2], 3, 3)


@operator("hfb::turn_gradient")
def turn_gradient(coefficients: Tensor, powers: Tensor, given: Tensor) -> Tensor:
    """Gradient of the coefficients."""
    gradient = coefficients.new_zeros(coefficients.shape)
    arrays = (tensor.detach().contiguous().numpy() for tensor in (coefficients, powers, given))
    kernels.turn_gradient(*arrays, gradient.numpy())
    return gradient


@turn_gradient.register_fake
def _(coefficients: Tensor, powers: Tensor, given: Tensor) -> Tensor:
    return coefficients.new_empty(coefficients.shape)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs)


def _backward(ctx, given):  # type: ignore[no-untyped-def]
    return turn_gradient(*ctx.saved_tensors, given), None


turn.register_autograd(_backward, _keep)


@operator("hfb::rotation_vectors")
def rotation_vectors(matrices: Tensor) -> Tensor:
    """Axis times angle (n, 3), the angle in [0, pi], of rotation matrices (n, 3, 3).

    As `hfb.rotations.matrix_to_axis_angle`; the gradient is that along rotations, which alone has a meaning.
    """
    vectors = matrices.new_empty(len(matrices), 3)
    kernels_rotation.logarithm(matrices.detach().contiguous().numpy(), vectors.numpy())
    return vectors


@rotation_vectors.register_fake
def _(matrices: Tensor) -> Tensor:
    return matrices.new_empty(matrices.shape[0], 3)


@operator("hfb::rotation_vectors_gradient")
def rotation_vectors_gradient(matrices: Tensor, vectors: Tensor, given: Tensor) -> Tensor:
    """Gradient of the matrices."""
    gradient = matrices.new_empty(matrices.shape)
    arrays = (tensor.detach().contiguous().numpy() for tensor in (matrices, vectors, given))
    kernels_rotation.logarithm_gradient(*arrays, gradient.numpy())
    return gradient


@rotation_vectors_gradient.register_fake
def _(matrices: Tensor, vectors: Tensor, given: Tensor) -> Tensor:
    return matrices.new_empty(matrices.shape)


def _keep_logarithm(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs, output)


def _logarithm_backward(ctx, given):  # type: ignore[no-untyped-def]
    return rotation_vectors_gradient(*ctx.saved_tensors, given)


rotation_vectors.register_autograd(_logarithm_backward, _keep_logarithm)
