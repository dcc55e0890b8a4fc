"""Image and matting losses of one frame's mean render, and their gradient, by kernels.

The readable formulas that this is tested against are in `hfb.objective.pyramid`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from hfb.kernels.objective import image_kernels as kernels
from hfb.typing import Array, Float, Int, Tensor

_levels = lru_cache(kernels.levels)
"""Table of the levels of an image's size and a number of scales; not to be changed."""


@dataclass(frozen=True, eq=False)
class Compared:
    """Values saved for the gradient of a render's losses; see `image_kernels.compare`."""

    window: Int[Array, "4"]
    difference: Float[Array, "n 4"]
    coarse: Float[Array, "m 4"]
    slopes: Float[Array, "k 3"]


class Target:
    """A frame, its plate and its matte, with precomputed sums of both losses.

    Args:
        plate: the clean background B.
        frame: I, in the same light.
        matte: alpha_in.
        image_scales: number of scales of L_I, each half the last.
        matte_scales: number of scales of L_alpha, each half the last.
    """

    def __init__(
        self,
        plate: Float[Tensor, "H W 3"],
        frame: Float[Tensor, "H W 3"],
        matte: Float[Tensor, "H W"],
        image_scales: int,
        matte_scales: int,
    ) -> None:
        self.size = plate.shape[0], plate.shape[1]
        self._scales = image_scales, matte_scales
        self._table = _levels(*self.size, max(*self._scales, 1))
        self._plate, self._frame = (
            torch.cat([colours, last[..., None]], -1).detach().numpy().reshape(-1, 4)
            for colours, last in ((plate, torch.zeros_like(matte)), (frame, matte))
        )
        self._seen = kernels.sum_up(self._plate, self._frame, self._table)

    def compare(
        self, mean: Float[Array, "H W 4"], box: tuple[int, int, int, int]
    ) -> tuple[tuple[float, float], Compared]:
        """Return (L_I, L_alpha), each the mean over its scales (zero without any), and saved values for `backward`.

        Args:
            mean: premultiplied colours and a silhouette, as a rasteriser returns them; written over.
            box: left, top, right and bottom [px] of all that is drawn; elsewhere `mean` is zero.

        Raises:
            ValueError: the image is not of the frame's size.
        """
        if mean.shape[:2] != self.size:
            raise ValueError(f"a picture of {mean.shape[:2]} pixels is compared with one of {self.size}")
        step = 1 << len(self._table) - 2
        (height, width), (left, top, right, bottom) = self.size, box
        across = left // step * step, min(-(-right // step) * step, width)
        down = top // step * step, min(-(-bottom // step) * step, height)
        window, difference = np.array([across[0], down[0], across[1], down[1]]), mean.reshape(-1, 4)
        coarse, slopes = np.empty((self._table[-1, 0], 4), mean.dtype), np.empty((len(self._table) - 1, 3))
        losses = kernels.compare(
            difference,
            self._plate,
            self._frame,
            window,
            self._table,
            self._seen,
            *self._scales,
            difference,
            coarse,
            slopes,
        )
        return losses, Compared(window, difference, coarse, slopes)

    def backward(self, compared: Compared, grad_losses: Sequence[float]) -> Float[Array, "H W 4"]:
        """Return the gradient by the mean image; undefined outside of the box.

        Args:
            compared: saved by `compare`.
            grad_losses: gradients by L_I and L_alpha.
        """
        gradient, coarse = np.empty_like(compared.difference), np.empty_like(compared.coarse)
        kernels.gradient_of(
            compared.difference,
            compared.coarse,
            self._plate,
            compared.window,
            self._table,
            compared.slopes,
            *grad_losses,
            coarse,
            gradient,
        )
        return gradient.reshape(*self.size, 4)

    def losses(self, mean: Float[Tensor, "H W 4"]) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """Return L_I and L_alpha of a mean render, differentiable in it.

        Args:
            mean: colours and silhouette.
        """
        return _Losses.apply(mean, self)


class _Losses(torch.autograd.Function):
    """`Target.losses` with its backward pass."""

    @staticmethod
    def forward(ctx: Any, mean: Tensor, target: Target) -> tuple[Tensor, Tensor]:
        height, width = target.size
        (image, overlap), ctx.kept = target.compare(mean.detach().numpy().copy(), (0, 0, width, height))
        ctx.target = target
        return mean.new_tensor(image), mean.new_tensor(overlap)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_image: Tensor, by_matte: Tensor) -> tuple[Tensor, None]:
        return torch.from_numpy(ctx.target.backward(ctx.kept, [by_image.item(), by_matte.item()])), None
