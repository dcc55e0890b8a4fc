"""One task over many inputs: in parallel, in order, and with a cached result for every input.

A run of a task costs Prefect's server 35 ms and 25 KB, whatever it does, so a run takes a chunk of calls. Each call's
result is cached under its own key: chunks affect neither what is repeated after a kill nor what depends on what.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hfb.tasks.core.handles import Call
from hfb.tasks.task import CachedResult, Task, is_bare
from hfb.tasks.telemetry import progress
from hfb.tasks.workers.engine import Stopped
from hfb.tasks.workers.workers import measure_utilisation, remote, stop_computing, worker_count

if TYPE_CHECKING:
    from prefect.futures import PrefectFuture
    from prefect.states import State

C = TypeVar("C", bound=Call)
R = TypeVar("R")

_LARGEST = 16
_ROUNDS = 4
_SPARE = 2  # chunks that are looked up and checked while all workers compute
_AHEAD = 2  # chunks per thread that wait or are done: an interrupted run has little to cancel, a server little to know
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """The outcome of one call.

    Attributes:
        result: None where it failed.
        error: why it failed.
        reused: whether the result comes from an earlier run.
    """

    result: R | None
    error: Exception | None = None
    reused: bool = False


class Chunk(Generic[C, R]):
    """Consecutive calls in one run of a task. It is no record, so that Prefect does not visit its content.

    Attributes:
        calls: in order.
        results: one future per call, in their order; an error is the call's own.
    """

    def __init__(self, label: str, first: int, calls: Sequence[C]) -> None:
        """Take consecutive calls.

        Args:
            label: beginning of the run's name.
            first: number of the first call.
            calls: in order.
        """
        self.calls, self.results = calls, [Future[CachedResult[R]]() for _ in calls]
        last = first + len(calls) - 1
        self._name = f"{label} {first}" if last == first else f"{label} {first} to {last}"

    def __str__(self) -> str:
        """Return the name of the run."""
        return self._name

    def run(self, task: Task[..., R]) -> bool:
        """Compute every result; return whether earlier runs had computed them all.

        Args:
            task: of one record.

        Raises:
            Exception: the first error of a call; the other results are computed nevertheless.
        """
        ahead = _run_batched(task, self.calls)
        failed: Exception | None = None
        for number, (call, result) in enumerate(zip(self.calls, self.results, strict=True)):
            try:
                result.set_result(task.kept(call, ahead.get(number)))
            except Exception as error:
                result.set_exception(error)
                failed = failed or error
        if failed is not None:
            raise failed
        return all(result.result().reused for result in self.results)

    def fail(self, reason: BaseException) -> None:
        """Fail all unfinished calls.

        Args:
            reason: their exception.
        """
        for result in self.results:
            if not result.done():
                result.set_exception(reason)


def map_task(
    task: Task[[C], R], calls: Sequence[C], label: str, on_outcome: Callable[[int, Outcome[R]], None] | None = None
) -> list[Outcome[R]]:
    """Run a task once per call, as many at a time as the flow's task runner has workers.

    A call that fails does not stop the others; its error is its outcome. The outcomes are in the order of the calls,
    whatever the order in which they finished.

    Args:
        task: a task of one record.
        calls: the records.
        label: displayed while they run.
        on_outcome: called with each outcome and its call's number, in the order of the calls; what it raises ends the
            rest.
    """
    outcomes: list[Outcome[R]] = []
    waiting: deque[Chunk[C, R]] = deque()
    n_workers = worker_count() + _SPARE
    # Without Prefect chunks of one call, each computed when its turn comes.
    at_once, n_parts = (1, len(calls)) if is_bare() else (_AHEAD * n_workers, n_workers)
    remaining: Iterator[Chunk[C, R]] = split_calls(label, calls, n_parts, _batch_size(task, calls))
    submit = _submitter(task)
    with progress.step(label) as shown, measure_utilisation():
        began, reused = time.monotonic(), 0
        progress.advance(0, len(calls))
        try:
            while len(outcomes) < len(calls):
                while len(waiting) < at_once and (chunk := next(remaining, None)) is not None:
                    submit(chunk)
                    waiting.append(chunk)
                before = len(outcomes)
                for result in waiting[0].results:
                    outcomes.append(_outcome(result))
                    reused += outcomes[-1].reused
                    if (error := outcomes[-1].error) is not None:
                        progress.fail(type(error).__name__)
                    if on_outcome is not None:
                        on_outcome(len(outcomes) - 1, outcomes[-1])
                    done = before + sum(one.done() for chunk in waiting for one in chunk.results)
                    progress.advance(done, len(calls), _pace(began, done, reused, len(calls)))
                waiting.popleft()
        except BaseException:  # Ctrl-C and Prefect's own signals too: the task runner waits for what is computed
            stop_computing()
            raise
        shown.reused = bool(calls) and reused == len(calls)
    return outcomes


def require_all(
    task: Task[[C], R],
    calls: Sequence[C],
    label: str,
    look: Callable[[], None],
    *,
    on_outcome: Callable[[int, Outcome[R]], None] | None = None,
) -> list[R]:
    """Return all results in order; the first failure stops the rest.

    Args:
        task: of one record.
        calls: the records.
        label: displayed while they run.
        look: called after each result; what it raises ends the rest.
        on_outcome: called with the number and outcome of each call, in order.
    """

    def watched(index: int, outcome: Outcome[R]) -> None:
        if outcome.error is not None:
            raise outcome.error
        look()
        if on_outcome is not None:
            on_outcome(index, outcome)

    outcomes = map_task(task, calls, label, watched)
    return [outcome.result for outcome in outcomes if outcome.result is not None]


def split_calls(label: str, calls: Sequence[C], n_workers: int, batch_size: int = 1) -> Iterator[Chunk[C, Any]]:
    """Yield chunks of all calls, in order; the fewer calls are left, the smaller the chunks, to balance the load.

    Args:
        label: the beginning of every run's name.
        calls: the calls.
        n_workers: how many chunks are worked on at a time.
        batch_size: how many calls are one computation; above 1 every chunk is one computation.
    """
    at = 0
    while at < len(calls):
        count = batch_size if batch_size > 1 else max(1, min(_LARGEST, (len(calls) - at) // (_ROUNDS * n_workers)))
        yield Chunk(label, at, calls[at : at + count])
        at += count


def _batch_size(task: Task[..., R], calls: Sequence[Call]) -> int:
    """Return how many calls are computed together; a cluster's worker gets one at a time."""
    return task.batch.size(calls[0]) if task.batch and calls and not remote() else 1


