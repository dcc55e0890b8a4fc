"""The project's own ``@task``: Prefect's, with a cache key that means something and a result that is checked.

The key is task name + digests of the inputs + the options that the task takes + the version of the code.
Prefect's own policies do not suffice: ``INPUTS`` hashes a path and not the file behind it, ``TASK_SOURCE`` does
not see an edit in a called library. A task therefore takes handles and the records of options that matter to
it, never the whole configuration; the folder it writes to does not count.

Files that a task is given are what their handles say before it works and after it: a clip that is replaced while it is
read leaves no result under the old one's key.

Results are kept as JSON, since a handle is a few lines. A cache hit alone does not notice that the file behind
a handle is gone or damaged, so every result's files are verified, and a stale one is made again.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar, cast

import prefect
from prefect.cache_policies import NO_CACHE
from prefect.context import TaskRunContext
from prefect.futures import PrefectFuture
from prefect.results import get_result_store
from prefect.states import Completed, State

import hfb
from hfb.tasks.core import repetition
from hfb.tasks.core.handles import StaleFile, digest, files_in, unchanged
from hfb.tasks.core.parcels import Kept, Parcel
from hfb.tasks.core.stopped import Stopped
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.structured_log import about, ids_of

_log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class AtOnce:
    """Several calls of a task as one computation, where that is better than one after another.

    Attributes:
        count: for how many calls like this one; 1 where each is as well by itself.
        make: the results of several calls, in their order.
    """

    count: Callable[[tuple[Any, ...]], int]
    make: Callable[[Sequence[tuple[Any, ...]]], list[Any]]


class Step(Protocol[P, R]):
    """A task of this project.

    ``fn`` is the bare function, which needs no server. ``submit`` starts a run of several calls beside others (see
    tasks/workers/many.py), of which `count_at_once` are one computation.
    """

    fn: Callable[P, R]
    count_at_once: Callable[[tuple[Any, ...]], int]

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R: ...

    def submit(self, parcel: Parcel[R]) -> PrefectFuture[Any]: ...


def task(label: str, cached: bool = True, at_once: AtOnce | None = None) -> Callable[[Callable[P, R]], Step[P, R]]:
    """Make a function of handles and options a task.

    Args:
        label: what a person reads while it runs.
        at_once: how several calls are made as one; each result is the one that its call makes by itself.
        cached: False for a task that exists for its effect elsewhere, such as a record in MLflow.
    """

    def decorate(function: Callable[P, R]) -> Step[P, R]:
        @functools.wraps(function)
        def of_what_was_given(*args: P.args, **kwargs: P.kwargs) -> R:
            with unchanged(args, tuple(kwargs.values())):  # a result is kept under the digests of its inputs
                return function(*args, **kwargs)

        caching: dict[str, Any] = {"cache_key_fn": _cache_key} if cached else {"cache_policy": NO_CACHE}
        step: Any = prefect.task(persist_result=cached, result_serializer="json", **caching)(of_what_was_given)

        def several(parcel: Parcel[R]) -> State[Any] | None:
            ahead = _made_ahead(function, at_once, parcel.calls) if at_once else {}

            def make(call: tuple[Any, ...]) -> Kept[R]:
                if id(call) in ahead:
                    return _kept(function.__name__, function, call, ahead[id(call)])
                return _kept(function.__name__, of_what_was_given, call)

            all_reused = parcel.work(make)
            return Completed(name="Cached") if all_reused else None

        together: Any = prefect.task(
            name=function.__name__, task_run_name="{parcel}", cache_policy=NO_CACHE, result_serializer="json"
        )(several)

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            with progress.step(label) as shown:
                state = step(*args, **kwargs, return_state=True)
                result = state.result()
                shown.reused = state.name == "Cached"
                try:
                    verify(result)
                except StaleFile as stale:
                    _log.warning("%s: made again, since %s", label, stale)
                    shown.reused = False
                    result = step.with_options(refresh_cache=True)(*args, **kwargs)
                    verify(result)
                return cast(R, result)

        count_at_once = at_once.count if at_once else lambda _: 1
        offered = {"fn": function, "submit": together.submit, "count_at_once": count_at_once}
        for name, member in offered.items():
            setattr(call, name, member)
        return cast(Step[P, R], call)

    return decorate


def cache_key(name: str, parameters: dict[str, Any]) -> str:
    """Task name, and a hash of everything that can change its result; a repetition has keys of its own."""
    inputs = {key: digest(value) for key, value in sorted(parameters.items()) if not isinstance(value, Path)}
    return f"hfb-{name}-{digest([name, inputs, code_version(), repetition.salt()])[:40]}"


@functools.cache
def code_version() -> str:
    """The version, a hash of every source and data file of the method and the tasks, and the libraries that compute."""
    content = hashlib.sha256()
    root = Path(hfb.__file__).parent
    for folder in sorted({*root.iterdir()} - {root / "flows"}):
        base = folder.resolve()  # tasks is a link where hfb is installed from a checkout
        for path in sorted(base.rglob("*")) if base.is_dir() else [base]:
            if path.is_file() and "__pycache__" not in path.parts:
                content.update(f"{folder.name}/{path.relative_to(base)}".encode() + b"\0")
                content.update(hashlib.sha256(path.read_bytes()).digest())
    libraries = ",".join(f"{name}={version(name)}" for name in ("numpy", "numba", "torch"))
    return f"{hfb.__version__}+{content.hexdigest()[:16]};{libraries}"


def _cache_key(context: TaskRunContext, parameters: dict[str, Any]) -> str:
    return cache_key(context.task.name, parameters)


def _given(function: Callable[..., R], call: tuple[Any, ...]) -> dict[str, Any]:
    given = inspect.signature(function).bind(*call)
    given.apply_defaults()
    return given.arguments


def _made_ahead(function: Callable[..., R], at_once: AtOnce, calls: Sequence[tuple[Any, ...]]) -> dict[int, R]:
    """The results, by the call's id, of those calls that no earlier run has made; none where there are not several.

    One call that cannot be made takes none with it: each is then made by itself, and its error is its own.
    """
    records = get_result_store()
    fresh = [call for call in calls if not records.exists(cache_key(function.__name__, _given(function, call)))]
    if len(fresh) < 2 or at_once.count(fresh[0]) < 2:
        return {}
    try:
        with unchanged(fresh):
            return {id(call): result for call, result in zip(fresh, at_once.make(fresh), strict=True)}
    except Stopped:
        raise
    except Exception as error:
        _log.warning("%s: one by one, since together: %s", function.__name__, error)
        return {}


def _kept(name: str, function: Callable[..., R], call: tuple[Any, ...], ahead: R | None = None) -> Kept[R]:
    """One of several calls: its earlier result, or a new one, which is kept as Prefect keeps a run's.

    Args:
        ahead: the call's result, where it has been made already.
    """
    arguments = _given(function, call)
    key, records = cache_key(name, arguments), get_result_store()

    def made() -> R:
        result = function(*call) if ahead is None else ahead
        records.write(result, key=key)
        return result

    with about(ids_of(arguments)):
        reused = records.exists(key)
        result = cast(R, records.read(key).result) if reused else made()
        try:
            verify(result)
        except StaleFile as stale:
            _log.warning("%s: made again, since %s", name, stale)
            result, reused = made(), False
            verify(result)
    return Kept(result, reused)


def verify(result: object) -> None:
    """Raises StaleFile where a file that a result names is gone or no longer what it was."""
    for file in files_in(result):
        file.verify()
