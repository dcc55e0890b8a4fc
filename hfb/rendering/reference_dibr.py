"""DIB-R's soft silhouette in plain torch, with the constants of its public implementations.

Chen et al., Learning to Predict 3D Objects with an Interpolation-based Differentiable Renderer, 2019, eq. 5-6.

A pixel whose centre shows the body has R_S = 1. Any other is reached by the faces near it, each with the
probability A'_j = exp(-d_j^2 / delta), and R_S = 1 - prod_j (1 - A'_j). The result is a halo outside the body:
it covers more than the body does (FitConfig.silhouette's "coverage" is the exact share instead).
"""

import torch

from hfb.geometry.camera import PinholeCamera
from hfb.typing import Bool, Float, Int, Tensor

INVERSE_DELTA = 7000.0
"""1 / delta, for distances in units of half the image's longer side."""
REACH = 0.02
"""A face reaches the pixels within its bounding box enlarged by this, in the same unit."""
NEAREST_FACES = 30
"""Only so many of the nearest faces count."""
TIE = 1e-9  # squared distances [px^2] closer than this are equal


def dibr_constants(camera: PinholeCamera, sharpness: float = 1.0) -> tuple[float, float, int]:
    """Return DIB-R's constants for an image size: 1 / delta [1/px^2], reach [px], number of faces.

    Args:
        camera: pinhole camera; its height and width are the image's.
        sharpness: how many times narrower the halo is than with the constants of the public implementations.
    """
    unit_px = max(camera.height, camera.width) / 2 / sharpness
    return INVERSE_DELTA / unit_px**2, REACH * unit_px, NEAREST_FACES


def soft_mask(
    xy: Float[Tensor, "V 2"],
    faces: Int[Tensor, "F 3"],
    owners: Int[Tensor, "F"],
    covered: Bool[Tensor, "H W"],
    camera: PinholeCamera,
    sharpness: float = 1.0,
) -> tuple[Float[Tensor, "H W"], Int[Tensor, "H W 3"]]:
    """Return R_S, and for each pixel of the halo the nearest side of a face: (from, to, owner), owner -1 elsewhere.

    Args:
        xy: vertices on the screen [px].
        faces: faces that contribute, whatever side they turn to the camera.
        owners: numbers by which the result names the faces.
        covered: pixels inside the silhouette.
        camera: pinhole camera; its height and width are the image's.
        sharpness: see `dibr_constants`.
    """
    inverse_delta, reach, most = dibr_constants(camera, sharpness)
    corners = xy[faces]
    low, high = corners.detach().amin(1) - reach, corners.detach().amax(1) + reach
    alphas, sides = [], []
    for row in range(camera.height):
        alpha, side = covered[row].to(xy.dtype), torch.full((camera.width, 3), -1)
        here = ((low[:, 1] <= row + 0.5) & (high[:, 1] >= row + 0.5)).nonzero().squeeze(1)
        columns = (~covered[row]).nonzero().squeeze(1)
        if len(here) and len(columns):
            centres = torch.stack([columns + 0.5, torch.full(columns.shape, row + 0.5)], 1).to(xy)
            squared, which = _squared_distances(centres, corners[here])
            in_reach = (centres[:, None, 0] >= low[here, 0]) & (centres[:, None, 0] <= high[here, 0])
            squared = torch.where(in_reach, squared, torch.inf)
            nearest = squared.topk(min(most, len(here)), 1, largest=False).values
            missed = torch.where(nearest < torch.inf, 1 - torch.exp(-inverse_delta * nearest), 1)
            alpha = alpha.index_put((columns,), 1 - missed.prod(1))
            best = (squared <= nearest[:, :1] + TIE).to(torch.uint8).argmax(1)
            start = which.gather(1, best[:, None])
            ends = torch.cat([start, (start + 1) % 3], 1)
            found = torch.cat([faces[here[best]].gather(1, ends), owners[here[best], None]], 1)
            side[columns] = torch.where(nearest[:, :1] < torch.inf, found, -1)
        alphas.append(alpha)
        sides.append(side)
    return torch.stack(alphas), torch.stack(sides)


def _squared_distances(
    points: Float[Tensor, "n 2"], corners: Float[Tensor, "F 3 2"]
) -> tuple[Float[Tensor, "n F"], Int[Tensor, "n F"]]:
    """Return the squared distance of each point from each face's nearest side (of equals the first), and that side."""
    start = corners[None]
    direction = corners.roll(-1, 1)[None] - start
    away = points[:, None, None] - start
    squared_length = (direction * direction).sum(-1)
    safe = torch.where(squared_length == 0, torch.ones_like(squared_length), squared_length)
    t = ((away * direction).sum(-1) / safe).clamp(0, 1)
    squared = ((away - t[..., None] * direction) ** 2).sum(-1)
    which = (squared <= squared.amin(-1, keepdim=True) + TIE).to(torch.uint8).argmax(-1)
    return squared.gather(-1, which[..., None]).squeeze(-1), which
