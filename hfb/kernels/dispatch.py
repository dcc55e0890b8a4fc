"""The choice between compiled kernels and the readable torch formulas that they are tested against.

Compiled kernels accept tensors of one fit in the CPU's memory. The readable form runs on any device, and under
`torch.func.vmap`, which passes tensors of many fits to a formula written for one.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache

import torch

from hfb.typing import Shaped, Tensor

_readable = ContextVar("readable", default=False)


def compiled(tensor: Shaped[Tensor, "..."]) -> bool:
    """Return whether the compiled kernels accept this tensor.

    Args:
        tensor: an argument of the formula.
    """
    return tensor.device.type == "cpu" and not _readable.get()


@contextmanager
def readable_formulas() -> Iterator[None]:
    """Use the readable torch formulas inside, in this thread."""
    before = _readable.set(True)
    try:
        yield
    finally:
        _readable.reset(before)


@lru_cache(maxsize=256)
def constant(values: tuple | float, dtype: torch.dtype, device: torch.device) -> Shaped[Tensor, "..."]:
    """Return a cached tensor of some numbers, since copying them to a device makes the CPU wait for it.

    The caller must not change it.

    Args:
        values: number or nested tuples of numbers.
        dtype: precision.
        device: device of the tensor.
    """
    return torch.tensor(values, dtype=dtype, device=device)
