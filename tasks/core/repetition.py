"""Whether the work at hand repeats a recorded run: then no earlier result is taken, and the record is one of its own.

A repetition that is interrupted goes on from its own results, in the same folder; never from those of the run that it
repeats. Light to import.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Repetition:
    """A run that is made again.

    Attributes:
        of: the recorded run.
        out: the folder of the repetition.
    """

    of: str
    out: Path


_current: ContextVar[Repetition | None] = ContextVar("repetition", default=None)


@contextmanager
def repeat_run(repetition: Repetition) -> Iterator[None]:
    """What is computed and recorded inside repeats a run; Prefect hands this on to the threads of its tasks."""
    token = _current.set(repetition)
    try:
        yield
    finally:
        _current.reset(token)


def current() -> Repetition | None:
    """The repetition at hand."""
    return _current.get()


def salt() -> str:
    """What a key of a cache or a record takes in, so that only the same repetition finds it; empty in a first run."""
    repetition = _current.get()
    return f"{repetition.of} in {repetition.out.resolve()}" if repetition else ""
