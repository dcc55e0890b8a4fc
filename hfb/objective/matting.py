"""The matting loss, eq. (4)."""

import torch

from hfb.typing import Float, Tensor

# Only keeps 0/0 away: mattes cover thousands of pixels.
_EMPTY_PX = 1e-6


def matting_loss(predicted: Float[Tensor, "H W"], matte: Float[Tensor, "H W"]) -> Float[Tensor, ""]:
    """Return L_alpha = 1 - |min(alpha_in, alpha)|_1 / |max(alpha_in, alpha)|_1, eq. (4): one minus the soft IoU.

    Zero exactly where the two agree (two empty ones agree), one where they share nothing. The gradient is
    finite everywhere; where both are equal it is the mean of the two one-sided ones.

    Args:
        predicted: alpha_target, the mean of the sub-frames' silhouettes R_S.
        matte: alpha_in, from the input image.
    """
    shared = torch.minimum(predicted, matte).sum()
    covered = torch.maximum(predicted, matte).sum()
    return 1 - (shared + _EMPTY_PX) / (covered + _EMPTY_PX)
