"""A context variable's value inside a block."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")


@contextmanager
def scoped(variable: ContextVar[T], value: T) -> Iterator[None]:
    """Give a variable a value inside the block, and then what it had.

    Args:
        variable: read by what runs inside.
        value: its value there.
    """
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)
