"""One task over many inputs: beside each other, in order, and none lost."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from prefect.futures import PrefectFuture

from hfb.tasks.core.parcels import Kept, Parcel, parcels
from hfb.tasks.core.task import Step
from hfb.tasks.telemetry import progress
from hfb.tasks.workers.workers import shared_out, stop_computing, worker_count

R = TypeVar("R")

_SPARE = 2  # parcels that are looked up and checked while all workers compute
_AHEAD = 2  # parcels per thread that wait or are done: an interrupted run has little to cancel, a server little to know


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
    waiting: deque[Parcel[R]] = deque()
    crew = worker_count() + _SPARE
    remaining = parcels(label, calls, crew, step.count_at_once(calls[0]) if calls else 1)
    with progress.step(label) as shown, shared_out():
        began, reused = time.monotonic(), 0
        progress.advance(0, len(calls))
        try:
            while len(outcomes) < len(calls):
                while len(waiting) < _AHEAD * crew and (parcel := next(remaining, None)) is not None:
                    _submit(step, parcel)
                    waiting.append(parcel)
                before = len(outcomes)
                for call in waiting[0].outcomes:
                    outcomes.append(_outcome(call))
                    reused += outcomes[-1].reused
                    if (error := outcomes[-1].error) is not None:
                        progress.fail(type(error).__name__)
                    if on_outcome is not None:
                        on_outcome(len(outcomes) - 1, outcomes[-1])
                    done = before + sum(one.done() for parcel in waiting for one in parcel.outcomes)
                    progress.advance(done, len(calls), _pace(began, done, reused, len(calls)))
                waiting.popleft()
        except BaseException:  # Ctrl-C and Prefect's own signals too: the task runner waits for what is computed
            stop_computing()
            raise
        shown.reused = bool(calls) and reused == len(calls)
    return outcomes


def _submit(step: Step[..., R], parcel: Parcel[R]) -> None:
    """Start a run; if it ends before its calls, as one does whose server went away, so have they."""

    def ended(run: PrefectFuture[Any]) -> None:
        if all(one.done() for one in parcel.outcomes):
            return
        try:
            run.wait()
            run.state.result()
        except Exception as error:
            parcel.give_up(error)
        parcel.give_up(RuntimeError(f"{parcel}: the run ended before its calls"))

    step.submit(parcel).add_done_callback(ended)


def _outcome(call: Future[Kept[R]]) -> Outcome[R]:
    try:
        kept = call.result()
        return Outcome(kept.result, None, kept.reused)
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
