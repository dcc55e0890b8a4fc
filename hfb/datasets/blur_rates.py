"""Blur rates of a case, frame by frame."""

import numpy as np

from hfb.typing import Array, Float, Shaped


def blur_rates(silhouettes: Shaped[Array, "T S H W"]) -> Float[Array, "T"]:
    """Return |union of R_S(i)| / |R_S(1)| - 1 of every frame, the union pixelwise; 0 where nothing is seen.

    Args:
        silhouettes: boolean, or shares of pixels.
    """
    first, union = silhouettes[:, 0].sum((1, 2), dtype=np.float64), silhouettes.max(1).sum((1, 2), dtype=np.float64)
    return np.where(first > 0, union / np.maximum(first, 1e-9), 1.0) - 1
