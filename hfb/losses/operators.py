"""The picture losses as a torch operator, so that autograd, torch.compile and export see them.

The readable formulas that it is tested against are in `hfb.losses.scales`.
"""

import torch

from hfb.losses import kernels_pictures as kernels
from hfb.losses.scales import image_over_scales, matte_over_scales
from hfb.shapes import Array, Float, Tensor


@torch.library.custom_op("hfb::compare_pictures", mutates_args=())
def _compare(
    mean: Tensor, plate: Tensor, frame: Tensor, matte: Tensor, image_scales: int, matte_scales: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(L_I, L_alpha, gradient of the first by `mean`, gradient of the second by its last channel).

    A loss at no scale is zero, and its gradient empty.
    """
    height, width, channels = mean.shape

    def pixels(picture: Tensor) -> Array:
        return picture.detach().contiguous().view(height * width, -1).numpy()

    drawn, alpha = pixels(mean), pixels(matte)
    of_image = mean.new_empty((height * width, 4) if image_scales > 0 else (0, 4))
    of_matte = mean.new_empty(height * width if matte_scales > 0 else 0)
    image = overlap = 0.0
    if image_scales > 0:
        table = kernels.levels(height, width, image_scales)
        image = kernels.compare_images(drawn, pixels(plate), pixels(frame), alpha, table, of_image.numpy())
    if matte_scales > 0:
        table = kernels.levels(height, width, matte_scales)
        overlap = kernels.compare_mattes(drawn, channels - 1, alpha, table, of_matte.numpy())
    return mean.new_tensor(image), mean.new_tensor(overlap), of_image, of_matte


@_compare.register_fake
def _(
    mean: Tensor, plate: Tensor, frame: Tensor, matte: Tensor, image_scales: int, matte_scales: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    pixels = mean.shape[0] * mean.shape[1]
    of_image = mean.new_empty((pixels, 4) if image_scales > 0 else (0, 4))
    return mean.new_empty(()), mean.new_empty(()), of_image, mean.new_empty(pixels if matte_scales > 0 else 0)


@torch.library.custom_op("hfb::compare_pictures_gradient", mutates_args=())
def _gradient(
    by_image: Tensor, by_matte: Tensor, of_image: Tensor, of_matte: Tensor, height: int, width: int, channels: int
) -> Tensor:
    """Gradient of `mean` (H, W, C) from those of the two losses."""
    gradient = of_matte.new_empty(height, width, channels)
    kernels.weigh(
        of_image.numpy(), of_matte.numpy(), by_image.item(), by_matte.item(), channels - 1,
        gradient.view(-1, channels).numpy(),
    )  # fmt: skip
    return gradient


@_gradient.register_fake
def _(
    by_image: Tensor, by_matte: Tensor, of_image: Tensor, of_matte: Tensor, height: int, width: int, channels: int
) -> Tensor:
    return of_matte.new_empty(height, width, channels)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*output[2:])
    ctx.size = inputs[0].shape


def _backward(ctx, by_image, by_matte, *_):  # type: ignore[no-untyped-def]
    return _gradient(by_image, by_matte, *ctx.saved_tensors, *ctx.size), None, None, None, None, None


_compare.register_autograd(_backward, setup_context=_keep)


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
    if mean.device.type == "cpu":
        return _compare(mean, plate, frame, matte, image_scales, matte_scales)[:2]
    nothing = mean.new_zeros(())
    return (
        image_over_scales(mean, plate, frame, matte, image_scales) if image_scales > 0 else nothing,
        matte_over_scales(mean[..., 3], matte, matte_scales) if matte_scales > 0 else nothing,
    )


def compare_mattes(alpha: Float[Tensor, "H W"], matte: Float[Tensor, "H W"], scales: int) -> Float[Tensor, ""]:
    """L_alpha alone, for a silhouette without a picture; differentiable in `alpha`."""
    if alpha.device.type != "cpu":
        return matte_over_scales(alpha, matte, scales)
    nothing = alpha.new_empty(0)
    return _compare(alpha[..., None], nothing, nothing, matte, 0, scales)[1]
