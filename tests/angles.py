"""Angles between rotations, to compare poses with."""

import torch

from hfb.geometry.rotations import matrix_to_axis_angle


def angle_between(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    """The angle [rad] of the rotation between two matrices (*n, 3, 3), accurate at 0 and at pi; (*n)."""
    return matrix_to_axis_angle(left.mT @ right).norm(dim=-1)
