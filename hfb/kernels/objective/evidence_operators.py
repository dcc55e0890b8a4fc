"""Distances of a body from the joint network's predictions, as torch operators.

The readable formulas that they are tested against are `hfb.evidence.joint_evidence`'s.
"""

from hfb.kernels.objective import evidence_kernels as kernels
from hfb.kernels.torch_op import arrays, measure
from hfb.typing import Tensor


@measure("hfb::off_middle", moving=1)
def off_middle(joints: Tensor, lenses: Tensor, middle: Tensor, scale: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """Return `evidence_kernels.off_middle` and its gradient.

    Args:
        joints: (T, S, 24, 3) [m], camera coordinates.
        lenses: (T, 5), see `hfb.evidence.joint_network.in_units`.
        middle: (T, 24, 3), joints by the network.
        scale: (T, 24, 3), error scales of the network.
        share: (3), weight of each coordinate.
    """
    gradient = joints.new_empty(joints.shape)
    return joints.new_tensor(kernels.off_middle(*arrays(joints, lenses, middle, scale, share, gradient))), gradient


@measure("hfb::off_path", moving=1)
def off_path(joints: Tensor, lenses: Tensor, path: Tensor, scale: Tensor, both_ways: bool) -> tuple[Tensor, Tensor]:
    """Return `evidence_kernels.off_path` and its gradient.

    Args:
        joints: (T, S, 24, 3) [m], camera coordinates.
        lenses: (T, 5), see `hfb.evidence.joint_network.in_units`.
        path: (T, 24, 3), displacements by the network.
        scale: (T, 24, 3), error scales of the network.
        both_ways: compare with the reverse, too.
    """
    gradient = joints.new_empty(joints.shape)
    *inputs, into = arrays(joints, lenses, path, scale, gradient)
    return joints.new_tensor(kernels.off_path(*inputs, both_ways, into)), gradient


@measure("hfb::off_height", moving=1)
def off_height(
    betas: Tensor, per_beta: Tensor, mean_m: float, log_height: float, scale: float
) -> tuple[Tensor, Tensor]:
    """Return `evidence_kernels.off_height` and its gradient.

    Args:
        betas: (K), shape coefficients.
        per_beta: (K), height per unit of each beta [m].
        mean_m: height with betas of zero.
        log_height: logarithm of the height [m] by the network.
        scale: its error scale.
    """
    gradient = betas.new_empty(betas.shape)
    *inputs, into = arrays(betas, per_beta, gradient)
    return betas.new_tensor(kernels.off_height(*inputs, mean_m, log_height, scale, into)), gradient
