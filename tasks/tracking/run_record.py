"""The MLflow record of a finished run as plain content: recorded at once, or later from the result's folder."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from hfb.config import Record, RunConfig
from hfb.errors import InputError
from hfb.interop.writers.export_names import RECORD, RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.safe_folder import NotOrdinary, copy_file, read_file
from hfb.io.toml_file import to_record
from hfb.tasks.core.handles import FileHandle, sha256_of
from hfb.tasks.telemetry.secrets import hidden_in
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.recipe import RECIPE

_DESCRIBED = (
    ("frames", "frames", "d"),
    ("matte_iou", "IoU with the matte", ".3f"),
    ("psnr_db", "PSNR of the re-blurred images [dB]", ".1f"),
    ("mpjpe_mm", "MPJPE [mm]", ".1f"),
)
_LIMIT_BYTES = 64 << 20
_CONTENTS = (RESULT, "config.json", RECIPE)
_FILE = re.compile(r"[\w-][\w.-]*")
_TAGS = re.compile(
    r"hfb\.\w+|version\.[\w.-]+|code|seed|preset|platform|processor|device|mlflow\.parentRunId|mlflow\.source\.[a-z.]+"
)


_Milliseconds = Annotated[int, Field(ge=0, le=1 << 52)]


class RunHandle(Record):
    """A recorded run."""

    run_id: str
    link: str


class RecordedFile(Record):
    """A published file that becomes an artifact, in a folder of the run."""

    sha256: str
    folder: str | None = None


class RunRecord(Record):
    """Content of a run.

    Attributes:
        key: decides which run it is; see `hfb.tasks.tracking.tracking.record_run`.
        points: values by metric and step.
        files: published files by name.
        contents: artifacts of plain values by name.
        description: what MLflow shows at the top of the run's page.
        began_ms: when the work began, in milliseconds since 1970; None where that is not known.
        ended_ms: when it ended, of a record that was kept for later.
    """

    format: Literal[1] = 1
    name: str
    key: str
    params: dict[str, Any]
    tags: dict[str, str]
    points: dict[str, dict[int, float]]
    files: dict[str, RecordedFile]
    contents: dict[str, dict[str, Any]]
    description: str = ""
    began_ms: _Milliseconds | None = None
    ended_ms: _Milliseconds | None = None

    def inputs(self) -> dict[str, str]:
        """Return the sha256 of the inputs by their role; a record from a folder may lack them."""
        told = self.params.get("input")
        return {role: one for role, one in told.items() if isinstance(one, str)} if isinstance(told, dict) else {}


def write_run(record: RunRecord, paths: Mapping[str, Path]) -> RunHandle:
    """Find or create the run, and log everything into it; a finished one stays as it is.

    Args:
        record: content of the run.
        paths: places of the record's files, by name.

    Raises:
        tracking.StoreLost: the store cannot be reached or written.
    """
    began_ms, ended_ms = record.began_ms, record.ended_ms
    opened = tracking.record_run(
        record.name, record.key, record.params, record.tags, began_ms=began_ms, ended_ms=ended_ms
    )
    with opened as run:
        if not run.complete:
            tracking.log_inputs(run, record.inputs())
            tracking.describe(run, record.description)
            tracking.log_points(run, record.points)
            for name, file in record.files.items():
                tracking.log_files(run, [paths[name]], file.folder)
            for name, content in record.contents.items():
                tracking.log_dict(run, content, name)
        return RunHandle(run_id=run.run_id, link=tracking.link(run))


def keep_for_later(record: RunRecord, folder: Path) -> FileHandle:
    """Write a record that the store did not accept into a file, from which `hfb record` makes the same run.

    Args:
        record: content of the run.
        folder: of the result.
    """
    key, tags = tracking.add_record_context(record.key, record.tags)
    path = folder / RECORD
    kept = record.model_copy(update={"key": key, "tags": tags, "ended_ms": time.time_ns() // 1_000_000})
    write_bytes_atomic(path, json.dumps(hidden_in(kept.model_dump())).encode() + b"\n")
    return FileHandle.of(path)


def read_kept(result: Path) -> RunRecord:
    """Read the record that waits in a result's folder, which may come from anybody.

    Args:
        result: the folder.

    Raises:
        InputError: it is damaged, or names anything but files that a result consists of.
    """
    path = result / RECORD
    try:
        content = json.loads(read_file(result, RECORD, limit=_LIMIT_BYTES))
        if not isinstance(content, dict):
            raise ValueError("it is no record")
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({error}): run the result's own command again") from None
    record = to_record(RunRecord, content, str(path))
    foreign = [name for name in record.tags if not _TAGS.fullmatch(name)]
    foreign += [name for name in record.contents if name not in _CONTENTS]
    foreign += [name for name in record.files if not _FILE.fullmatch(name)]
    foreign += [file.folder for file in record.files.values() if file.folder not in (None, "mattes")]
    if foreign:
        raise InputError(f"{path} names {foreign[0]!r}, which is no part of a record of hfb's: make the result again")
    return record


def copy_recorded_files(record: RunRecord, result: Path, private: Path) -> dict[str, Path]:
    """Copy the files of a record out of a result's folder, each unchanged since the result was made.

    Args:
        record: content of the run.
        result: the folder.
        private: folder of the copies, which MLflow opens by path.

    Raises:
        InputError: one is gone, was changed, or is a link.
    """
    paths = {}
    for name, file in record.files.items():
        with suppress(OSError, NotOrdinary):
            paths[name] = copy_file(result, name, to=private)
        if name not in paths or sha256_of(paths[name]) != file.sha256:
            raise InputError(f"{result / name} is not as the result's command left it: run that command again")
    return paths


def describe_run(command: str, config: RunConfig, result: Mapping[str, Any]) -> str:
    """Return the description of a run: what was made, how well it explains the images, and what is doubtful.

    Args:
        command: such as ``fit``.
        config: all options.
        result: content of result.json.
    """
    figures = [
        f"{label} {format(result[name], form)}"
        for name, label, form in _DESCRIBED
        if isinstance(result.get(name), int | float)
    ]
    warnings = [f"- Warning: {one['message']}." for one in result["warnings"]]
    first = f"`hfb {command}` with the preset {config.preset} and the seed {config.seed}: {', '.join(figures)}."
    return "\n".join([first, *([""] if warnings else []), *warnings])
