"""The terms that keep the body, its motion and its texture plausible: eq. (6) to (9)."""

from collections.abc import Callable

import torch

from hfb.kernels.dispatch import compiled
from hfb.kernels.objective.regularizer_operators import motion_size, start_distance
from hfb.typing import Float, Tensor

_EPSILON = 1e-6


def pose_loss(prior: Callable[[Tensor], Tensor], axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, ""]:
    """Return L_P = 1/N sum_i prior(theta_i), eq. (6).

    Args:
        prior: a `hfb.priors.pose.PosePrior`; its values are not negative.
        axis_angle: the joints below the root in every sub-frame [rad].
    """
    return prior(axis_angle).mean()


def shape_loss(betas: Float[Tensor, "K"]) -> Float[Tensor, ""]:
    """Return L_beta = |beta|_2^2, eq. (7).

    Args:
        betas: shape coefficients.
    """
    return (betas * betas).sum()


def polynomial_loss(coefficients: Float[Tensor, "*n"], epsilon: float = _EPSILON) -> Float[Tensor, ""]:
    """Return L_C = |C|_1 + |C|_F, eq. (8), of the motion's coefficients WITHOUT the constants.

    The Frobenius norm is sqrt(sum c^2 + epsilon^2) - epsilon: its own gradient is NaN at C = 0, which is exactly
    where the fit starts. Here both gradients are zero there, and so is the loss.

    Args:
        coefficients: the rows c1 .. cd of every polynomial, in any arrangement; the constants are the pose itself, and
            pulling them to zero would pull the body into the rest pose at the camera.
        epsilon: keeps the gradient finite at zero.
    """
    frobenius = ((coefficients * coefficients).sum() + epsilon * epsilon).sqrt() - epsilon
    return coefficients.abs().sum() + frobenius


def motion_loss(rotation: Float[Tensor, "T D1 24 4"], translation: Float[Tensor, "T D1 4"]) -> Float[Tensor, ""]:
    """Return L_C of a motion's coefficients: see `polynomial_loss`.

    Args:
        rotation: coefficients; the constants are left out.
        translation: coefficients; the constants are left out.
    """
    if compiled(rotation):
        return motion_size(rotation, translation, _EPSILON)[0]
    return polynomial_loss(torch.cat([rotation[:, 1:].flatten(), translation[:, 1:].flatten()]))


def background_loss(
    background: Float[Tensor, "H W 3"], subframes: Float[Tensor, "S H W 4"], epsilon: float = 1e-6
) -> Float[Tensor, ""]:
    """Return L_B = 1/N sum_i 1 / (|B - R_F|_1 + epsilon), eq. (9): appearance should differ from the background.

    |B - R_F|_1 is read as one number per sub-frame, the mean over channels and over the pixels inside the
    silhouette (each with its covered share): a reciprocal per pixel explodes at the first pixel whose colour
    happens to match. A sub-frame without a body in the image counts as zero and gets no gradient.

    Args:
        background: B, the clean plate.
        subframes: R_S R_F and R_S of every sub-frame (premultiplied colour, silhouette), in the same light.
        epsilon: keeps the reciprocal finite.
    """
    silhouettes = subframes[..., 3]
    area_px = silhouettes.sum((1, 2))
    contrast = (subframes[..., :3] - silhouettes[..., None] * background).abs().sum((1, 2, 3))
    contrast = contrast / (3 * area_px.clamp_min(1e-3))
    seen = area_px > 1e-3
    return torch.where(seen, 1 / (contrast + epsilon), torch.zeros_like(contrast)).mean()


def start_loss(rotations: Float[Tensor, "T S J 3 3"], first: Float[Tensor, "T J 3 3"]) -> Float[Tensor, ""]:
    """Return the mean over the joints of 2 - 2 cos(angle) [~ rad^2] between the middle pose and the first body's.

    It is not in the paper. The estimator of the first body is more accurate where the image hardly constrains the body,
    such as in the depth of a limb; this term keeps its estimate where nothing contradicts it.

    Args:
        rotations: rotations of the joints relative to the parents (the root to the camera), the middle of the exposure
            last.
        first: the first body's.
    """
    if compiled(rotations):
        return start_distance(rotations, first)[0]
    return 3 - (rotations[:, -1] * first).sum((-1, -2)).mean()
