"""Computations on the machines of an existing Dask or Ray cluster.

A call sends a function's name and its handles. With a store the files travel through it: a worker needs nothing but the
URL, and this machine gets the results. Whoever may talk to such a cluster may run code on it: see SECURITY.md.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar

from hfb.errors import InputError, TemporaryError, install_advice
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import Call, FileHandle, files_in, with_files
from hfb.tasks.telemetry.secrets import without_secrets
from hfb.tasks.workers.engine import Engine, WorkerLost, bare
from hfb.tasks.workers.shared_store import shared_store

P = ParamSpec("P")
R = TypeVar("R")
_log = logging.getLogger(__name__)
_ANSWER_S = 30
_RETRIES = 2
_CACHE_BYTES = 2 << 30


class _Members(Protocol):
    """A cluster's workers, each with one thread."""

    def count(self) -> int:
        """Number of workers."""

    def call(self, gpu: bool, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return a function's result from one of the workers."""

    def close(self) -> None:
        """Leave the cluster."""


class Cluster:
    """Runs functions of handles elsewhere, any number at a time.

    Attributes:
        count: workers at the start.
        busy_s: their total computing time [s].
    """

    def __init__(self, engine: Engine) -> None:
        """Connect to the cluster.

        Args:
            engine: kind, address and store.

        Raises:
            InputError: the library is missing, the cluster does not answer, or it has no workers.
        """
        self._store = engine.store
        if self._store:
            shared_store(self._store)
        self._members: _Members = (_Dask if engine.kind == "dask" else _Ray)(engine.address)
        self.count, self.busy_s = self._members.count(), 0.0
        self._lock, self._closed = threading.Lock(), False

    def run(self, function: Callable[..., R], call: Call, gpu: bool) -> R:
        """Return the function's result; its files are where they would be if it had run here.

        Args:
            function: a function of a module, or a task, of one record.
            call: the record.
            gpu: whether it needs a GPU.

        Raises:
            WorkerLost: see there.
            InputError: the worker has another version of hfb, or what the function raises.
        """
        if self._store:
            shared_store(self._store).put(call)
        value, seconds = self._members.call(gpu, _compute_away, self._store, code_version(), function, call)
        with self._lock:
            self.busy_s += seconds
        _log.info("%s: %.2f s", function.__name__.strip("_"), seconds)
        folder: Path | None = getattr(call, "folder", None)
        if self._store and folder is not None:
            value = shared_store(self._store).take(value, lambda file: folder / file.path)
        return value

    def close(self) -> None:
        """Leave the cluster, whatever it still computes."""
        with self._lock:
            closed, self._closed = self._closed, True
        if not closed:
            self._members.close()


class _Dask:
    """Workers of a Dask cluster."""

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(f"a Dask cluster needs its library: {install_advice('dask')}") from None
        try:
            self._client: Any = Client(address, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            place = without_secrets(address)
            raise TemporaryError(f"no Dask scheduler answers at {place} ({type(error).__name__}): is it up?") from None
        self._running: set[Any] = set()

    def count(self) -> int:
        """Number of workers."""
        try:
            self._client.wait_for_workers(1, timeout=_ANSWER_S)
        except TimeoutError:
            raise TemporaryError(
                "the Dask cluster has no worker: start some with `dask worker ADDRESS --nthreads 1`"
            ) from None
        return sum(self._client.nthreads().values())

    def call(self, gpu: bool, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return a function's result from one of the workers."""
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker

        needs = {"GPU": 1} if gpu else None
        future = self._client.submit(function, *args, **kwargs, pure=False, retries=_RETRIES, resources=needs)
        self._running.add(future)
        try:
            result: R = future.result()
            return result
        except (KilledWorker, FutureCancelledError) as error:
            raise WorkerLost(f"the Dask cluster lost what it computed ({type(error).__name__}).") from error
        finally:
            self._running.discard(future)

    def close(self) -> None:
        """Leave the cluster."""
        self._client.cancel(list(self._running), force=True)
        self._client.close(timeout=5)


class _Ray:
    """Workers of a Ray cluster."""

    def __init__(self, address: str) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError:
            raise InputError(f"a Ray cluster needs its library: {install_advice('ray')}") from None
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, RuntimeError, ValueError) as error:
            place = without_secrets(address)
            raise TemporaryError(f"no Ray node answers at {place} ({type(error).__name__}): is it up?") from None
        self._ray: Any = ray
        self._running: set[Any] = set()

    def count(self) -> int:
        """Number of workers."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def call(self, gpu: bool, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return a function's result from one of the workers."""
        errors = self._ray.exceptions
        distant = self._ray.remote(num_cpus=1, num_gpus=int(gpu), max_retries=_RETRIES)(function)
        reference = distant.remote(*args, **kwargs)
        self._running.add(reference)
        try:
            result: R = self._ray.get(reference)
            return result
        except errors.RayTaskError as error:
            raise error.cause from None
        except errors.RayError as error:
            raise WorkerLost(f"the Ray cluster lost what it computed ({type(error).__name__}).") from error
        finally:
            self._running.discard(reference)

    def close(self) -> None:
        """Leave the cluster."""
        for reference in list(self._running):
            self._ray.cancel(reference, force=True)
        self._ray.shutdown()


def _compute_away(store: str | None, code: str, function: Callable[[Call], R], call: Call) -> tuple[R, float]:
    """Run a call on the worker; return the result, and how long it took [s].

    Raises:
        InputError: this is another version of hfb.
    """
    import torch

    if code_version() != code:
        raise TemporaryError(
            f"a worker runs hfb {code_version()}, this machine {code}: install the same version on both"
        )
    torch.set_num_threads(1)
    began = time.monotonic()
    if store is None:
        return bare(function)(call), time.monotonic() - began
    with _cache as cached, tempfile.TemporaryDirectory(prefix="hfb-") as made:
        folder = Path(made).resolve()
        there = shared_store(store)
        here = there.take(call, lambda file: cached / file.sha256 / file.path.name)
        value = bare(function)(here.model_copy(update={"folder": folder}) if hasattr(call, "folder") else here)
        there.put(value)
        inputs = {(file.sha256, file.path.name): file.path for file in files_in(call)}
        value = with_files(value, lambda file: _as_called_there(file, folder, inputs))
    return value, time.monotonic() - began


def _as_called_there(file: FileHandle, folder: Path, inputs: dict[tuple[str, str], Path]) -> FileHandle:
    """Return a file by its place in the folder, or, for an input, by its original name."""
    made = file.path.is_relative_to(folder)
    path = file.path.relative_to(folder) if made else inputs[file.sha256, file.path.name]
    return file.model_copy(update={"path": path})


class _Cache:
    """A worker's own copies of files, by content; cleared when they are large and unused."""

    def __init__(self) -> None:
        self._lock, self._users = threading.Lock(), 0
        self._folder: Path | None = None

    def __enter__(self) -> Path:
        with self._lock:
            if self._folder is None:
                self._folder = Path(tempfile.mkdtemp(prefix="hfb-cache-"))
                atexit.register(shutil.rmtree, self._folder, ignore_errors=True)
            self._users += 1
            return self._folder

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._users -= 1
            assert self._folder is not None
            if not self._users and sum(path.stat().st_size for path in self._folder.rglob("*")) > _CACHE_BYTES:
                shutil.rmtree(self._folder)
                self._folder.mkdir()


_cache = _Cache()
