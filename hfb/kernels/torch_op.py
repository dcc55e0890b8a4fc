"""Compiled kernels as torch operators, with a faster path where only autograd is used.

torch.compile and export need a registered operator. Called directly, one costs 25 to 33 us more, forward and backward,
than a plain autograd function with the same kernels, and some of the kernels take no longer than that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from hfb.typing import Array, Tensor

_PLAIN = (torch.Tensor, torch.nn.Parameter)


def arrays(*tensors: Tensor) -> list[Array]:
    """Return contiguous arrays of tensors, in the tensors' own memory where they are contiguous.

    Args:
        *tensors: tensors to convert.
    """
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


class Operator:
    """A function of tensors that computes in numpy.

    Args:
        name: name of the operator, such as ``hfb::skin``.
        function: takes tensors and numbers, computes in numpy.

    Attributes:
        registered: the operator as torch.compile, export and `torch.library.opcheck` take it.
    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        self.registered = torch.library.custom_op(name, function, mutates_args=())
        self._direct = function

    def __call__(self, *arguments: Any) -> Any:
        """Call the registered operator where torch traces, with tensors of its kinds; else the function directly."""
        if torch.compiler.is_compiling() or not all(
            type(one) in _PLAIN for one in arguments if isinstance(one, Tensor)
        ):
            return self.registered(*arguments)
        return self._direct(*arguments)

    def register_fake(self, fake: Callable[..., Any]) -> None:
        """Register a function that returns shapes and types of the results, for `torch.compile`.

        Args:
            fake: takes the operator's arguments.
        """
        self.registered.register_fake(fake)

    def register_autograd(self, backward: Callable[..., Any], keep: Callable[..., None]) -> None:
        """Register the backward pass.

        Args:
            backward: (ctx, gradients of the results) to the gradients of the arguments.
            keep: (ctx, arguments, results), saves what it needs.
        """
        self.registered.register_autograd(backward, setup_context=keep)
        function = self._direct

        class Shortcut(torch.autograd.Function):
            @staticmethod
            def forward(ctx: Any, *arguments: Any) -> Any:  # beside `setup_context` it would be inspected at every call
                results = function(*arguments)
                keep(ctx, arguments, results)
                return results

            @staticmethod
            @once_differentiable
            def backward(ctx: Any, *gradients: Any) -> Any:
                return backward(ctx, *gradients)

        self._direct = Shortcut.apply


def operator(name: str) -> Callable[[Callable[..., Any]], Operator]:
    """Return a decorator that makes an `Operator`; types are the schema, as of `torch.library.custom_op`.

    Args:
        name: name of the operator, such as ``hfb::skin``.
    """
    return lambda function: Operator(name, function)


def measure(name: str, moving: int) -> Callable[[Callable[..., Any]], Operator]:
    """Return a decorator that makes an `Operator` of one number and its gradient.

    The function returns the number and its gradients by its first `moving` arguments; the others are constants. The
    backward pass is a product.

    Args:
        name: name of the operator, such as ``hfb::skin``.
        moving: number of differentiable arguments.
    """

    def made(function: Callable[..., Any]) -> Operator:
        one = Operator(name, function)

        def fake(*arguments: Any) -> tuple[Tensor, ...]:
            return arguments[0].new_empty(()), *(one.new_empty(one.shape) for one in arguments[:moving])

        def keep(ctx: Any, inputs: Sequence[Any], output: tuple[Tensor, ...]) -> None:
            ctx.save_for_backward(*output[1:])
            ctx.mark_non_differentiable(*output[1:])
            ctx.constants = len(inputs) - moving

        def backward(ctx: Any, grad_output: Tensor, *_: Any) -> tuple[Tensor | None, ...]:
            return *(grad_output * gradient for gradient in ctx.saved_tensors), *[None] * ctx.constants

        one.register_fake(fake)
        one.register_autograd(backward, keep)
        return one

    return made
