"""Rotations between view rays."""

import torch

from hfb.typing import Float, Tensor


def between_rays(before: Float[Tensor, "3"], after: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Return the smallest rotation from one direction to another, which differ by less than a half turn.

    Args:
        before: direction of any length.
        after: direction of any length.
    """
    one, other = before / before.norm(), after / after.norm()
    x, y, z = torch.linalg.cross(one, other).tolist()
    skew = one.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return torch.eye(3, dtype=one.dtype) + skew + skew @ skew / (1 + one @ other)


def seen_along(place: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Return the rotation from the optical axis to a view ray: a network that sees a crop takes the ray for the axis.

    Args:
        place: point on the ray [m], camera coordinates.
    """
    return between_rays(place.new_tensor([0.0, 0.0, 1.0]), place)
