"""Exact time reversal of a motion or of some limbs, which one uniformly exposed image does not distinguish."""

from math import comb

import torch

from hfb.body.skeleton import JOINT_COUNT
from hfb.motion.trajectory import Trajectory
from hfb.priors.motion_columns import COLUMN_COUNT, LIMBS
from hfb.typing import Bool, Float, Tensor


def reverse_columns(trajectory: Trajectory, columns: Bool[Tensor, "T 25"]) -> Trajectory:
    """Replace c(u) by c(1 - u) in the chosen columns of C, exactly; the others stay.

    With v = u - origin, (1 - u - origin)^d = (1 - 2 origin - v)^d is expanded by the binomial theorem: about the middle
    of the exposure (origin 0.5) the odd coefficients change their signs. All columns at once reverse the motion.

    Args:
        trajectory: polynomials of the motion.
        columns: per frame, which of the 24 rotations and of the translation (the last) run backwards.
    """
    mirror = _mirror(trajectory.rotation, trajectory.origin)
    rotation = torch.einsum("de,tejc->tdjc", mirror, trajectory.rotation)
    translation = torch.einsum("de,tec->tdc", mirror, trajectory.translation)
    return trajectory.with_coefficients(
        torch.where(columns[:, None, :JOINT_COUNT, None], rotation, trajectory.rotation),
        torch.where(columns[:, None, JOINT_COUNT, None], translation, trajectory.translation),
    )


def limb_columns(limbs: Bool[Tensor, "T 5"]) -> Bool[Tensor, "T 25"]:
    """Return the columns of C of the chosen limbs of every frame, in the order of `LIMBS`.

    Args:
        limbs: per frame.
    """
    columns = torch.zeros(limbs.shape[0], COLUMN_COUNT, dtype=torch.bool)
    for place, members in enumerate(LIMBS.values()):
        columns[:, list(members)] = limbs[:, place, None]
    return columns


def _mirror(like: Tensor, origin: float) -> Float[Tensor, "D1 D1"]:
    """Return M with sum_d c_d (1 - 2 origin - v)^d = sum_d (M c)_d v^d."""
    count = like.shape[1]
    rows = [
        [
            comb(high, low) * (1 - 2 * origin) ** (high - low) * (-1) ** low if high >= low else 0
            for high in range(count)
        ]
        for low in range(count)
    ]
    return like.new_tensor(rows)
