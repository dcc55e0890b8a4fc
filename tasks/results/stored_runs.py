"""Read recorded runs back from MLflow."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from hfb.errors import InputError
from hfb.interop.writers.export_names import RECORD, RESULT
from hfb.io.json_file import read_json
from hfb.io.media.footage_names import natural_order
from hfb.io.safe_folder import special_kind
from hfb.tasks.core.result_folder import check_result
from hfb.tasks.telemetry.secrets import without_secrets
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.store_place import tracking_uri

_SHORTEST_PREFIX, _ID_LENGTH = 4, 32
_PAGE = 1000
_FILE_LIMIT_BYTES = 1 << 30
_NAMED_DIFFERENTLY = "; `hfb runs` shows all of them, and a result's folder will do in its place"


@dataclass(frozen=True)
class StoredRun:
    """A run as the store has it.

    Attributes:
        started: UTC, to the second.
        params: text by name.
        tags: text by name.
        metrics: the last value by name.
    """

    run_id: str
    name: str
    status: str
    started: str
    params: Mapping[str, str]
    metrics: Mapping[str, float]
    tags: Mapping[str, str]
    link: str

    @property
    def title(self) -> str:
        """Title that distinguishes the run from others."""
        return f"{self.name} ({self.run_id[:8]})"


def find_run(words: str) -> StoredRun:
    """Find a run by its id, the beginning of its id, or the folder of its result.

    Args:
        words: one of these.

    Raises:
        InputError: there is none, or more than one, or the store cannot be read.
    """
    with readable_store(), tracking.store_losses():
        return _to_stored_run(_find(_id_in(Path(words)) if Path(words).is_dir() else words))


@contextmanager
def readable_store() -> Iterator[None]:
    """Turn a lost store inside the block into a sentence for the user, for commands that need it."""
    try:
        yield
    except tracking.StoreLost as lost:
        place = without_secrets(tracking_uri())
        raise InputError(
            f"the runs in {place} cannot be read ({lost}): set MLFLOW_TRACKING_URI to where they are"
        ) from lost


def fetch_file(run: StoredRun, name: str, folder: Path) -> Path | None:
    """Download a file of a run into a folder; None where the run has no such file.

    Args:
        run: the run.
        name: of the artifact.
        folder: where the file goes.

    Raises:
        tracking.StoreLost: the store cannot be read.
        InputError: the file is far larger than any that hfb records.
    """
    place = PurePosixPath(name)
    client = tracking.client()
    with tracking.store_losses():
        listed = client.list_artifacts(run.run_id, str(place.parent) if place.parent.name else None)
        found = next((one for one in listed if one.path == name and not one.is_dir), None)
        if found is None:
            return None
        size = found.file_size or 0
        if size > _FILE_LIMIT_BYTES:
            raise InputError(f"{name} of run {run.run_id} has {size >> 20} MiB; that is no file of hfb")
        folder.mkdir(parents=True, exist_ok=True)
        return Path(client.download_artifacts(run.run_id, name, str(folder)))


def _find(words: str) -> Any:
    text = words.strip().lower()
    if not re.fullmatch(f"[0-9a-f]{{{_SHORTEST_PREFIX},{_ID_LENGTH}}}", text):
        raise InputError(f"{words!r} is neither the id of a run nor a result's folder{_NAMED_DIFFERENTLY}")
    whole = f"attributes.run_id = '{text}'" if len(text) == _ID_LENGTH else ""
    found = [run for run in _every_run(whole) if run.info.run_id.startswith(text)]
    if len(found) > 1:
        several = ", ".join(sorted(run.info.run_id for run in found)[:4])
        raise InputError(f"{len(found)} runs begin with {words} ({several} ...): give more of the id")
    if not found:
        raise InputError(f"there is no run {words} in {without_secrets(tracking_uri())}{_NAMED_DIFFERENTLY}")
    return found[0]


def _every_run(condition: str) -> Iterator[Any]:
    client, page = tracking.client(), None
    experiment = client.get_experiment_by_name(tracking.EXPERIMENT)
    while experiment is not None:
        runs = client.search_runs([experiment.experiment_id], condition, max_results=_PAGE, page_token=page)
        yield from runs
        page = runs.token
        if not page:
            return


def _id_in(folder: Path) -> str:
    """Return the run's id of a result's folder."""
    told = result_facts(folder)
    found = told.get("mlflow_run_id")
    if isinstance(found, str):
        return found
    if "people" in told and (theirs := _recorded_in(folder)):
        raise InputError(f"{folder} holds a run for each person: give {' or '.join(map(str, theirs))}")
    mend = f"`hfb record {folder}` records it" if (folder / RECORD).is_file() else "run its own command again"
    raise InputError(f"{folder / RESULT} names no run, since it was not recorded in MLflow: {mend}")


def _recorded_in(folder: Path) -> list[Path]:
    """Return the folders of people whose runs were recorded; others may have no motion."""
    found = []
    for one in natural_order(folder.glob("person-*")):
        if special_kind(one) is not None:
            continue
        with suppress(InputError):
            if isinstance(result_facts(one).get("mlflow_run_id"), str):
                found.append(one)
    return found


def result_facts(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's result.json; empty where it is not a result's.

    Args:
        folder: of the result.
    """
    path = folder / RESULT
    check_result(folder, ())
    if not path.exists():
        raise InputError(f"{folder} has no {RESULT}: give the folder of a finished result, or a run's id")
    content = read_json(path, "give the run's id")
    return content if isinstance(content, dict) else {}


def _to_stored_run(run: Any) -> StoredRun:
    info, data = run.info, run.data
    began = datetime.fromtimestamp(info.start_time / 1000, UTC)
    return StoredRun(
        run_id=info.run_id,
        name=info.run_name or info.run_id[:8],
        status=info.status,
        started=began.strftime("%Y-%m-%d %H:%M:%S"),
        params=dict(sorted(data.params.items())),
        metrics=dict(sorted(data.metrics.items())),
        tags=dict(sorted(data.tags.items())),
        link=tracking.link(tracking.Run(tracking_uri(), info.experiment_id, info.run_id, info.start_time, True)),
    )
