"""The image formation loss, eq. (3)."""

from hfb.typing import Float, Tensor


def image_loss(
    predicted: Float[Tensor, "H W 3"], observed: Float[Tensor, "H W 3"], area_px: Float[Tensor, ""]
) -> Float[Tensor, ""]:
    """Return L_I of eq. (3), |I - I^|_2 read as a squared error: sum over pixels, mean over channels, by area.

    Normalised by the matte's area, not by the image's: else a person who fills a tenth of the image would
    count a tenth as much, and cropping the image would change the weight of every other term.

    Args:
        predicted: I^, the re-blurred image, in the light in which blur is an average.
        observed: I, the input, in the same light.
        area_px: sum of the matte [px]; below one pixel it counts as one.
    """
    difference = predicted - observed
    return (difference * difference).sum() / (3 * area_px.clamp_min(1))


def robust_image_loss(
    predicted: Float[Tensor, "H W 3"], observed: Float[Tensor, "H W 3"], area_px: Float[Tensor, ""], scale: float = 1e-2
) -> Float[Tensor, ""]:
    """Return L_I as an L1 over the region of interest: sqrt(d^2 + scale^2) - scale (Charbonnier); see `image_loss`.

    Nearly |d| far above the scale, nearly d^2 / (2 scale) below it, so that it is smooth at d = 0 and
    zero for a perfect prediction.

    Args:
        predicted: I^, see `image_loss`.
        observed: I, see `image_loss`.
        area_px: see `image_loss`.
        scale: the difference [of light in 0..1] where the loss turns from a square into a line.
    """
    difference = predicted - observed
    return ((difference * difference + scale * scale).sqrt() - scale).sum() / (3 * area_px.clamp_min(1))
