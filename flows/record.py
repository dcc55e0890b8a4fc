"""Record results that MLflow did not take when they were made; the results then name their runs."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from hfb.errors import InputError, TemporaryError
from hfb.interop.writers.export_names import RECORD, RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.footage_names import natural_order
from hfb.tasks.results.stored_runs import find_run, result_facts
from hfb.tasks.results.workspace import workspace
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking.run_record import RunHandle, copy_recorded_files, read_kept, write_run
from hfb.tasks.tracking.tracking import StoreLost


def record_folder(folder: Path) -> dict[str, Any]:
    """Record the result in a folder, or every person's of a clip of several people. Repetition changes nothing.

    Args:
        folder: of the result.

    Returns:
        ``runs``: of each ``out``, ``mlflow_run_id``, ``mlflow_link``, and whether it is ``new``.

    Raises:
        InputError: there is no finished result, it was changed, or the store does not take it.
    """
    facts = result_facts(folder)
    if "people" not in facts:
        return {"runs": [_record(folder, facts)]}
    people = [one for one in natural_order(folder.glob("person-*")) if (one / RESULT).is_file()]
    runs = [_record(one, result_facts(one)) for one in people]
    if not runs:
        raise InputError(f"{folder} has no result of anybody: give the folder of a finished result")
    ids = {Path(one["out"]).name: one["mlflow_run_id"] for one in runs}
    told = [
        {**one, "mlflow_run_id": ids.get(Path(str(one.get("out"))).name, one.get("mlflow_run_id"))}
        for one in facts["people"]
        if isinstance(one, dict)
    ]
    with workspace(folder):
        _rewrite(folder, facts | {"people": told})
    return {"runs": runs}


def _record(folder: Path, facts: dict[str, Any]) -> dict[str, Any]:
    out = str(folder.resolve())
    if not (folder / RECORD).exists():
        if facts.get("mlflow_run_id") is None:
            raise InputError(f"{folder} has no {RECORD} to be recorded from: run its own command again")
        run = find_run(str(folder))
        return {"out": out, "mlflow_run_id": run.run_id, "mlflow_link": run.link, "new": False}
    with workspace(folder), tempfile.TemporaryDirectory() as private:
        record = read_kept(folder)
        paths = copy_recorded_files(record, folder, Path(private))
        with progress.step("record in MLflow"):
            try:
                run_handle = write_run(record, paths)
            except StoreLost as lost:
                raise TemporaryError(
                    f"{folder} is not recorded, MLflow does not take it ({lost}): try again later"
                ) from lost
        _name_run(folder, facts, run_handle)
    return {"out": out, "mlflow_run_id": run_handle.run_id, "mlflow_link": run_handle.link, "new": True}


def _name_run(folder: Path, facts: dict[str, Any], run: RunHandle) -> None:
    """Write the run's id into the result, and remove the waiting record."""
    files = [name for name in facts.get("files") or () if name != RECORD]
    _rewrite(folder, facts | {"mlflow_run_id": run.run_id, "mlflow_link": run.link, "files": files})
    (folder / RECORD).unlink()


def _rewrite(folder: Path, facts: dict[str, Any]) -> None:
    write_bytes_atomic(folder / RESULT, json.dumps(facts, indent=2).encode() + b"\n")
