"""Comparisons at several scales: what lies beside its place by a few pixels still meets it in a coarser picture."""

from collections.abc import Callable

import torch

from hfb.shapes import Float, Tensor

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]


def mean_over_scales(
    loss: Loss,
    predicted: Float[Tensor, "H W C"],
    seen: Float[Tensor, "H W C"],
    matte: Float[Tensor, "H W"],
    scales: int,
) -> Float[Tensor, ""]:
    """The mean of loss(predicted, seen, matte) at full size, half, a quarter ...

    A coarse pixel is the mean of the four it covers, as a coarser sensor's would be.
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
