"""Losses at several scales: a coarser image still overlaps where a body is off by a few pixels.

Readable torch; a fit on the CPU runs the compiled form, `hfb.kernels.objective.image_losses`.
"""

from collections.abc import Callable

import torch

from hfb.objective.image import image_loss
from hfb.objective.matting import matting_loss
from hfb.rendering.formation import compose
from hfb.typing import Float, Tensor

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]


def mean_over_scales(
    loss: Loss,
    predicted: Float[Tensor, "H W C"],
    seen: Float[Tensor, "H W C"],
    matte: Float[Tensor, "H W"],
    scales: int,
) -> Float[Tensor, ""]:
    """Return the mean of loss(predicted, seen, matte) at full size, half, a quarter ...

    A coarse pixel is the mean of the four it covers, as a coarser sensor's would be.

    Args:
        loss: loss of a prediction, an observation and a matte.
        predicted: the prediction at full size.
        seen: the observation at full size.
        matte: the person's share of each pixel.
        scales: number of scales.
    """
    planes = torch.cat([predicted, seen, matte[..., None]], -1).movedim(-1, 0)
    values = []
    for scale in range(scales):
        if scale > 0:
            planes = torch.nn.functional.avg_pool2d(planes, 2, ceil_mode=True, count_include_pad=False)
        shrunk = planes.movedim(0, -1)
        channels = predicted.shape[-1]
        values.append(loss(shrunk[..., :channels], shrunk[..., channels:-1], shrunk[..., -1]))
    return torch.stack(values).mean()


def image_over_scales(
    mean: Float[Tensor, "H W 4"],
    plate: Float[Tensor, "H W 3"],
    frame: Float[Tensor, "H W 3"],
    matte: Float[Tensor, "H W"],
    scales: int,
) -> Float[Tensor, ""]:
    """Return L_I, eq. (3), between the re-blurred image, eq. (1), and the frame.

    Args:
        mean: mean premultiplied colour and silhouette of the sub-frames.
        plate: the background.
        frame: the blurred frame.
        matte: the person's share of each pixel.
        scales: number of scales.
    """

    def loss(predicted: Tensor, seen: Tensor, area: Tensor) -> Tensor:
        return image_loss(predicted, seen, area.sum())

    return mean_over_scales(loss, compose(mean, plate), frame, matte, scales)


def matte_over_scales(alpha: Float[Tensor, "H W"], matte: Float[Tensor, "H W"], scales: int) -> Float[Tensor, ""]:
    """Return L_alpha, eq. (4), between a mean silhouette and the matte.

    Args:
        alpha: mean silhouette of the sub-frames.
        matte: the person's share of each pixel.
        scales: number of scales.
    """

    def loss(predicted: Tensor, seen: Tensor, _: Tensor) -> Tensor:
        return matting_loss(predicted[..., 0], seen[..., 0])

    return mean_over_scales(loss, alpha[..., None], matte[..., None], matte, scales)
