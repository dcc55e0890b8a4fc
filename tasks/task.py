"""The project's ``@task``: Prefect's, with a cache key by content, a choice of process, and verified files.

A task is a function of handles and options. `Task` caches its result under the task's name and digests of inputs,
options and code. Prefect's own policies do not suffice: ``INPUTS`` hashes a path and not the file behind it, and
``TASK_SOURCE`` ignores edits in a called library. A task therefore takes handles and the option records that it uses,
never the whole configuration; the folder it writes to does not count.

Input files are verified before and after the function runs: a clip that is replaced while it is read leaves no result
under the old one's key. Results are JSON, since a handle is a few lines. A cache hit does not prove that the file
behind a handle is intact, so every result's files are verified, and a stale result is recreated.

A task that runs ``"here"`` may print and log progress. Elsewhere the function itself is sent, by its name.

Inside `without_prefect` a task is its bare function: the Python library (`hfb.api`) computes the same without a server.
"""

from __future__ import annotations

import functools
import inspect
import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, ParamSpec, TypeVar, cast

from hfb.tasks.core import repetition
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import Call, StaleFile, digest, files_in, verify_unchanged
from hfb.tasks.core.scoped import scoped
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.structured_log import about, ids_of
from hfb.tasks.workers.workers import run_local, run_remote

if TYPE_CHECKING:
    from prefect.context import TaskRunContext

_log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")

Where = Literal["here", "worker", "cluster", "gpu"]
"""Process that runs a task: this one, a worker of this machine, a cluster's worker, or one with a GPU of its own.

Without a cluster a worker of this machine runs it, without workers this process.
"""

_bare: ContextVar[bool] = ContextVar("bare", default=False)


def without_prefect() -> AbstractContextManager[None]:
    """Run tasks inside the block as plain functions of this process: no server, nothing cached."""
    return scoped(_bare, True)


def is_bare() -> bool:
    """Return whether tasks run as plain functions."""
    return _bare.get()


@dataclass(frozen=True)
class BatchFunction:
    """Several calls of a task as one computation, where that is faster than one after another.

    Attributes:
        size: number of calls like this one that are computed together; 1 where batching does not help.
        run: returns the results of several calls, in their order.
    """

    size: Callable[[Any], int]
    run: Callable[[Sequence[Any]], list[Any]]


@dataclass(frozen=True)
class CachedResult(Generic[R]):
    """The result of one call.

    Attributes:
        result: as returned by the task.
        reused: whether it comes from an earlier run.
    """

    result: R
    reused: bool


