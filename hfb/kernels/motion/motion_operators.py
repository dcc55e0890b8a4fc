"""Quaternion polynomials, logarithms and the boundary restriction as torch operators.

As operators they work with autograd, torch.compile and export.
"""

from typing import Any

from hfb.kernels.motion import motion_boundary as kernels_boundary
from hfb.kernels.motion import motion_curve as kernels
from hfb.kernels.motion import motion_rotation as kernels_rotation
from hfb.kernels.torch_op import arrays, measure, operator
from hfb.typing import Tensor


@operator("hfb::move")
def move(rotation: Tensor, translation: Tensor, clock: Tensor, origin: float) -> tuple[Tensor, Tensor]:
    """Return rotation matrices (T, S, 24, 3, 3) of the normalised quaternion polynomials, and the path (T, S, 3) [m].

    Args:
        rotation: coefficients (T, D1, 24, 4), (w, x, y, z).
        translation: (T, D1, 4) [m], the last column unused.
        clock: (S), the instants u.
        origin: polynomials are in u - origin.
    """
    frames, instants = len(rotation), len(clock)
    matrices = rotation.new_empty(frames, instants, rotation.shape[2], 3, 3)
    path = rotation.new_empty(frames, instants, 3)
    kernels.move(*arrays(rotation, translation, clock), origin, matrices.numpy(), path.numpy())
    return matrices, path


@move.register_fake
def _(rotation: Tensor, translation: Tensor, clock: Tensor, origin: float) -> tuple[Tensor, Tensor]:
    size = rotation.shape[0], clock.shape[0]
    return rotation.new_empty(*size, rotation.shape[2], 3, 3), rotation.new_empty(*size, 3)


@operator("hfb::move_gradient")
def move_gradient(
    rotation: Tensor, translation: Tensor, clock: Tensor, of_matrices: Tensor, of_path: Tensor, origin: float
) -> tuple[Tensor, Tensor]:
    """Return the gradients by the coefficients.

    Args:
        rotation: (T, D1, 24, 4), coefficients of the quaternions.
        translation: (T, D1, 4), coefficients of the path [m].
        clock: (S), times in exposures.
        of_matrices: gradient by the matrices.
        of_path: gradient by the path.
        origin: time at which powers are zero.
    """
    of_rotation, of_translation = rotation.new_zeros(rotation.shape), translation.new_zeros(translation.shape)
    polynomials, instants, *grad_outputs = arrays(rotation, clock, of_matrices, of_path)
    kernels.move_gradient(polynomials, instants, origin, *grad_outputs, of_rotation.numpy(), of_translation.numpy())
    return of_rotation, of_translation


@move_gradient.register_fake
def _(rotation: Tensor, translation: Tensor, *_: Any) -> tuple[Tensor, Tensor]:
    return rotation.new_empty(rotation.shape), translation.new_empty(translation.shape)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    *tensors, ctx.origin = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx, of_matrices, of_path):  # type: ignore[no-untyped-def]
    return *move_gradient(*ctx.saved_tensors, of_matrices, of_path, ctx.origin), None, None


move.register_autograd(_backward, _keep)


@measure("hfb::boundary", moving=2)
def boundary(rotations: Tensor, joints: Tensor, step: float) -> tuple[Tensor, Tensor, Tensor]:
    """Return `hfb.objective.boundary.boundary_loss` and its gradients.

    Values are those of every frame at the next frame's opening and at its own: a `step` before, then, and a step after.

    Args:
        rotations: (T, 6, 24, 3, 3).
        joints: (T, 6, 24, 3) [m].
        step: time between neighbouring instants, in exposures.
    """
    gradients = rotations.new_empty(rotations.shape), joints.new_empty(joints.shape)
    inputs = [one.reshape(*one.shape[:2], -1) for one in arrays(rotations, joints, *gradients)]
    return rotations.new_tensor(kernels_boundary.boundary(*inputs[:2], step, *inputs[2:])), *gradients


@operator("hfb::rotation_vectors")
def rotation_vectors(matrices: Tensor, instants: int) -> Tensor:
    """Return the rotation vectors (T, instants, J - 1, 3) [rad] below the root at each frame's first instants.

    Angles are in [0, pi], as of `hfb.geometry.rotations.matrix_to_axis_angle`; the gradient is that along rotations,
    which alone has a meaning.

    Args:
        matrices: (T, S, J, 3, 3), rotations.
        instants: number of the frame's first instants.
    """
    frames, _, joints = matrices.shape[:3]
    vectors = matrices.new_empty(frames, instants, joints - 1, 3)
    kernels_rotation.logarithm(*arrays(matrices, vectors))
    return vectors


@rotation_vectors.register_fake
def _(matrices: Tensor, instants: int) -> Tensor:
    return matrices.new_empty(matrices.shape[0], instants, matrices.shape[2] - 1, 3)


@operator("hfb::rotation_vectors_gradient")
def rotation_vectors_gradient(matrices: Tensor, vectors: Tensor, grad_output: Tensor) -> Tensor:
    """Return the gradient by the matrices.

    Args:
        matrices: (T, S, J, 3, 3), rotations.
        vectors: result of `rotation_vectors`.
        grad_output: gradient by the vectors.
    """
    gradient = matrices.new_zeros(matrices.shape)
    kernels_rotation.logarithm_gradient(*arrays(matrices, vectors, grad_output, gradient))
    return gradient


@rotation_vectors_gradient.register_fake
def _(matrices: Tensor, vectors: Tensor, grad_output: Tensor) -> Tensor:
    return matrices.new_empty(matrices.shape)


def _keep_logarithm(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(inputs[0], output)


def _logarithm_backward(ctx, grad_output):  # type: ignore[no-untyped-def]
    return rotation_vectors_gradient(*ctx.saved_tensors, grad_output), None


rotation_vectors.register_autograd(_logarithm_backward, _keep_logarithm)
