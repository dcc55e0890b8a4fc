"""Regularisers as torch operators, for autograd, torch.compile and export.

The readable formulas that they are tested against are in `hfb.objective.regularizers`.
"""

from hfb.kernels.objective import regularizer_kernels as kernels
from hfb.kernels.torch_op import arrays, measure
from hfb.typing import Tensor


@measure("hfb::motion_size", moving=2)
def motion_size(rotation: Tensor, translation: Tensor, epsilon: float) -> tuple[Tensor, Tensor, Tensor]:
    """Return L_C, eq. (8), without the constants, and its gradients.

    Args:
        rotation: (T, D1, J, 4), coefficients.
        translation: (T, D1, 4), coefficients [m].
        epsilon: rounds |C|_F at zero.
    """
    gradients = rotation.new_empty(rotation.shape), translation.new_empty(translation.shape)
    inputs = [one.reshape(*one.shape[:2], -1) for one in arrays(rotation, translation, *gradients)]
    value = kernels.motion_size(*inputs[:2], epsilon, *inputs[2:])
    return rotation.new_tensor(value), *gradients


@measure("hfb::start_distance", moving=1)
def start_distance(rotations: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
    """Return `hfb.objective.regularizers.start_loss` of the last of each frame's rotations, and its gradient.

    Args:
        rotations: (T, S, J, 3, 3).
        first: (T, J, 3, 3), of the first bodies.
    """
    gradient = rotations.new_empty(rotations.shape)
    return rotations.new_tensor(kernels.start_distance(*arrays(rotations, first, gradient))), gradient
