"""Worker processes for computations: a fit holds Python's lock too long for two of them to share a process.

Prefect's own process runner costs seconds per flow and 130 ms per task, so its tasks stay threads and hand the
computation itself, a plain function of handles, to a few processes that live as long as the flow. The result does
not depend on their number: each computes with one thread, and nothing is shared between two calls.
"""

from __future__ import annotations

import ctypes
import logging
import logging.handlers
import multiprocessing
import multiprocessing.connection
import multiprocessing.forkserver
import multiprocessing.synchronize
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from hfb.tasks.telemetry.structured_log import WithIds, about, ids_now
from hfb.tasks.workers.engine import Engine, Stopped, WorkerLost, bare, engine_of

if TYPE_CHECKING:
    from hfb.tasks.core.handles import Call
    from hfb.tasks.workers.clusters import Cluster

P = ParamSpec("P")
R = TypeVar("R")
_ATTEMPTS = 3
_log = logging.getLogger(__name__)
_CONVOLUTIONS = "64"
"""Compiled convolutions that oneDNN keeps, in place of 1,024: every size of a crop brings some 50, 90 kB each."""
_LAST_WORDS_S = 0.5


class _Pool:
    """Worker processes; one that dies, such as from lack of memory, is replaced."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._lock = threading.Lock()
        self._closed = False
        self.busy_s = 0.0
        self._executor = self._start()

    def _start(self) -> ProcessPoolExecutor:
        context = _context()
        # one per set of processes: a process that is killed while it writes leaves its queue locked
        self._records = _Records(context)
        begin = (self._records.queue, dict(os.environ))
        return ProcessPoolExecutor(self.count, context, initializer=_begin, initargs=begin)

    def run(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Return a function's result from one of the processes."""
        for _ in range(_ATTEMPTS):
            executor = self._executor
            try:
                result, seconds = executor.submit(_run_timed, ids_now(), function, *args, **kwargs).result()
                with self._lock:
                    self.busy_s += seconds
                _log.info("%s: %.2f s", function.__name__.strip("_"), seconds)
                return result
            except BrokenProcessPool:
                self._replace(executor)
            except (CancelledError, RuntimeError):
                if not self._closed:
                    raise
                raise Stopped from None
        raise WorkerLost(
            f"a worker process died {_ATTEMPTS} times over this; was there enough memory? Give fewer --workers"
        )

    def _replace(self, broken: ProcessPoolExecutor) -> None:
        with self._lock:
            if self._closed:
                raise Stopped
            if self._executor is broken:  # every thread that waited finds out; one of them mends
                broken.shutdown(wait=False)
                self._records.close()
                self._executor = self._start()

    def close(self) -> None:
        # What still computes has no one to give it to: an interrupted flow must not wait for it.
        """End the processes without waiting for their computations."""
        with self._lock:
            self._closed = True
            processes = list((self._executor._processes or {}).values())
            self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:  # gone when this returns: nobody counts them, or their memory, any more
            multiprocessing.connection.wait([process.sentinel], _LAST_WORDS_S)
        self._records.close()


def _context() -> multiprocessing.context.BaseContext:
    """Start workers as forks of a process that has imported the method and has no threads.

    A fork of this process would inherit locks that its threads hold; a fresh process takes seconds to import torch.
    Where a system has no forks, workers are fresh processes all the same.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["hfb.tasks.workers.preloaded"])
    return context


class _Records:
    """Receives the workers' log records: this process's handlers know the log file and the display."""

    def __init__(self, context: multiprocessing.context.BaseContext) -> None:
        self._reader, writer = context.Pipe(duplex=False)
        self._end_reader, self._end = context.Pipe(duplex=False)
        self.queue = _RecordQueue(writer, context.Lock())
        self._thread = threading.Thread(target=self._retell, name="hfb-worker-log", daemon=True)
        self._thread.start()

    def _retell(self) -> None:
        try:  # what has arrived is told before the end is heard
            while self._reader in multiprocessing.connection.wait([self._reader, self._end_reader]):
                record = self._reader.recv()
                logging.getLogger(record.name).handle(record)
        except (EOFError, OSError, pickle.UnpicklingError):  # a worker that was killed in the middle of a word
            return
        finally:
            self._reader.close()  # whoever still speaks is told so, and does not wait

    def close(self) -> None:
        """Stop listening."""
        self._end.send(None)
        self._thread.join(_LAST_WORDS_S)


class _RecordQueue:
    """A worker's end of the log: a record is sent when `put_nowait` returns, before the result that follows it.

    A queue with a thread of its own loses a worker's last records before it is ended.
    """

    def __init__(self, writer: multiprocessing.connection.Connection, lock: multiprocessing.synchronize.Lock) -> None:
        self._writer, self._lock = writer, lock

    def put_nowait(self, record: logging.LogRecord) -> None:
        """Send a record.

        Args:
            record: of the log.
        """
        with self._lock, suppress(OSError):  # nobody listens any more
            self._writer.send(record)


_pool: _Pool | None = None
_cluster: Cluster | None = None
_threads = 1
_last: object = None
"""The function that this process ran last."""
_mapped = SimpleNamespace(seconds=0.0, busy_s=0.0)
"""Duration of steps over many inputs, and the workers' computing time in them."""


