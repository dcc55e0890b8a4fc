"""Rescaling of a path for other betas, as a torch operator.

The readable formula that it is tested against is `hfb.motion.trajectory.Trajectory.enlarged`.
"""

from hfb.kernels.motion import rescale_kernels as kernels
from hfb.kernels.torch_op import arrays, operator
from hfb.typing import Tensor


@operator("hfb::as_large")
def as_large(
    translation: Tensor, betas: Tensor, reference: Tensor, template: Tensor, rows: Tensor, parents: Tensor
) -> Tensor:
    """Return coefficients (T, D1, 4) of a path [m] rescaled so that a person with `betas` looks as large in the image.

    Args:
        translation: (T, D1, 4), coefficients of the path [m].
        betas: (K), shape coefficients.
        reference: (K), shape for which `translation` holds; a constant.
        template: (24, 3), rest joints with betas of zero [m]; a constant.
        rows: (K, 72), their displacements per unit of each beta [m]; a constant.
        parents: (24) int32, -1 for the root, which comes first; a constant.
    """
    moved = translation.new_empty(translation.shape)
    kernels.as_large(*arrays(translation, betas, reference, template.flatten(), rows, parents, moved))
    return moved


@as_large.register_fake
def _(translation: Tensor, *_: Tensor) -> Tensor:
    return translation.new_empty(translation.shape)


@operator("hfb::as_large_gradient")
def as_large_gradient(
    translation: Tensor,
    betas: Tensor,
    reference: Tensor,
    template: Tensor,
    rows: Tensor,
    parents: Tensor,
    grad_output: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the gradients by the coefficients and by the betas.

    Args:
        translation: (T, D1, 4), coefficients of the path [m].
        betas: (K), shape coefficients.
        reference: (K), shape for which `translation` holds; a constant.
        template: (24, 3), rest joints with betas of zero [m]; a constant.
        rows: (K, 72), their displacements per unit of each beta [m]; a constant.
        parents: (24) int32, -1 for the root, which comes first; a constant.
        grad_output: gradient by the rescaled coefficients.
    """
    gradients = translation.new_empty(translation.shape), betas.new_empty(betas.shape)
    people = arrays(translation, betas, reference, template.flatten(), rows, parents, grad_output)
    kernels.as_large_gradient(*people, *arrays(*gradients))
    return gradients


@as_large_gradient.register_fake
def _(translation: Tensor, betas: Tensor, *_: Tensor) -> tuple[Tensor, Tensor]:
    return translation.new_empty(translation.shape), betas.new_empty(betas.shape)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs)


def _backward(ctx, grad_output):  # type: ignore[no-untyped-def]
    return *as_large_gradient(*ctx.saved_tensors, grad_output), None, None, None, None


as_large.register_autograd(_backward, _keep)
