"""Height of a body as a function of the betas, and the nearest shape of a known height."""

from functools import lru_cache

import torch

from hfb.body.model import Body
from hfb.typing import Float, Tensor


def height_m(body: Body, betas: Float[Tensor, "*n K"]) -> Float[Tensor, "*n"]:
    """Return the height from soles to crown in the rest pose [m]: linear in the betas, between two fixed vertices.

    Args:
        body: the body model.
        betas: shape coefficients.
    """
    mean, per_beta = height_line(body)
    return mean + betas @ per_beta.to(betas)


def as_tall(betas: Float[Tensor, "*n K"], body: Body, height: float | Float[Tensor, "*n"]) -> Float[Tensor, "*n K"]:
    """Return the nearest shape of a given height: the likeliest, since betas have unit variance.

    Args:
        betas: shape coefficients.
        body: the body model.
        height: height from soles to crown [m].
    """
    mean_m, per_beta = height_line(body)
    per_beta = per_beta.to(betas)
    # Without the mean: single precision leaves .1 um of a height, which a small slope would make large.
    missing_m = torch.as_tensor(height - mean_m).to(betas) - betas @ per_beta
    return betas + (missing_m / per_beta.square().sum())[..., None] * per_beta


@lru_cache(maxsize=4)
def height_line(body: Body) -> tuple[float, Float[Tensor, "K"]]:
    """Return the height with betas of zero, and its derivative by each beta [m].

    Args:
        body: the body model.
    """
    top, bottom = int(body.template[:, 1].argmax()), int(body.template[:, 1].argmin())
    mean = float(body.template[top, 1] - body.template[bottom, 1])
    return mean, body.shape_directions[top, 1] - body.shape_directions[bottom, 1]
