"""Where computations run: processes or threads of this machine, or an existing Dask or Ray cluster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, ParamSpec, TypeVar, cast, get_args

from hfb.errors import InputError

Kind = Literal["processes", "threads", "dask", "ray"]
_CLUSTERS = ("dask", "ray")
P = ParamSpec("P")
R = TypeVar("R")


class WorkerLost(Exception):
    """A worker died repeatedly, or can no longer be reached."""


class Stopped(Exception):
    """The workers were stopped; the result of this computation is no longer needed."""


@dataclass(frozen=True)
class Engine:
    """The option `--workers`; it changes no digit of a result.

    Attributes:
        count: processes or threads of this machine. With a cluster, this machine has one for work that must stay here.
        address: of the cluster.
        store: a URL of files for workers that do not share this machine's disk; see tasks/workers/shared_store.py.
    """

    kind: Kind = "processes"
    count: int = 1
    address: str = ""
    store: str | None = None

    @property
    def remote(self) -> bool:
        """Whether other machines compute."""
        return self.kind in _CLUSTERS


def engine_of(words: str | int, store: str | None = None) -> Engine:
    """Parse the options: ``4``, ``threads:4``, ``dask:tcp://host:8786`` or ``ray:auto``; and the shared store.

    Args:
        words: of `--workers`.
        store: of `--store`.

    Raises:
        InputError: it is none of these, or a store is given without a cluster.
    """
    kind, _, rest = str(words).partition(":")
    if kind.isdecimal() and not rest:
        kind, rest = "processes", kind
    if kind not in get_args(Kind) or not rest:
        raise InputError(
            f"--workers {words}: give a number of processes, threads:NUMBER, dask:ADDRESS (such as "
            "dask:tcp://host:8786) or ray:ADDRESS (such as ray:auto)"
        )
    if kind in _CLUSTERS:
        return Engine(cast(Kind, kind), 1, rest, store)
    if store is not None:
        raise InputError(f"--store is for workers elsewhere: leave it out with --workers {words}")
    if not rest.isdecimal() or int(rest) < 1:
        raise InputError(f"--workers {words}: give 1 or more")
    return Engine(cast(Kind, kind), int(rest))


def bare(function: Callable[P, R]) -> Callable[P, R]:
    """Return the bare function of a task, which is sent by its name; any other function as it is.

    Args:
        function: a function, or a task.
    """
    found: Callable[P, R] = getattr(function, "fn", function)
    return found
