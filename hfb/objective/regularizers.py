"""The terms that keep the body, its motion and its texture plausible: eq. (6) to (9)."""

from collections.abc import Callable
from functools import lru_cache

import torch

from hfb.body.skeleton import JOINT_NAMES
from hfb.kernels.dispatch import compiled
from hfb.kernels.objective.regularizer_operators import motion_size, start_distance
from hfb.motion.trajectory import Trajectory
from hfb.typing import Float, Tensor

_EPSILON = 1e-6

_SIZES = {"pelvis": 0.03, "hip": 0.05, "knee": 0.035, "ankle": 0.06, "shoulder": 0.06, "elbow": 0.1, "wrist": 0.045}
_STIFF, _SIZE_OF_DEGREE, _PLACE_M = 0.012, (1.0, 1.0, 1.0, 1.7), (0.057, 0.057, 0.016, 0.024)
"""Mean sizes of quaternions' coefficients in u - 1/2, per joint and degree, and of the place's [m], in 300 exposures of
five people of CMU's recordings. Elbows have twice theirs, which keeps forearms still; hands, feet and collars, which
hardly move there, as much as the spine."""


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


def motion_loss(trajectory: Trajectory) -> Float[Tensor, ""]:
    """Return L_C of a motion's coefficients, see `polynomial_loss`; quaternions' count in units of `typical_sizes`.

    Args:
        trajectory: polynomials of the motion [m].
    """
    rotation, translation = trajectory.rotation, trajectory.translation
    if trajectory.kind == "quaternion":
        sizes = typical_sizes(rotation.shape[1], rotation.dtype, rotation.device)
        rotation, translation = rotation / sizes[:, :-1, None], translation / sizes[:, -1:]
    if compiled(rotation):
        return motion_size(rotation, translation, _EPSILON)[0]
    return polynomial_loss(torch.cat([rotation[:, 1:].flatten(), translation[:, 1:].flatten()]))


@lru_cache
def typical_sizes(count: int, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "D1 25"]:
    """Return sizes of coefficients in recorded motions relative to the rotations' mean: of all joints, of the place.

    With one size for all, the spine would move as readily as shoulders and hips, which move five times as far.

    Args:
        count: number of coefficients; from the fourth degree on they are taken to be as large as in the third.
        dtype: of the result.
        device: of the result.
    """
    joints, degrees = [_SIZES.get(name.split("_")[-1], _STIFF) for name in JOINT_NAMES], [0, 1, 2, *[3] * count][:count]
    rows = [[*(_SIZE_OF_DEGREE[degree] * joint for joint in joints), _PLACE_M[degree]] for degree in degrees]
    sizes = torch.tensor(rows, dtype=dtype, device=device)
    return sizes / sizes[1:, :-1].mean()


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
