"""A log of one JSON object per line, with the run, the task and the frames that a line is about."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any

from hfb.tasks.core.scoped import scoped
from hfb.tasks.telemetry.secrets import without_secrets

_given: ContextVar[dict[str, Any]] = ContextVar("ids", default={})  # noqa: B039 (never changed, only replaced)
_OF_PREFECT = {"flow_run": "flow_run_id", "task": "task_name"}
_FRAME_PARAMETERS = ("number", "numbers", "frames")


def ids_now() -> dict[str, Any]:
    """Return ``flow_run``, ``task`` and ``frames`` of the caller; unknown ones are left out."""
    contexts = sys.modules.get("prefect.context")
    if _given.get() or contexts is None:
        return _given.get()
    task = contexts.TaskRunContext.get()
    if task is not None:
        return ids_of(task.parameters)
    flow = contexts.FlowRunContext.get()
    return {"flow_run": str(flow.flow_run.id)} if flow is not None and flow.flow_run is not None else {}


def ids_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ids of a call, in the run of its task.

    Args:
        parameters: arguments of the call by name.
    """
    contexts = sys.modules.get("prefect.context")
    task = contexts.TaskRunContext.get() if contexts else None
    ids = {"flow_run": str(task.task_run.flow_run_id), "task": task.task.name} if task is not None else {}
    fields = {**dict(parameters.get("call", ())), **parameters}  # a mapped task has one record
    frames = _numbers(next((fields[name] for name in _FRAME_PARAMETERS if name in fields), None))
    return ids | ({"frames": frames} if frames else {})


def _numbers(value: object) -> list[int]:
    several = value if isinstance(value, tuple | list) else (value,)
    return [one for one in several if isinstance(one, int)]


def about(ids: dict[str, Any]) -> AbstractContextManager[None]:
    """Set the ids of lines inside the block, for a worker process.

    Args:
        ids: as `ids_now` returns them.
    """
    return scoped(_given, ids)


class WithIds(logging.Filter):
    """Adds the ids to every record; for handlers, which get the records of all loggers."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Add the ids and pass the record.

        Args:
            record: of the log.
        """
        if not hasattr(record, "ids"):  # a worker's has them, and Prefect's own lines say whose they are
            told = {ours: getattr(record, theirs, None) for ours, theirs in _OF_PREFECT.items()}
            record.ids = ids_now() | {name: str(value) for name, value in told.items() if value is not None}
        return True


class JsonFormatter(logging.Formatter):
    """``time``, ``level``, ``process``, ``logger``, ``message``, ``error`` and the ids; passwords are hidden."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as JSON.

        Args:
            record: of the log.
        """
        content = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "process": record.process,
            "logger": record.name,
            "message": record.getMessage(),
            **getattr(record, "ids", {}),
        }
        if record.exc_info:
            content["error"] = self.formatException(record.exc_info)
        elif record.exc_text:
            content["error"] = record.exc_text
        return without_secrets(json.dumps(content, default=str))
