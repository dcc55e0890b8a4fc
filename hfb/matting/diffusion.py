"""Filling in from neighbours, coarse to fine, of colours and mattes that are partly known."""

import cv2
import numpy as np

from hfb.typing import Array, Float

_NEIGHBOURS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float32)


def spread_colours(
    colours: Float[Array, "H W 3"], weights: Float[Array, "H W"], smallest_px: int
) -> Float[Array, "H W 3"]:
    """Fill in colours: the weighted local mean where weights are large, that of the surroundings elsewhere.

    Normalised convolution on a pyramid (push-pull, Gortler et al. 1996). Details below about `smallest_px`
    are averaged away, so that no pixel only confirms itself.

    Args:
        colours: colours in any light.
        weights: trust in each pixel's colour, not negative.
        smallest_px: size of the smallest details that are kept [px].
    """
    levels = [(colours * weights[..., None], weights)]
    while min(levels[-1][1].shape) > 2:
        levels.append((cv2.pyrDown(levels[-1][0]), cv2.pyrDown(levels[-1][1])))
    finest = min(max(smallest_px, 1).bit_length() - 1, len(levels) - 1)
    sure = max(float(levels[finest][1].max()), 1e-12)
    weighted, weight = levels[-1]
    filled = weighted / np.maximum(weight, 1e-20)[..., None]
    for weighted, weight in levels[-2::-1]:
        filled = cv2.pyrUp(filled, dstsize=(weight.shape[1], weight.shape[0]))
        if weight.shape[0] * weight.shape[1] <= levels[finest][1].size:
            own = np.clip(weight * (4 / sure), 0, 1)[..., None]
            filled = own * weighted / np.maximum(weight, 1e-20)[..., None] + (1 - own) * filled
    return np.asarray(filled, np.float32)


def smooth_where_unsure(
    value: Float[Array, "H W"], precision: Float[Array, "H W"], stiffness: float, sweeps: int = 25
) -> Float[Array, "H W"]:
    """Minimise sum precision (a - value)^2 + stiffness |grad a|^2 over a: a membrane held where the precision is high.

    Jacobi sweeps from coarse to fine. Where nothing is known the result is the harmonic interpolation of what
    surrounds it: an ambiguous hole in the body is filled, an ambiguous patch of background stays empty.

    Args:
        value: estimate per pixel.
        precision: its inverse variance.
        stiffness: weight of the squared gradient.
        sweeps: Jacobi iterations on each level of the pyramid.
    """
    levels = [(value * precision, precision)]
    while min(levels[-1][1].shape) > 8:
        height, width = levels[-1][1].shape
        half = ((width + 1) // 2, (height + 1) // 2)
        force, hold = (cv2.resize(part, half, interpolation=cv2.INTER_AREA) * 4 for part in levels[-1])
        levels.append((force, hold))
    force, hold = levels[-1]
    result = force / np.maximum(hold, 1e-9)
    for force, hold in levels[::-1]:
        result = cv2.resize(result, (hold.shape[1], hold.shape[0]), interpolation=cv2.INTER_LINEAR)
        scale = 1 / (hold + 4 * stiffness)
        for _ in range(sweeps):
            around = cv2.filter2D(result, -1, _NEIGHBOURS, borderType=cv2.BORDER_REFLECT_101)
            result = (force + stiffness * around) * scale
    return np.asarray(result, np.float32)