def _run_batched(task: Task[..., R], calls: Sequence[Call]) -> dict[int, R]:
    """Compute the calls without cached results together; return number of the call -> result, {} for fewer than two.

    If the batch fails, each call is computed alone, so that an error belongs to one call.
    """
    if _batch_size(task, calls) < 2:
        return {}
    fresh = [number for number, call in enumerate(calls) if not task.is_kept(call)]
    if len(fresh) < 2:
        return {}
    try:
        return dict(zip(fresh, task.run_batch([calls[number] for number in fresh]), strict=True))
    except Stopped:
        raise
    except Exception as error:
        _log.warning("%s: one by one, since together: %s", task.name, error)
        return {}


def _submitter(task: Task[..., R]) -> Callable[[Chunk[Any, R]], None]:
    """Return a function that starts a chunk as a run of a Prefect task; without Prefect it computes the chunk."""

    def compute(chunk: Chunk[Any, R]) -> None:
        with suppress(Exception):  # it is the outcome of its call
            chunk.run(task)

    if is_bare():
        return compute
    import prefect
    from prefect.cache_policies import NO_CACHE
    from prefect.states import Completed

    def run_chunk(chunk: Chunk[Any, R]) -> State[Any] | None:
        return Completed(name="Cached") if chunk.run(task) else None

    decorate: Any = prefect.task(
        name=task.name, task_run_name="{chunk}", cache_policy=NO_CACHE, result_serializer="json"
    )
    step = decorate(run_chunk)
    return lambda chunk: _submit(step, chunk)


def _submit(step: Any, chunk: Chunk[Any, Any]) -> None:
    """Start a run; if it ends before its calls, such as after a loss of the server, they fail."""

    def ended(run: PrefectFuture[Any]) -> None:
        if all(one.done() for one in chunk.results):
            return
        try:
            run.wait()
            run.state.result()
        except Exception as error:
            chunk.fail(error)
        chunk.fail(RuntimeError(f"{chunk}: the run ended before its calls"))

    step.submit(chunk).add_done_callback(ended)


def _outcome(result: Future[CachedResult[R]]) -> Outcome[R]:
    try:
        kept = result.result()
        return Outcome(kept.result, None, kept.reused)
    except Exception as error:
        return Outcome(None, error)


def _pace(began: float, done: int, reused: int, total: int) -> str:
    """Format the speed and the remaining time."""
    fresh = done - reused
    if fresh == 0:
        return ""
    each_s = (time.monotonic() - began) / fresh
    rate = f"{each_s:.1f} s each" if each_s >= 1 else f"{1 / each_s:.1f} a second"
    left_s = round(each_s * (total - done))
    left = f"{left_s // 60} min {left_s % 60} s" if left_s >= 60 else f"{left_s} s"
    return f"{rate}, about {left} left"
