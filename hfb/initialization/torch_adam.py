"""`torch.optim.Adam` to the last bit, without its import of torch's compiler, which costs a second and 70 MB."""

import math
from collections.abc import Sequence

from hfb.typing import Tensor

_EPSILON = 1e-8


class Adam:
    """Adam over leaves with a learning rate each, as `torch.optim.Adam` computes it on a processor.

    Args:
        leaves: tensors to optimise, changed in place, each with its learning rate.
        betas: decay of the mean of the gradient, and of the mean of its square.
        cosine: number of steps in which all rates fall to a last one along a half cosine, as
            `torch.optim.lr_scheduler.CosineAnnealingLR` computes it, and that rate; None for constant rates.
    """

    def __init__(
        self,
        leaves: Sequence[tuple[Tensor, float]],
        betas: tuple[float, float] = (0.9, 0.999),
        cosine: tuple[int, float] | None = None,
    ) -> None:
        self._betas, self._cosine, self._steps = betas, cosine, 0
        self._leaves = [(leaf.detach(), leaf) for leaf, _ in leaves]
        self._rates = [rate for _, rate in leaves]
        self._means = [(value.new_zeros(value.shape), value.new_zeros(value.shape)) for value, _ in self._leaves]

    def step(self) -> None:
        """Move every leaf, which must have a gradient, and forget the gradient."""
        self._steps += 1
        decay, square_decay = self._betas
        root = (1 - square_decay**self._steps) ** 0.5
        for (value, leaf), rate, (mean, square) in zip(self._leaves, self._rates, self._means, strict=True):
            slope, leaf.grad = leaf.grad, None
            assert slope is not None
            mean.lerp_(slope, 1 - decay)
            square.mul_(square_decay).addcmul_(slope, slope, value=1 - square_decay)
            value.addcdiv_(mean, (square.sqrt() / root).add_(_EPSILON), value=-rate / (1 - decay**self._steps))
        if self._cosine is not None:
            count, last = self._cosine
            before, now = (1 + math.cos(math.pi * step / count) for step in (self._steps - 1, self._steps))
            self._rates = [now / before * (rate - last) + last for rate in self._rates]
