"""Worker processes for what computes: a fit holds Python's lock too long for two of them to share a process.

Prefect's own process runner costs seconds per flow and 130 ms per task, so its tasks stay threads and hand the
computation itself, a plain function of handles, to a few processes that live as long as the flow. The result does
not depend on their number: each computes with one thread, and nothing is shared between two calls.
"""

from __future__ import annotations

import logging
import logging.handlers
import multiprocessing
import multiprocessing.connection
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
_ATTEMPTS = 3
_LAST_WORDS_S = 0.5


class WorkerLost(Exception):
    """A worker process died, more than once, over the same computation."""


class Stopped(Exception):
    """The workers were told to stop: nobody waits for this computation any more."""


class _Pool:
    """Processes that are replaced when one of them dies, by the kernel's hand when memory runs out, say."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._lock = threading.Lock()
        self._closed = False
        self.busy_s, self.shared_s, self.shared_busy_s = 0.0, 0.0, 0.0
        self._executor = self._started()

    def _started(self) -> ProcessPoolExecutor:
        # spawn: a forked child would inherit locks that threads of the parent hold
        context = multiprocessing.get_context("spawn")
        # one per set of processes: a process that is killed while it writes leaves its queue locked
        self._records = _Records(context)
        return ProcessPoolExecutor(self.count, context, initializer=_begin, initargs=(self._records.queue,))

    def run(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        for _ in range(_ATTEMPTS):
            executor = self._executor
            try:
                result, seconds = executor.submit(_timed, function, args, kwargs).result()
                with self._lock:
                    self.busy_s += seconds
                return result
            except BrokenProcessPool:
                self._replace(executor)
            except (CancelledError, RuntimeError):
                if not self._closed:
                    raise
                raise Stopped from None
        raise WorkerLost(f"a worker process died {_ATTEMPTS} times over this; was there enough memory?")

    def _replace(self, broken: ProcessPoolExecutor) -> None:
        with self._lock:
            if self._closed:
                raise Stopped
            if self._executor is broken:  # every thread that waited finds out; one of them mends
                broken.shutdown(wait=False)
                self._records.close()
                self._executor = self._started()

    def close(self) -> None:
        # What still computes has no one to give it to: an interrupted flow must not wait for it.
        with self._lock:
            self._closed = True
            processes = list((self._executor._processes or {}).values())
            self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        self._records.close()


class _Records:
    """What workers log, said by this process: its handlers know the log file and the display."""

    def __init__(self, context: multiprocessing.context.SpawnContext) -> None:
        self.queue: Any = context.Queue()
        self.queue.cancel_join_thread()
        self._thread = threading.Thread(target=self._retell, name="hfb-worker-log", daemon=True)
        self._thread.start()

    def _retell(self) -> None:
        try:
            while (record := self.queue.get()) is not None:
                logging.getLogger(record.name).handle(record)
        except (EOFError, OSError, pickle.UnpicklingError):  # a worker that was killed in the middle of a word
            return

    def close(self) -> None:
        self.queue.put(None)
        self._thread.join(_LAST_WORDS_S)


_pool: _Pool | None = None


@contextmanager
def workers(count: int, apart: bool = False) -> Iterator[None]:
    """Computations inside run in this many processes.

    Args:
        apart: a single worker is a process too, which can be stopped, and whose memory is not this process's;
            otherwise one means this process itself.
    """
    global _pool
    if count < 2 and not apart:
        yield
        return
    _pool = _Pool(count)
    try:
        yield
    finally:
        pool, _pool = _pool, None
        pool.close()


def worker_count() -> int:
    """How many processes compute."""
    return _pool.count if _pool else 1


@contextmanager
def shared_out() -> Iterator[None]:
    """What is computed inside is one step over many inputs, meant to keep every worker busy."""
    pool = _pool
    if pool is None:
        yield
        return
    began, busy_s = time.monotonic(), pool.busy_s
    try:
        yield
    finally:
        pool.shared_s += time.monotonic() - began
        pool.shared_busy_s += pool.busy_s - busy_s


def busy_share() -> float | None:
    """The share of the workers' time in which they computed, of steps over many inputs; None where there was none.

    What is missing of 1 is the cost of orchestration, and the wait for the last of each step.
    """
    if _pool is None or not _pool.shared_s:
        return None
    return round(_pool.shared_busy_s / (_pool.count * _pool.shared_s), 4)


def stop_computing() -> None:
    """End what computes right now: a flow that was interrupted must not wait for it. Its tasks fail with Stopped."""
    if _pool:
        _pool.close()


def compute(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """The function's result, from a worker process where there are some.

    Raises:
        WorkerLost: the process that computed it died, three times.
    """
    return _pool.run(function, *args, **kwargs) if _pool else function(*args, **kwargs)


def _timed(function: Callable[..., R], args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[R, float]:
    began = time.monotonic()
    return function(*args, **kwargs), time.monotonic() - began


def _begin(records: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
    records.cancel_join_thread()  # nobody waits for a worker's last words
    logging.captureWarnings(True)
    logging.getLogger().addHandler(logging.handlers.QueueHandler(records))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import torch

    torch.set_num_threads(1)


def _end_with_parent() -> None:
    """No orphans, at once: a parent that was killed cannot tell its workers, and nobody hears of what they make."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
