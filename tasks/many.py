"""One task over many inputs: beside each other, in order, and none lost."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from prefect.futures import PrefectFuture
from prefect.states import State

from tasks import progress
from tasks.handles import StaleFile
from tasks.task import Step, verify
from tasks.workers import shared_out, stop_computing, worker_count

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


def run_all(
    step: Step[..., R],
    calls: Sequence[tuple[Any, ...]],
    label: str,
    on_outcome: Callable[[int, Outcome[R]], None] | None = None,
) -> list[Outcome[R]]:
    """Run a task once per tuple of arguments, as many at a time as the flow's task runner has workers.

    One that fails does not stop the others; its error is its outcome. The outcomes are in the order of the calls,
    whatever the order in which they finished.

    Args:
        on_outcome: called in the order of the calls with each one's number; what it raises ends the rest.
    """
    outcomes: list[Outcome[R]] = []
    waiting: deque[tuple[tuple[Any, ...], PrefectFuture[R]]] = deque()
    remaining = iter(calls)
    with progress.step(label) as shown, shared_out():
        began, reused = time.monotonic(), 0
        progress.advance(0, len(calls))
        most = max(_IN_FLIGHT, 2 * worker_count())
        try:
            while len(outcomes) < len(calls):
                while len(waiting) < most and (call := next(remaining, None)) is not None:
                    waiting.append((call, step.submit(*call)))
                call, future = waiting.popleft()
                outcomes.append(_outcome(step, call, future))
                reused += outcomes[-1].reused
                if (error := outcomes[-1].error) is not None:
                    progress.fail(type(error).__name__)
                if on_outcome is not None:
                    on_outcome(len(outcomes) - 1, outcomes[-1])
                progress.advance(len(outcomes), len(calls), _pace(began, len(outcomes), reused, len(calls)))
        except BaseException:  # Ctrl-C and Prefect's own signals too: the task runner waits for what is computed
            stop_computing()
            raise
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


def _pace(began: float, done: int, reused: int, total: int) -> str:
    """How fast it goes and how long it still takes."""
    fresh = done - reused
    if fresh == 0:
        return ""
    each_s = (time.monotonic() - began) / fresh
    rate = f"{each_s:.1f} s each" if each_s >= 1 else f"{1 / each_s:.1f} a second"
    left_s = round(each_s * (total - done))
    left = f"{left_s // 60} min {left_s % 60} s" if left_s >= 60 else f"{left_s} s"
    return f"{rate}, about {left} left"