@contextmanager
def workers(engine: Engine | int, apart: bool = False) -> Iterator[None]:
    """Run computations inside the block where the engine says.

    Args:
        engine: a number is one of processes.
        apart: whether a single worker is a process, too, which can be stopped and has its own memory; otherwise it is
            this process.

    Raises:
        InputError: a cluster cannot be used.
    """
    global _pool, _cluster, _threads, _mapped
    engine = Engine(count=engine) if isinstance(engine, int) else engine
    _mapped = SimpleNamespace(seconds=0.0, busy_s=0.0)
    try:
        if engine.remote:
            from hfb.tasks.workers.clusters import Cluster

            _cluster = Cluster(engine)
        if engine.kind == "threads":
            _threads = engine.count
        elif engine.count > 1 or apart or engine.remote:
            _pool = _Pool(engine.count)
        yield
    finally:
        stop_computing()
        _pool, _cluster, _threads = None, None, 1


def begin_early(words: str | int) -> None:
    """Start the process that workers will be forks of, where they are: it imports the method while this one does.

    Args:
        words: of `--workers`.
    """
    engine = engine_of(words)
    if engine.kind == "processes" and engine.count > 1 and _context().get_start_method() == "forkserver":
        multiprocessing.forkserver.ensure_running()


def worker_count() -> int:
    """Return the number of workers."""
    pool = _cluster or _pool
    return pool.count if pool else _threads


@contextmanager
def measure_utilisation() -> Iterator[None]:
    """Count the computations inside the block as a step over many inputs."""
    pool = _cluster or _pool
    if pool is None:
        yield
        return
    began, busy_s = time.monotonic(), pool.busy_s
    try:
        yield
    finally:
        _mapped.seconds += time.monotonic() - began
        _mapped.busy_s += pool.busy_s - busy_s


def busy_share() -> float | None:
    """Return the workers' utilisation in steps over many inputs; None where there was none.

    The rest is the cost of orchestration, and the wait for the last input of each step.
    """
    return round(_mapped.busy_s / (worker_count() * _mapped.seconds), 4) if _mapped.seconds else None


def remote() -> bool:
    """Return whether `run_remote` sends calls to a cluster's workers."""
    return _cluster is not None


def stop_computing() -> None:
    """End all computations: an interrupted flow must not wait for them. Their tasks fail with Stopped."""
    if _cluster:
        _cluster.close()
    if _pool:
        _pool.close()


def run_local(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Return a function's result, from a worker process of this machine where there are some.

    Args:
        function: a function of a module, or a task (`hfb.tasks.task`), of which the bare function runs.
        args: its arguments.
        kwargs: its keyword arguments.

    Raises:
        WorkerLost: the process that computed it died, three times.
    """
    if not _pool:
        _turn_to(function)
    return _pool.run(function, *args, **kwargs) if _pool else bare(function)(*args, **kwargs)


def run_remote(function: Callable[..., R], call: Call, gpu: bool = False) -> R:
    """Run a function on one of many inputs: on a cluster's worker where there is one, else as `run_local`.

    Such a function reads only the files of the call's handles, and names only those and the files that it writes into
    the call's ``folder``.

    Args:
        function: as of `run_local`.
        call: its only argument.
        gpu: whether it needs a worker with a GPU that nobody else uses at the time.

    Raises:
        WorkerLost: see `run_local`; or the cluster can no longer be reached.
    """
    return _cluster.run(function, call, gpu) if _cluster else run_local(function, call)


def _run_timed(ids: dict[str, Any], function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> tuple[R, float]:
    _turn_to(function)
    began = time.monotonic()
    with about(ids):
        return bare(function)(*args, **kwargs), time.monotonic() - began


def _turn_to(function: object) -> None:
    """Give what the last kind of task has used back to the system, before another kind lays its own beside it."""
    global _last
    if function is not _last:
        from hfb.initialization.landmarks import forget_networks

        _last = function
        forget_networks()
        with suppress(OSError, AttributeError):  # another system's C library
            ctypes.CDLL(None).malloc_trim(0)


def _begin(records: Any, environment: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)  # the fork server has the one of its own start
    os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", _CONVOLUTIONS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
    logging.captureWarnings(True)
    handler = logging.handlers.QueueHandler(records)
    handler.addFilter(WithIds())
    logging.getLogger().handlers = [handler]  # without Prefect's, which the fork server may have imported
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import torch

    torch.set_num_threads(1)


def _end_with_parent() -> None:
    """End with the parent process: a killed parent cannot stop its workers."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
