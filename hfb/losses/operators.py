"""The picture losses as a torch operator, so that autograd, torch.compile and export see them.

The readable formulas that it is tested against are in `hfb.losses.scales`.
"""

from functools import lru_cache

import numpy as np
import torch

from hfb.formulas import compiled
from hfb.losses import kernels_pictures as kernels
from hfb.losses.scales import image_over_scales, matte_over_scales
from hfb.shapes import Array, Float, Tensor
from hfb.torch_operator import operator


def _pixels(picture: Tensor) -> Array:
    """(H W, channels) of (H, W, channels) or (H, W)."""
    channels = picture.shape[2] if picture.ndim == 3 else 1
    return picture.detach().contiguous().numpy().reshape(-1, channels)


_levels = lru_cache(kernels.levels)
"""Of a picture's size and a number of scales; not to be changed."""


@operator("hfb::compare_pictures")
def _compare(
    mean: Tensor, plate: Tensor, frame: Tensor, matte: Tensor, image_scales: int, matte_scales: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """(L_I, L_alpha, then for the way back: both gradients by what the coarser scales see, slopes at the finest).

    A loss at no scale is zero.
    """
    size, image, overlap, slopes = mean.shape[:2], 0.0, 0.0, np.zeros(3)
    of_image, of_matte = mean.new_empty(0, 4), mean.new_empty(0, 1)
    drawn, told = _pixels(mean), _pixels(matte)
    if image_scales > 0:
        table = _levels(*size, image_scales)
        of_image = mean.new_empty(int(table[-1, 0]), 4)
        pictures = drawn, _pixels(plate), _pixels(frame), told
        image, slopes[0] = kernels.compare_images(*pictures, *size, table, of_image.numpy())
    if matte_scales > 0:
        table = _levels(*size, matte_scales)
        of_matte = mean.new_empty(int(table[-1, 0]), 1)
        overlap, slopes[1], slopes[2] = kernels.compare_mattes(drawn, told, *size, table, of_matte.numpy())
    loss_of_image, loss_of_matte = (torch.from_numpy(np.asarray(value, drawn.dtype)) for value in (image, overlap))
    return loss_of_image, loss_of_matte, of_image, of_matte, torch.from_numpy(slopes)


@_compare.register_fake
def _(
    mean: Tensor, plate: Tensor, frame: Tensor, matte: Tensor, image_scales: int, matte_scales: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    def coarse_pixels(scales: int) -> int:
        height, width, count = *mean.shape[:2], 0
        for _ in range(scales - 1):
            height, width = (height + 1) // 2, (width + 1) // 2
            count = count + height * width
        return count

    of_image, of_matte = mean.new_empty(coarse_pixels(image_scales), 4), mean.new_empty(coarse_pixels(matte_scales), 1)
    return mean.new_empty(()), mean.new_empty(()), of_image, of_matte, mean.new_empty(3, dtype=torch.float64)


@operator("hfb::compare_pictures_gradient")
def _gradient(
    by_image: Tensor, by_matte: Tensor, mean: Tensor, plate: Tensor, frame: Tensor, matte: Tensor,
    of_image: Tensor, of_matte: Tensor, slopes: Tensor, image_scales: int,
) -> Tensor:  # fmt: skip
    """Gradient of `mean` (H, W, C) from those of the two losses."""
    gradient = mean.new_empty(mean.shape) if image_scales > 0 else mean.new_zeros(mean.shape)
    pictures = (_pixels(plate), _pixels(frame)) if image_scales > 0 else (_pixels(matte.new_empty(0, 0, 3)),) * 2
    kernels.gradient_of(
        _pixels(mean), *pictures, _pixels(matte), *mean.shape[:2], slopes.numpy(), by_image.item(), by_matte.item(),
        of_image.numpy(), of_matte.numpy(), _pixels(gradient),
    )  # fmt: skip
    return gradient


@_gradient.register_fake
def _(
    by_image: Tensor, by_matte: Tensor, mean: Tensor, plate: Tensor, frame: Tensor, matte: Tensor,
    of_image: Tensor, of_matte: Tensor, slopes: Tensor, image_scales: int,
) -> Tensor:  # fmt: skip
    return mean.new_empty(mean.shape)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    *pictures, ctx.image_scales, _ = inputs
    ctx.save_for_backward(*pictures, *output[2:])


def _backward(ctx, by_image, by_matte, *_):  # type: ignore[no-untyped-def]
    gradient = _gradient(by_image, by_matte, *ctx.saved_tensors, ctx.image_scales)
    return gradient, None, None, None, None, None


_compare.register_autograd(_backward, _keep)


def compare_pictures(
    mean: Float[Tensor, "H W 4"],
    plate: Float[Tensor, "H W 3"],
    frame: Float[Tensor, "H W 3"],
    matte: Float[Tensor, "H W"],
    image_scales: int,
    matte_scales: int,
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """L_I of the re-blurred picture and L_alpha of its silhouette, each the mean over its scales; zero at no scale.

    The same numbers as `image_over_scales` and `matte_over_scales`, found together with their gradients in a few
    passes. Differentiable in `mean` alone.

    Args:
        mean: mean over the sub-frames of premultiplied colour and silhouette, as a rasteriser returns it.
        plate: the clean background B. frame: I, in the same light. matte: alpha_in.
        image_scales, matte_scales: how many scales, each half the last.
    """
    if compiled(mean):
        return _compare(mean, plate, frame, matte, image_scales, matte_scales)[:2]
    nothing = mean.new_zeros(())
    return (
        image_over_scales(mean, plate, frame, matte, image_scales) if image_scales > 0 else nothing,
        matte_over_scales(mean[..., 3], matte, matte_scales) if matte_scales > 0 else nothing,
    )


def compare_mattes(alpha: Float[Tensor, "H W"], matte: Float[Tensor, "H W"], scales: int) -> Float[Tensor, ""]:
    """L_alpha alone, for a silhouette without a picture; differentiable in `alpha`."""
    if not compiled(alpha):
        return matte_over_scales(alpha, matte, scales)
    nothing = alpha.new_empty(0)
    return _compare(alpha[..., None], nothing, nothing, matte, 0, scales)[1]
