"""Cached results of tasks in a folder of their own; records in any other format are not read.

Prefect lets a record choose how it is deserialised, pickle included: whoever hands over a result's folder could run
code at the next start in it. So could whoever sets the state of a run, which may name any file as its result. Ours are
JSON of our own handles.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from prefect.context import FlowRunContext
from prefect.results import ResultRecord
from prefect.serializers import JSONSerializer, Serializer
from prefect.settings import PREFECT_LOCAL_STORAGE_PATH, temporary_settings

from hfb.io.safe_folder import check_tree, open_folder, read_file

# Prefix of a task's record (`hfb.tasks.task.cache_key`); records of failures and flows are never read again.
_NAME = "hfb-"
_OURS = "hfb."
_ASIDE, _LONGEST_NAME = "records-set-aside", 200
_BYTE_LIMIT = 64 << 20
_log = logging.getLogger(__name__)
_deserialize = ResultRecord.deserialize


def read_own_records_alone() -> None:
    """Make Prefect, for the rest of this process, refuse every record that is not hfb's at the moment it is read."""

    def deserialize(
        _: type[ResultRecord[Any]], data: bytes, backup_serializer: Serializer | None = None
    ) -> ResultRecord[Any]:
        check_record(data)
        return _deserialize(data)

    ResultRecord.deserialize = classmethod(deserialize)  # type: ignore[assignment]  # results of states come this way too


@contextmanager
def records_in(folder: Path) -> Iterator[None]:
    """Keep results of tasks beside the files that they name; no other folder reuses them.

    Args:
        folder: of the result's intermediate files.
    """
    place = folder / "records"
    drop_foreign(place)
    with ExitStack() as stack:
        stack.enter_context(temporary_settings({PREFECT_LOCAL_STORAGE_PATH: place}))
        if (run := FlowRunContext.get()) is not None:  # a flow hands on the place that was set when it began
            store = run.result_store.model_copy(update={"result_storage": None})
            stack.enter_context(run.model_copy(update={"result_store": store}))
        yield


def drop_foreign(place: Path) -> int:
    """Move every record that is not hfb's out of Prefect's reach; its result is computed again.

    They are moved, not removed: hfb removes only what it wrote. Returns their number.

    Args:
        place: folder of the records.

    Raises:
        NotOrdinary: the folder of records, or a record, is a link or a special file.
    """
    check_tree(place.parent, place.name)
    foreign = [path for path in place.iterdir() if not _is_ours(path)] if place.is_dir() else []
    if foreign:
        with open_folder(place.parent, place.name) as here, open_folder(place.parent, _ASIDE, make=True) as aside:
            for path in foreign:
                name = f"{path.name[:_LONGEST_NAME]}.{secrets.token_hex(4)}"
                os.rename(path.name, name, src_dir_fd=here, dst_dir_fd=aside)
                _log.info("%s: no record of ours, moved to %s", path, _ASIDE)
    return len(foreign)


def check_record(data: bytes) -> None:
    """Raise ValueError if a record is not JSON of hfb's own handles.

    Args:
        data: the record as it is stored.
    """
    try:
        record = json.loads(data)
        is_ours = record["metadata"]["serializer"] == JSONSerializer().model_dump(mode="json")
        json.loads(record["result"], object_hook=_only_handles)
    except (ValueError, KeyError, TypeError, RecursionError):
        is_ours = False
    if not is_ours:
        raise ValueError("a result that is no record of hfb's is not read")


def _is_ours(path: Path) -> bool:
    try:
        if not path.name.startswith(_NAME):
            return False
        check_record(read_file(path.parent, path.name, limit=_BYTE_LIMIT))
    except (OSError, ValueError):
        return False
    return True


def _only_handles(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content; raise ValueError for anything that Prefect would deserialise into a foreign class."""
    kind = content.get("__class__")
    if "__exc_type__" in content or (kind is not None and not str(kind).startswith(_OURS)):
        raise ValueError("not a handle")
    return content