class Task(Generic[P, R]):
    """A task of this project; calling it runs it through Prefect and returns its result.

    Attributes:
        fn: the bare function, which needs no server.
        batch: how several calls are computed together, if at all.
        name: at Prefect's server and in cache keys.
    """

    def __init__(
        self,
        fn: Callable[P, R],
        label: str,
        *,
        where: Where | Callable[..., Where],
        cached: bool,
        batch: BatchFunction | None,
    ) -> None:
        """Wrap a function; see `task`.

        Args:
            fn: the bare function.
            label: displayed while it runs.
            where: which process runs it.
            cached: whether results are cached.
            batch: how several calls are computed together.
        """
        functools.update_wrapper(self, fn)
        self.fn, self.name, self.batch = fn, fn.__name__, batch
        self._label, self._where, self._cached = label, where, cached

    @functools.cached_property
    def _step(self) -> Any:
        """Prefect's task, which is imported at the first call that needs it."""
        import prefect
        from prefect.cache_policies import NO_CACHE

        caching: dict[str, Any] = {"cache_key_fn": _cache_key} if self._cached else {"cache_policy": NO_CACHE}
        run = functools.wraps(self.fn)(lambda *args, **kwargs: self.run(*args, **kwargs))
        return prefect.task(persist_result=self._cached, result_serializer="json", **caching)(run)

    def __reduce__(self) -> str:
        """Send the task by its name: a worker process imports it and calls `fn`."""
        return self.fn.__qualname__

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the task, or return the cached result of an earlier run with the same inputs, options and code."""
        with progress.step(self._label) as shown:
            if is_bare():
                return self.run(*args, **kwargs)
            state = self._step(*args, **kwargs, return_state=True)
            result = state.result()
            shown.reused = state.name == "Cached"
            try:
                verify(result)
            except StaleFile as stale:
                _log.warning("%s: made again, since %s", self._label, stale)
                shown.reused = False
                result = self._step.with_options(refresh_cache=True)(*args, **kwargs)
                verify(result)
            return cast(R, result)

    def run(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the function where it belongs, without Prefect.

        Raises:
            StaleFile: an input file does not match its handle, before or after.
        """
        with verify_unchanged(args, tuple(kwargs.values())):  # a result is kept under the digests of its inputs
            where = self._where(*args, **kwargs) if callable(self._where) else self._where
            if where == "here":
                return self.fn(*args, **kwargs)
            if where == "worker":
                return run_local(self, *args, **kwargs)
            return run_remote(self, cast(Call, args[0]), gpu=where == "gpu")  # what leaves this machine is one record

    def run_batch(self, calls: Sequence[Any]) -> list[R]:
        """Return the results of several calls, computed together on this machine; raises as `run` does.

        Args:
            calls: records of a mapped task.
        """
        assert self.batch is not None
        with verify_unchanged(calls):
            return run_local(self.batch.run, calls)

    def key(self, call: Any) -> str:
        """Return the cache key of a call of a mapped task.

        Args:
            call: its one argument.
        """
        return cache_key(self.name, self._arguments(call))

    def kept(self, call: Any, ahead: R | None = None) -> CachedResult[R]:
        """Return a call's cached result, or a new one, which is cached as Prefect caches a run's.

        Args:
            call: the one argument of a mapped task.
            ahead: the call's result, where it was computed in a batch.
        """
        if is_bare():
            return CachedResult(self.run(call) if ahead is None else ahead, False)  # type: ignore[call-arg]
        from prefect.results import get_result_store

        key, records = self.key(call), get_result_store()

        def made() -> R:
            result = self.run(call) if ahead is None else ahead  # type: ignore[call-arg]
            records.write(result, key=key)
            return result

        with about(ids_of(self._arguments(call))):
            reused = records.exists(key)
            result = cast(R, records.read(key).result) if reused else made()
            try:
                verify(result)
            except StaleFile as stale:
                _log.warning("%s: made again, since %s", self.name, stale)
                result, reused = made(), False
                verify(result)
        return CachedResult(result, reused)

    def is_kept(self, call: Any) -> bool:
        """Return whether a call's result is cached.

        Args:
            call: the one argument of a mapped task.
        """
        if is_bare():
            return False
        from prefect.results import get_result_store

        return get_result_store().exists(self.key(call))

    def _arguments(self, call: Any) -> dict[str, Any]:
        (name,) = inspect.signature(self.fn).parameters
        return {name: call}


def task(
    label: str, *, where: Where | Callable[..., Where] = "here", cached: bool = True, batch: BatchFunction | None = None
) -> Callable[[Callable[P, R]], Task[P, R]]:
    """Make a module's function of handles and options a task.

    Args:
        label: displayed while it runs.
        where: which process runs it, or a function of the task's arguments that decides.
        cached: False for a task that exists for its effect elsewhere, such as a record in MLflow.
        batch: how several calls are computed together; each result equals that of the call alone.
    """
    return lambda fn: Task(fn, label, where=where, cached=cached, batch=batch)


def cache_key(name: str, parameters: dict[str, Any]) -> str:
    """Return the task's name and a hash of everything that can change its result; a repetition has keys of its own.

    Args:
        name: of the task.
        parameters: its arguments by name; paths do not count.
    """
    inputs = {key: digest(value) for key, value in sorted(parameters.items()) if not isinstance(value, Path)}
    return f"hfb-{name}-{digest([name, inputs, code_version(), repetition.salt()])[:40]}"


def verify(result: object) -> None:
    """Raise StaleFile if a file that a result names is missing or was changed.

    Args:
        result: handles, or anything without files.
    """
    for file in files_in(result):
        file.verify()


def _cache_key(context: TaskRunContext, parameters: dict[str, Any]) -> str:
    return cache_key(context.task.name, parameters)
