"""Places that the parameters of a deployment may name: users of its form are no users of the worker's machine.

Files lie below HFB_DATA [/data] of the worker. HFB_ALLOWED, a list separated by commas, adds what an administrator
allows besides: folders or files, and addresses such as dask:tcp://host:8786 or s3://bucket/prefix. Networks and chains
are programs, and members may put files below HFB_DATA: both must lie in HFB_ALLOWED.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from prefect.context import FlowRunContext

from hfb.config import RunConfig
from hfb.errors import InputError

_ADDRESS = re.compile(r"\w+:.*")
_CLUSTERS = ("dask:", "ray:")
_BELOW = re.compile(r"(/(?!\.)[\w.=-]+)*/?")  # of a store's address: names, none of which begins with a dot


def is_limited() -> bool:
    """Return whether this is a run of a deployment; a flow called in Python has its caller's rights."""
    context = FlowRunContext.get()
    return context is not None and context.flow_run is not None and context.flow_run.deployment_id is not None


def check_files(name: str, paths: Path | str | Sequence[Path | str] | None) -> None:
    """Refuse files outside HFB_DATA and HFB_ALLOWED; links are followed.

    Args:
        name: of the parameter.
        paths: its value; None is allowed.

    Raises:
        InputError: the sentence names the path, and what an administrator can do.
    """
    for path in _listed(paths):
        if not _is_within(path, [_data(), *_allowed_paths()]):
            raise InputError(
                f"{name}: {path} lies outside {_data()}: put it there, or have an administrator add its folder to "
                "HFB_ALLOWED of the workers"
            )


def check_programs(name: str, paths: Path | Sequence[Path] | None) -> None:
    """Refuse networks and chains that are not in HFB_ALLOWED; links are followed.

    Args:
        name: of the parameter.
        paths: its value; None is allowed.

    Raises:
        InputError: the sentence names the path, and what an administrator can do.
    """
    for path in _listed(paths):
        if not _is_within(path, _allowed_paths()):
            raise InputError(
                f"{name}: {path} is a program, which the parameters of a run may not choose: have an administrator add "
                "it to HFB_ALLOWED of the workers"
            )


def check_addresses(workers: int | str, store: str | None) -> None:
    """Refuse clusters and stores that are not in HFB_ALLOWED.

    Args:
        workers: number of processes, or a cluster's address.
        store: a URL; None is allowed.

    Raises:
        InputError: the sentence names the address, and what an administrator can do.
    """
    cluster = workers if isinstance(workers, str) and workers.strip().startswith(_CLUSTERS) else None
    allowed = [one for one in _allowed() if _ADDRESS.fullmatch(one)]
    for name, address in (("workers", cluster), ("store", store)):
        if address is None or address in allowed:
            continue
        above = [one.rstrip("/") for one in allowed if address.startswith(one.rstrip("/")) and "://" in one]
        if name == "workers" or not any(_BELOW.fullmatch(address[len(one) :]) for one in above):
            raise InputError(
                f"{name}: {address} is an address, which the parameters of a run may not choose: have an "
                "administrator add it to HFB_ALLOWED of the workers"
            )


def check_config(config: RunConfig, name: str = "options") -> None:
    """Refuse options that name files, networks or body models outside the allowed places.

    Args:
        config: all options.
        name: of the parameter.

    Raises:
        InputError: as of the checks above.
    """
    check_files(f"{name}.body.model", config.body.model)
    check_files(f"{name}.init.file", config.init.file)
    check_files(f"{name}.prior.pose", config.prior.pose)
    check_files(f"{name}.prior.motion", config.prior.motion)
    check_programs(f"{name}.matting.weights", config.matting.weights)
    check_programs(f"{name}.init.weights", config.init.weights)
    check_programs(f"{name}.init.mesh_sampling", config.init.mesh_sampling)


def _listed(paths: Path | str | Sequence[Path | str] | None) -> list[Path]:
    if paths is None:
        return []
    return [Path(paths)] if isinstance(paths, Path | str) else [Path(one) for one in paths]


def _data() -> Path:
    return Path(os.environ.get("HFB_DATA") or "/data")


def _allowed() -> list[str]:
    return [one.strip() for one in os.environ.get("HFB_ALLOWED", "").split(",") if one.strip()]


def _allowed_paths() -> list[Path]:
    return [Path(one) for one in _allowed() if not _ADDRESS.fullmatch(one)]


def _is_within(path: Path, places: Iterable[Path]) -> bool:
    real = path.resolve()
    return any(real == place.resolve() or place.resolve() in real.parents for place in places)
