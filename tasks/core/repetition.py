"""The current repetition of a recorded run: it reuses no earlier results, and has a record of its own.

A repetition that is interrupted continues from its own results, in the same folder; never from those of the run that
it repeats. Light to import.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from hfb.tasks.core.scoped import scoped


@dataclass(frozen=True)
class Repetition:
    """A repetition of a recorded run.

    Attributes:
        of: the recorded run.
        out: the folder of the repetition.
    """

    of: str
    out: Path


_current: ContextVar[Repetition | None] = ContextVar("repetition", default=None)


def repeat_run(repetition: Repetition) -> AbstractContextManager[None]:
    """Mark everything inside the block as a repetition; Prefect passes this on to the threads of its tasks.

    Args:
        repetition: the recorded run and the new folder.
    """
    return scoped(_current, repetition)


def current() -> Repetition | None:
    """Return the current repetition, or None."""
    return _current.get()


def salt() -> str:
    """Return what cache keys and record keys include so that only the same repetition matches; empty in a first run."""
    repetition = _current.get()
    return f"{repetition.of} in {repetition.out.resolve()}" if repetition else ""
