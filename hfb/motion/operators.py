"""Quaternion polynomials and logarithms as torch operators, so that autograd, torch.compile and export see them."""

from hfb.motion import kernels_curve as kernels
from hfb.motion import kernels_rotation
from hfb.shapes import Tensor
from hfb.torch_operator import operator


@operator("hfb::move")
def move(rotation: Tensor, translation: Tensor, clock: Tensor, origin: float) -> tuple[Tensor, Tensor]:
    """Rotation matrices (T, S, 24, 3, 3) of the normalised quaternion polynomials, and the path (T, S, 3) [m].

    Args:
        rotation: coefficients (T, D1, 24, 4), (w, x, y, z). translation: (T, D1, 4) [m], the last column unused.
        clock: (S), the instants u. origin: polynomials are in u - origin.
    """
    frames, instants = len(rotation), len(clock)
    matrices = rotation.new_empty(frames, instants, rotation.shape[2], 3, 3)
    path = rotation.new_empty(frames, instants, 3)
    arrays = (tensor.detach().contiguous().numpy() for tensor in (rotation, translation, clock))
    kernels.move(*arrays, origin, matrices.numpy(), path.numpy())
    return matrices, path


@move.register_fake
def _(rotation: Tensor, translation: Tensor, clock: Tensor, origin: float) -> tuple[Tensor, Tensor]:
    size = rotation.shape[0], clock.shape[0]
    return rotation.new_empty(*size, rotation.shape[2], 3, 3), rotation.new_empty(*size, 3)


@operator("hfb::move_gradient")
def move_gradient(
    rotation: Tensor, translation: Tensor, clock: Tensor, of_matrices: Tensor, of_path: Tensor, origin: float
) -> tuple[Tensor, Tensor]:
    """Gradients of the coefficients."""
    of_rotation, of_translation = rotation.new_zeros(rotation.shape), translation.new_zeros(translation.shape)
    polynomials, instants, *given = (
        tensor.detach().contiguous().numpy() for tensor in (rotation, clock, of_matrices, of_path)
    )
    kernels.move_gradient(polynomials, instants, origin, *given, of_rotation.numpy(), of_translation.numpy())
    return of_rotation, of_translation


@move_gradient.register_fake
def _(
    rotation: Tensor, translation: Tensor, clock: Tensor, of_matrices: Tensor, of_path: Tensor, origin: float
) -> tuple[Tensor, Tensor]:
    return rotation.new_empty(rotation.shape), translation.new_empty(translation.shape)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    *tensors, ctx.origin = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx, of_matrices, of_path):  # type: ignore[no-untyped-def]
    return *move_gradient(*ctx.saved_tensors, of_matrices, of_path, ctx.origin), None, None


move.register_autograd(_backward, _keep)


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
