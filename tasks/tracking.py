"""MLflow: one run per problem, found again by what went in. The only module that imports mlflow.

Where: ``MLFLOW_TRACKING_URI`` when set, else a SQLite file in the user's own data folder, with its artifacts
beside it. Everything goes through a client with an explicit run id: MLflow's fluent run belongs to one thread,
and a task in another would start a stray one. Metric times are derived from the step, so that logging the same
values again changes nothing.
"""

from __future__ import annotations

import functools
import json
import os
import platform
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import urlopen

import platformdirs

from hfb import __version__
from hfb.errors import InputError

if TYPE_CHECKING:
    from mlflow import MlflowClient

EXPERIMENT = "hfb"
LOCAL_PORT = 5000
LOCAL_PAGES = f"http://127.0.0.1:{LOCAL_PORT}"
_KEY_TAG = "hfb.key"
_METRICS_PER_BATCH = 1000
_PARAMS_PER_BATCH = 100
_VALUE_LENGTH = 6000
_HEALTH_TIMEOUT_S = 3
# What a server of pages for one person needs not do; it takes 3 GB of memory otherwise.
SMALL_SERVER = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
# A server that goes away must cost seconds, not MLflow's default of four minutes.
_HTTP_LIMITS = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2", "MLFLOW_HTTP_REQUEST_TIMEOUT": "15"}


@dataclass(frozen=True)
class Run:
    """A run that is being recorded."""

    uri: str
    experiment_id: str
    run_id: str
    first_millisecond: int
    complete: bool


def tracking_uri() -> str:
    """Where runs are recorded."""
    return os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{_home() / 'mlflow.db'}"


def check_store(uri: str) -> None:
    """Ask a tracking server whether it is there, before MLflow waits minutes for it.

    Raises:
        InputError: the store does not answer, or MLflow no longer takes its kind.
    """
    scheme = urlsplit(uri).scheme
    if scheme in ("", "file"):
        raise InputError(f"MLflow no longer keeps runs in plain folders: set MLFLOW_TRACKING_URI to sqlite:///{uri}.db")
    if not on_server(uri):
        return
    try:
        with urlopen(f"{uri.rstrip('/')}/health", timeout=_HEALTH_TIMEOUT_S):
            return
    except HTTPError as error:
        if error.code in (401, 403):  # a server that asks for a login is there
            return
        reason = f"answers {error.code}"
    except (URLError, OSError) as error:
        reason = f"does not answer ({getattr(error, 'reason', error)})"
    raise InputError(f"the MLflow server at {uri} {reason}: start it, or unset MLFLOW_TRACKING_URI to record locally")


class StoreLost(Exception):
    """The tracking store could not be reached or written."""


@contextmanager
def recorded_run(
    name: str, key: str, params: Mapping[str, Any], tags: Mapping[str, str], parent: Run | None = None
) -> Iterator[Run]:
    """Find or create the run of a problem; FINISHED, FAILED or KILLED when the block ends.

    A run that is found FINISHED is complete: it holds everything already, and stays as it is.

    Args:
        key: a hash of everything in ``params``, which MLflow does not let change: the same key is the same run.
        parent: the run under which this one is shown.

    Raises:
        StoreLost: the store cannot be reached or written.
    """
    if parent is not None:
        tags = {**tags, "mlflow.parentRunId": parent.run_id}
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    try:
        client = _client(tracking_uri())
        run = _found_or_created(client, name, key, params, tags)
        status = "FAILED"
        try:
            yield run
            status = "FINISHED"
        except (KeyboardInterrupt, SystemExit):
            status = "KILLED"
            raise
        finally:
            if not run.complete:
                client.set_terminated(run.run_id, status)
    except (MlflowException, SQLAlchemyError, OSError) as error:  # requests' errors are OSErrors
        reason = str(error).strip().splitlines()
        raise StoreLost(reason[0] if reason else type(error).__name__) from error


def open_store() -> None:
    """Load MLflow and make its tables now, so that a later record does not wait for them.

    A store that fails here fails again, and is reported, when something is recorded.
    """
    with suppress(Exception):
        _experiment(_client(tracking_uri()))


def log_histories(run: Run, histories: Mapping[str, Sequence[float | None]]) -> None:
    """Metrics with one value per step, None for a step without; logging the same again leaves one point per step."""
    from mlflow.entities import Metric

    metrics = [
        Metric(name, float(value), run.first_millisecond + step, step)
        for name, values in histories.items()
        for step, value in enumerate(values)
        if value is not None
    ]
    client = _client(run.uri)
    for start in range(0, len(metrics), _METRICS_PER_BATCH):
        client.log_batch(run.run_id, metrics=metrics[start : start + _METRICS_PER_BATCH], synchronous=True)


