"""Turning with the ray on which something is seen."""

import torch

from hfb.typing import Float, Tensor


def between_rays(before: Float[Tensor, "3"], after: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """The smallest rotation from one direction to another, which differ by less than a half turn."""
    one, other = before / before.norm(), after / after.norm()
    x, y, z = torch.linalg.cross(one, other).tolist()
    skew = one.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return torch.eye(3, dtype=one.dtype) + skew + skew @ skew / (1 + one @ other)


def seen_along(place: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """From "along the view ray", as a network sees a crop, to "along the optical axis"."""
    return between_rays(place.new_tensor([0.0, 0.0, 1.0]), place)
