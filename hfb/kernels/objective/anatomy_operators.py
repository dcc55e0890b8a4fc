"""The anatomical prior as a torch operator, for autograd, torch.compile and export."""

from hfb.kernels.objective import anatomy_kernels as kernels
from hfb.kernels.torch_op import operator
from hfb.typing import Tensor


@operator("hfb::anatomy")
def anatomy(poses: Tensor, order: Tensor, tables: Tensor, softness: float) -> tuple[Tensor, Tensor]:
    """Return values (S) of `hfb.priors.anatomy.AnatomicalPrior` and their gradient.

    Args:
        poses: (S, 23, 3), axis-angle [rad].
        order: (23, 3), the axes of twist and swing.
        tables: (4, 23, 3) float64, lowest, highest, mean, spread [rad].
        softness: width over which the limits set in [rad].
    """
    values, gradient = poses.new_empty(len(poses)), poses.new_empty(poses.shape)
    inputs = poses.detach().contiguous().numpy(), order.numpy(), tables.numpy()
    kernels.anatomy(*inputs, softness, values.numpy(), gradient.numpy())
    return values, gradient


@anatomy.register_fake
def _(poses: Tensor, order: Tensor, tables: Tensor, softness: float) -> tuple[Tensor, Tensor]:
    return poses.new_empty(poses.shape[0]), poses.new_empty(poses.shape)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(output[1])


def _backward(ctx, grad_output, _):  # type: ignore[no-untyped-def]
    (gradient,) = ctx.saved_tensors
    return grad_output[:, None, None] * gradient, None, None, None


anatomy.register_autograd(_backward, _keep)