def log_files(run: Run, files: Sequence[Path], folder: str | None = None) -> None:
    """Files as artifacts, in a folder of the run."""
    client = _client(run.uri)
    for path in files:
        client.log_artifact(run.run_id, str(path), artifact_path=folder)


def log_dict(run: Run, content: Mapping[str, Any], name: str) -> None:
    """An artifact made of plain values."""
    _client(run.uri).log_dict(run.run_id, dict(content), name)


def link(run: Run) -> str:
    """The page of a run; a local store has pages while `hfb runs` is up."""
    base = run.uri.rstrip("/") if on_server(run.uri) else LOCAL_PAGES
    return f"{base}/#/experiments/{run.experiment_id}/runs/{run.run_id}?workflowType=machine_learning"


def on_server(uri: str) -> bool:
    """Whether runs go to a server, which has pages of its own."""
    return urlsplit(uri).scheme in ("http", "https")


def pages_command(port: int = LOCAL_PORT) -> list[str]:
    """The command that shows a local store's runs in a browser; it stays small in the environment SMALL_SERVER.

    Raises:
        InputError: runs go to a server.
    """
    uri = tracking_uri()
    if on_server(uri):
        raise InputError(f"runs are recorded on a server that has pages of its own: open {uri}")
    _make_folder(uri)
    return [
        sys.executable, "-m", "mlflow", "server", "--backend-store-uri", uri, "--host", "127.0.0.1",
        "--port", str(port), "--workers", "1", "--uvicorn-opts", "--log-level warning",
    ]  # fmt: skip


def _home() -> Path:
    return platformdirs.user_data_path("hfb")


@functools.cache
def _client(uri: str) -> MlflowClient:
    for name, value in _HTTP_LIMITS.items():
        os.environ.setdefault(name, value)
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    from mlflow import MlflowClient

    _make_folder(uri)
    return MlflowClient(uri)


def _make_folder(uri: str) -> None:
    if uri.startswith("sqlite:///"):
        Path(uri.removeprefix("sqlite:///")).parent.mkdir(parents=True, exist_ok=True)


def _experiment(client: MlflowClient) -> str:
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(EXPERIMENT)
    if found is not None:
        return str(found.experiment_id)
    uri = str(client.tracking_uri)
    # A local database would put artifacts into the current folder.
    artifacts = Path(uri.removeprefix("sqlite:///")).parent / "mlflow-artifacts" if uri.startswith("sqlite") else None
    try:
        return str(client.create_experiment(EXPERIMENT, artifact_location=artifacts.as_uri() if artifacts else None))
    except MlflowException:  # another process was faster
        found = client.get_experiment_by_name(EXPERIMENT)
        if found is None:
            raise
        return str(found.experiment_id)


def _found_or_created(
    client: MlflowClient, name: str, key: str, params: Mapping[str, Any], tags: Mapping[str, str]
) -> Run:
    experiment_id = _experiment(client)
    found = client.search_runs([experiment_id], f"tags.`{_KEY_TAG}` = '{key}'", max_results=1)
    complete = bool(found) and found[0].info.status == "FINISHED"
    if found:
        info = found[0].info
    else:
        info = client.create_run(experiment_id, run_name=name, tags={**tags, **_environment_tags(), _KEY_TAG: key}).info
    if not complete:
        client.update_run(info.run_id, status="RUNNING")
        _log_params(client, info.run_id, params)
    return Run(str(client.tracking_uri), experiment_id, info.run_id, info.start_time, complete)


def _log_params(client: MlflowClient, run_id: str, params: Mapping[str, Any]) -> None:
    from mlflow.entities import Param

    flat = [Param(name, value[:_VALUE_LENGTH]) for name, value in flatten(params).items()]
    for start in range(0, len(flat), _PARAMS_PER_BATCH):
        client.log_batch(run_id, params=flat[start : start + _PARAMS_PER_BATCH])


def flatten(content: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested options as dotted names; lists as JSON."""
    flat: dict[str, str] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value if isinstance(value, str) else json.dumps(value, default=str)
    return flat


def _environment_tags() -> dict[str, str]:
    libraries = ("torch", "numpy", "numba", "opencv-python-headless", "prefect", "mlflow")
    tags = {"version.hfb": __version__} | {f"version.{name}": version(name) for name in libraries}
    return tags | {"version.python": platform.python_version(), "platform": platform.platform(), "device": "cpu"}
