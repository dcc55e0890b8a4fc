"""Adam on the few tensors of one fit in the CPU's memory."""

from collections.abc import Sequence

from hfb.kernels import fit_adam as kernels_adam
from hfb.typing import Tensor


class Adam:
    """`torch.optim.Adam` with a rate for every tensor at every step; gradients are cleared after a step.

    Torch's fused Adam (2.13) differs in last bits from the first step on, so recorded fits would not repeat, and a fit
    takes 2 % longer with it (preset `best`, median of 12 pairs in turn, one thread).

    Args:
        leaves: tensors to optimise, changed in place.
        epsilon: constant added to the root of the mean square.
    """

    def __init__(self, leaves: Sequence[Tensor], epsilon: float) -> None:
        self._leaves, self._epsilon, self._steps = leaves, epsilon, 0
        self._means = [leaf.new_zeros(leaf.shape) for leaf in leaves]
        self._squares = [leaf.new_zeros(leaf.shape) for leaf in leaves]
        for leaf in leaves:
            leaf.grad = None

    def step(self, rates: Sequence[float]) -> None:
        """Move every leaf that has a gradient, and forget the gradient.

        Args:
            rates: the learning rate of each leaf.
        """
        self._steps += 1
        for leaf, mean, square, rate in zip(self._leaves, self._means, self._squares, rates, strict=True):
            if leaf.grad is not None:
                values = leaf.detach().contiguous()
                numbers = (one.view(-1).numpy() for one in (values, leaf.grad.contiguous(), mean, square))
                kernels_adam.step(*numbers, self._steps, rate, self._epsilon)
                if not leaf.is_contiguous():
                    leaf.detach().copy_(values)
                leaf.grad = None
