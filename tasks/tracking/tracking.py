"""MLflow: one run per problem, identified by its inputs.

Only this module and `hfb.tasks.tracking.store_client` import mlflow.

The store is ``MLFLOW_TRACKING_URI`` when set, else a SQLite file in the user's data folder, with its artifacts beside
it. All calls use a client with an explicit run id: MLflow's fluent run belongs to one thread, and a task in another
thread would start a second run. Metric times are derived from the step, so that repeated logging changes nothing.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hfb.tasks.core import repetition
from hfb.tasks.core.environment import environment, source_commit
from hfb.tasks.core.handles import digest
from hfb.tasks.telemetry.secrets import hidden_in, shown_address, without_secrets
from hfb.tasks.tracking.ownership import is_abandoned, owner
from hfb.tasks.tracking.patience import within
from hfb.tasks.tracking.recipe import COMMAND_TAG
from hfb.tasks.tracking.store_client import StoreLost as StoreLost
from hfb.tasks.tracking.store_client import client, client_of, patience, store_losses, usable_store
from hfb.tasks.tracking.store_place import LOCAL_PAGES, on_server, sqlite_file, tracking_uri

if TYPE_CHECKING:
    from mlflow import MlflowClient

_log = logging.getLogger(__name__)
EXPERIMENT = "hfb"
_SYSTEM = "MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING"
_KEY_TAG = "hfb.key"
RERUN_TAG = "hfb.rerun_of"
_OWNER_TAG = "hfb.owner"
_METRICS_PER_BATCH = 1000
_PARAMS_PER_BATCH = 100
_VALUE_LENGTH = 6000
_MONITOR_ENDS_S = 5.0
_DIGEST_LENGTH = 36  # of MLflow's column


@dataclass(frozen=True)
class Run:
    """An open run."""

    uri: str
    experiment_id: str
    run_id: str
    first_millisecond: int
    complete: bool


@contextmanager
def record_run(
    name: str,
    key: str,
    params: Mapping[str, Any],
    tags: Mapping[str, str],
    *,
    parent: Run | None = None,
    began_ms: int | None = None,
    ended_ms: int | None = None,
) -> Iterator[Run]:
    """Find or create the run of a problem; FINISHED, FAILED or KILLED when the block ends.

    A run that is found FINISHED is complete: it holds everything already, and stays as it is.

    Args:
        name: of the run.
        key: a hash of everything in ``params``, which MLflow does not let change: the same key is the same run.
        params: inputs and options.
        tags: besides versions and machine.
        parent: the run under which this one is shown.
        began_ms: when the work began, in milliseconds since 1970; None for now.
        ended_ms: when it ended; None for the end of the block.

    Raises:
        StoreLost: the store cannot be reached or written.
    """
    if parent is not None:
        tags = {**tags, "mlflow.parentRunId": parent.run_id}
    with store_losses():
        client = client_of(tracking_uri())
        run = _find_or_create(client, name, key, params=params, tags=tags, began_ms=began_ms)
        status = "KILLED"  # by Ctrl-C, SIGTERM or Prefect's own signal, none of which is an Exception
        try:
            yield run
            status = "FINISHED"
        except Exception:
            status = "FAILED"
            raise
        finally:
            if not run.complete:
                client.set_terminated(run.run_id, status, ended_ms)


def begin_run(name: str, key: str, params: Mapping[str, Any], tags: Mapping[str, str]) -> Run:
    """Find or create the run of a long problem, which is recorded while it computes; `end_run` ends it.

    Args:
        name: of the run.
        key: as of `record_run`.
        params: inputs and options.
        tags: besides versions and machine.

    Raises:
        StoreLost: the store cannot be reached or written.
    """
    with store_losses():
        return _find_or_create(client_of(tracking_uri()), name, key, params=params, tags=tags)


def end_run(run: Run, status: str) -> None:
    """Set FINISHED, FAILED or KILLED; a run that was found complete stays as it is. Raises StoreLost.

    Args:
        run: the run.
        status: one of these.
    """
    if not run.complete:
        with store_losses():
            client_of(run.uri).set_terminated(run.run_id, status)


def open_run(run_id: str) -> Run:
    """Open an existing run to add to it. Raises StoreLost.

    Args:
        run_id: of the run.
    """
    with store_losses():
        info = client().get_run(run_id).info
    return Run(tracking_uri(), info.experiment_id, run_id, info.start_time, info.status == "FINISHED")


def watch_machine(run: Run) -> Callable[[], None]:
    """Record MLflow's system metrics (processor, memory, network, GPU), ``system/...``, until the result is called.

    They are a dozen points every ten seconds, recorded only where MLflow's own variable requests them.

    Args:
        run: the run.
    """
    if run.complete or os.environ.get(_SYSTEM, "").lower() not in ("1", "true"):
        return lambda: None
    from mlflow.system_metrics.system_metrics_monitor import SystemMetricsMonitor

    try:
        monitor = SystemMetricsMonitor(run.run_id, resume_logging=True, tracking_uri=run.uri)
    except Exception as error:  # psutil is not there, or the store has gone: a run does not end for want of them
        _log.warning("no system metrics: %s", without_secrets(str(error)))
        return lambda: None
    monitor.start()

    def end() -> None:
        with suppress(TimeoutError):  # its thread may wait for a store that hangs
            within(_MONITOR_ENDS_S, monitor.finish)

    return end


def open_store() -> None:
    """Load MLflow, check that the store takes records, and make its tables, all before any work begins.

    Runs that a killed process left RUNNING are ended.

    Raises:
        InputError: see `hfb.tasks.tracking.store_client.usable_store`.
    """
    uri = tracking_uri()
    patience(uri).another_try()  # it may be back
    with usable_store(uri):
        _experiment(client_of(uri))
    with suppress(Exception):  # tidying up after others must not stop this run
        end_abandoned_runs()


def end_abandoned_runs() -> int:
    """Set KILLED for every RUNNING run whose process on this machine is gone; returns their number."""
    client, ended, page = client_of(tracking_uri()), 0, None
    experiment_id = _experiment(client)
    while True:
        found = client.search_runs([experiment_id], "attributes.status = 'RUNNING'", page_token=page)
        for run in found:
            if is_abandoned(run.data.tags.get(_OWNER_TAG, "")):
                client.set_terminated(run.info.run_id, "KILLED")
                ended += 1
        page = found.token
        if not page:
            return ended


def read_logged_steps(run: Run, metric: str) -> set[int]:
    """Return the steps at which a run already has a point of a metric. Raises StoreLost.

    Args:
        run: the run.
        metric: its name.
    """
    with store_losses():
        return {point.step for point in client_of(run.uri).get_metric_history(run.run_id, metric)}


def log_histories(run: Run, histories: Mapping[str, Sequence[float | None]]) -> None:
    """Log metrics with one value per step, None for a step without; repeated logging leaves one point per step.

    Args:
        run: the run.
        histories: values by metric.
    """
    log_points(
        run, {name: {k: float(v) for k, v in enumerate(values) if v is not None} for name, values in histories.items()}
    )


def log_points(run: Run, points: Mapping[str, Mapping[int, float]]) -> None:
    """Log metrics as step -> value; repeated logging leaves one point per step. Raises StoreLost.

    Args:
        run: the run.
        points: metric -> step -> value.
    """
    from mlflow.entities import Metric

    metrics = [
        Metric(name, value, run.first_millisecond + step, step)
        for name, values in points.items()
        for step, value in values.items()
    ]
    with store_losses():
        for start in range(0, len(metrics), _METRICS_PER_BATCH):
            batch = metrics[start : start + _METRICS_PER_BATCH]
            client_of(run.uri).log_batch(run.run_id, metrics=batch, synchronous=True)


def log_files(run: Run, files: Sequence[Path], folder: str | None = None) -> None:
    """Log files as artifacts.

    Args:
        run: the run.
        files: the files.
        folder: of the run; None for its top.
    """
    client = client_of(run.uri)
    for path in files:
        client.log_artifact(run.run_id, str(path), artifact_path=folder)


def log_inputs(run: Run, sha256: Mapping[str, str]) -> None:
    """Log the inputs as MLflow's datasets, so that runs on the same files are found by them.

    Args:
        run: the run.
        sha256: of the files, by their role.
    """
    from mlflow.entities import Dataset, DatasetInput, InputTag

    tags = [InputTag("mlflow.data.context", "input")]
    inputs = [
        DatasetInput(Dataset(role, one[:_DIGEST_LENGTH], "sha256", json.dumps({"sha256": one})), tags)
        for role, one in sha256.items()
    ]
    client_of(run.uri).log_inputs(run.run_id, inputs)


def describe(run: Run, text: str) -> None:
    """Set the description that MLflow shows at the top of a run's page.

    Args:
        run: the run.
        text: Markdown.
    """
    client_of(run.uri).set_tag(run.run_id, "mlflow.note.content", without_secrets(text))


def log_dict(run: Run, content: Mapping[str, Any], name: str) -> None:
    """Log plain values as an artifact; secrets in it are hidden.

    Args:
        run: the run.
        content: plain values.
        name: of the artifact.
    """
    client_of(run.uri).log_dict(run.run_id, hidden_in(dict(content)), name)


def link(run: Run) -> str:
    """Return the page of a run; a local store has pages while `hfb runs` is up.

    ``HFB_MLFLOW_PAGES`` is the public address of a server that workers reach under another one.

    Args:
        run: the run.
    """
    base = os.environ.get("HFB_MLFLOW_PAGES") or (run.uri if on_server(run.uri) else LOCAL_PAGES)
    base = shown_address(base).rstrip("/")
    return f"{base}/#/experiments/{run.experiment_id}/runs/{run.run_id}?workflowType=machine_learning"


def _experiment(client: MlflowClient) -> str:
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(EXPERIMENT)
    if found is not None:
        return str(found.experiment_id)
    # A local database would put artifacts into the current folder.
    file = sqlite_file(str(client.tracking_uri))
    artifacts = file.parent / "mlflow-artifacts" if file else None
    try:
        return str(client.create_experiment(EXPERIMENT, artifact_location=artifacts.as_uri() if artifacts else None))
    except MlflowException:  # another process was faster
        found = client.get_experiment_by_name(EXPERIMENT)
        if found is None:
            raise
        return str(found.experiment_id)


def _find_or_create(
    client: MlflowClient,
    name: str,
    key: str,
    *,
    params: Mapping[str, Any],
    tags: Mapping[str, str],
    began_ms: int | None = None,
) -> Run:
    patience(str(client.tracking_uri)).another_try()
    experiment_id = _experiment(client)
    key, tags = _of_repetition(key, tags)
    found = client.search_runs([experiment_id], f"tags.`{_KEY_TAG}` = '{key}'", max_results=1)
    complete = bool(found) and found[0].info.status == "FINISHED"
    if found:
        info = found[0].info
    else:
        info = client.create_run(
            experiment_id,
            began_ms,
            run_name=name,
            tags={**hidden_in({**environment(), **_source(tags), **tags}), _KEY_TAG: key, _OWNER_TAG: owner()},
        ).info
    if not complete:
        client.set_tag(info.run_id, _OWNER_TAG, owner())
        client.update_run(info.run_id, status="RUNNING")
        _log_params(client, info.run_id, params)
    return Run(str(client.tracking_uri), experiment_id, info.run_id, info.start_time, complete)


def add_record_context(key: str, tags: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """Return key and tags with which a run recorded later is the same as one recorded now.

    Args:
        key: of the run.
        tags: of the run.
    """
    key, tags = _of_repetition(key, tags)
    return key, {**environment(), **_source(tags), **tags}


def _source(tags: Mapping[str, str]) -> dict[str, str]:
    """Return MLflow's own tags on what made a run: the command, and the commit of a checkout."""
    commit = source_commit()
    source = {"mlflow.source.type": "LOCAL", "mlflow.source.name": f"hfb {tags.get(COMMAND_TAG, '')}".strip()}
    return source | ({"mlflow.source.git.commit": commit} if commit else {})


def _of_repetition(key: str, tags: Mapping[str, str]) -> tuple[str, Mapping[str, str]]:
    """Return key and tags of a repetition, which has its own run and never finds the one that it repeats."""
    repeated = repetition.current()
    if repeated is None:
        return key, tags
    return digest([key, repetition.salt()]), {RERUN_TAG: repeated.of, "mlflow.parentRunId": repeated.of, **tags}


def _log_params(client: MlflowClient, run_id: str, params: Mapping[str, Any]) -> None:
    from mlflow.entities import Param

    flat = [Param(name, value[:_VALUE_LENGTH]) for name, value in flatten(params).items()]
    for start in range(0, len(flat), _PARAMS_PER_BATCH):
        client.log_batch(run_id, params=flat[start : start + _PARAMS_PER_BATCH])


def flatten(content: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return nested options with dotted names; lists as JSON.

    Args:
        content: nested options.
        prefix: of all names.
    """
    flat: dict[str, str] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = without_secrets(value if isinstance(value, str) else json.dumps(value, default=str))
    return flat
