"""One task over many inputs: beside each other, in order, and none lost."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from prefect.futures import PrefectFuture
from prefect.states import State

from tasks import progress
from tasks.handles import StaleFile
from tasks.task import Step, verify

_log = logging.getLogger(__name__)
R = TypeVar("R")

# Submitted but not finished: enough to keep every worker busy, few enough that an interrupted run has
# little to cancel and a server of ten thousand frames little to remember at once.
_IN_FLIGHT = 16


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """What became of one input.

    Attributes:
        result: None where it failed.
        error: why it failed.
        reused: an earlier run had done it already.
    """

    result: R | None
    error: Exception | None = None
    reused: bool = False


def run_all(step: Step[..., R], calls: Sequence[tuple[Any, ...]], label: str) -> list[Outcome[R]]:
    """Run a task once per tuple of arguments, as many at a time as the flow's task runner has workers.

    One that fails does not stop the others; its error is its outcome. The outcomes are in the order of the calls,
    whatever the order in which they finished.
    """
    outcomes: list[Outcome[R]] = []
    waiting: deque[tuple[tuple[Any, ...], PrefectFuture[R]]] = deque()
    remaining = iter(calls)
    with progress.step(label) as shown:
        began, reused = time.monotonic(), 0
        while len(outcomes) < len(calls):
            while len(waiting) < _IN_FLIGHT and (call := next(remaining, None)) is not None:
                waiting.append((call, step.submit(*call)))
            call, future = waiting.popleft()
            outcomes.append(_outcome(step, call, future))
            reused += outcomes[-1].reused
            progress.advance(len(outcomes), len(calls), _time_left(began, len(outcomes), reused, len(calls)))
        shown.reused = bool(calls) and reused == len(calls)
    return outcomes


def _outcome(step: Step[..., R], call: tuple[Any, ...], future: PrefectFuture[R]) -> Outcome[R]:
    future.wait()
    outcome: Outcome[R] = _settled(future.state)
    if outcome.result is None:
        return outcome
    try:
        verify(outcome.result)
        return outcome
    except StaleFile as stale:
        _log.warning("%s: made again, since %s", step.fn.__name__, stale)
        return _settled(step.again(*call))


def _settled(state: State[R]) -> Outcome[R]:
    try:
        return Outcome(state.result(), None, state.name == "Cached")
    except Exception as error:
        return Outcome(None, error)


def _time_left(began: float, done: int, reused: int, total: int) -> str:
    fresh = done - reused
    if fresh == 0:
        return ""
    left_s = (time.monotonic() - began) / fresh * (total - done)
    return f"about {left_s // 60:.0f} min {left_s % 60:.0f} s left" if left_s >= 60 else f"about {left_s:.0f} s left"
