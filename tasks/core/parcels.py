"""Several calls of a task in one run of it: a run costs Prefect's server 35 ms and 25 KB, whatever it does.

Each call keeps a result of its own, under the key that it would have alone: what a run does together changes neither
what is done again after a kill nor what depends on what.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

R = TypeVar("R")
_MOST = 16
_ROUNDS = 4


@dataclass(frozen=True)
class Kept(Generic[R]):
    """The result of one call.

    Attributes:
        reused: an earlier run had made it.
    """

    result: R
    reused: bool


class Parcel(Generic[R]):
    """Calls that follow each other in one run, and what becomes of each; no record, so that Prefect does not look in.

    Attributes:
        calls: arguments, one tuple per call. outcomes: in their order; an error is the call's own.
    """

    def __init__(self, label: str, first: int, calls: Sequence[tuple[Any, ...]]) -> None:
        self.calls, self.outcomes = calls, [Future[Kept[R]]() for _ in calls]
        last = first + len(calls) - 1
        self._name = f"{label} {first}" if last == first else f"{label} {first} to {last}"

    def __str__(self) -> str:
        """What the run is called."""
        return self._name

    def work(self, make: Callable[[tuple[Any, ...]], Kept[R]]) -> bool:
        """Make every result; whether an earlier run had made them all.

        Raises:
            Exception: the first of those that calls ended with; the others are made all the same.
        """
        failed: Exception | None = None
        for call, outcome in zip(self.calls, self.outcomes, strict=True):
            try:
                outcome.set_result(make(call))
            except Exception as error:
                outcome.set_exception(error)
                failed = failed or error
        if failed is not None:
            raise failed
        return all(outcome.result().reused for outcome in self.outcomes)

    def give_up(self, reason: BaseException) -> None:
        """Nobody works on it any more."""
        for outcome in self.outcomes:
            if not outcome.done():
                outcome.set_exception(reason)


def parcels(label: str, calls: Sequence[tuple[Any, ...]], crew: int, at_once: int = 1) -> Iterator[Parcel[Any]]:
    """All calls, in order; the fewer are left the fewer go together, so that nobody waits for the last of them.

    Args:
        crew: how many parcels are worked on at a time.
        at_once: how many calls are one computation; where these are several, every parcel is one.
    """
    at = 0
    while at < len(calls):
        count = at_once if at_once > 1 else max(1, min(_MOST, (len(calls) - at) // (_ROUNDS * crew)))
        yield Parcel(label, at, calls[at : at + count])
        at += count
