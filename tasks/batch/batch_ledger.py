"""State of every clip of a watched folder, in a small file that is written atomically after every change.

A clip is identified by its name, and by the names, sizes and times of its files and the options: where any of these
changes, it is a new clip. Light to import.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from hfb.config import Record
from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.io.json_file import read_json
from hfb.io.names import shown_name
from hfb.tasks.core.handles import digest

_FOUND_AGAIN = "finished clips are found again in their folders"
_LONGEST_REASON, _DAY_S = 2000, 86_400.0
Status = Literal["done", "failed", "set aside"]


class Entry(Record):
    """State of one clip.

    Attributes:
        stamp: identifies its files and the options.
        attempts: failures since its files changed.
        due: time of the next attempt [s since 1970].
    """

    stamp: Annotated[str, Field(max_length=200)]
    status: Status
    attempts: Annotated[int, Field(ge=0, le=10**6)] = 0
    reason: Annotated[str, Field(max_length=20_000)] = ""
    due: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    link: Annotated[str, Field(max_length=20_000)] | None = None


class Ledger:
    """All clips of a batch, by name.

    Attributes:
        damage: a sentence on what was wrong with the file; finished clips are then recognised in their folders.
    """

    def __init__(self, path: Path) -> None:
        """Read the file; ``damage`` tells what is wrong with it.

        Args:
            path: the file, which need not exist.
        """
        self._path = path
        self._entries: dict[str, Entry] = {}
        self.damage = ""
        try:
            content = read_json(path, _FOUND_AGAIN) if os.path.lexists(path) else {}
        except InputError as error:
            self.damage, content = str(error), {}
        if not isinstance(content, dict):
            self.damage, content = f"{path} is no record of a batch: {_FOUND_AGAIN}", {}
        for name, entry in content.items():
            try:
                self._entries[name] = Entry.model_validate(entry)
            except ValidationError:
                self.damage = f"{path} has entries that are no record of a clip: they are forgotten"

    def entry(self, name: str, stamp: str) -> Entry | None:
        """Return the state of a clip; None for a new or a changed one.

        Args:
            name: of the clip.
            stamp: of the clip as it is now.
        """
        found = self._entries.get(name)
        return found if found is not None and found.stamp == stamp else None

    def finished(self, name: str, stamp: str, link: str | None) -> None:
        """Record that a clip is done.

        Args:
            name: of the clip.
            stamp: of the clip as it is now.
            link: its page in MLflow.
        """
        self._keep(name, Entry(stamp=stamp, status="done", link=link))

    def failed(self, name: str, stamp: str, reason: str, *, attempts: int, wait_s: float, hopeless: bool) -> Entry:
        """Record a failure: the clip is retried after a wait that doubles each time, or set aside.

        Args:
            name: of the clip.
            stamp: of the clip as it is now.
            reason: one sentence.
            attempts: failures after which it is set aside.
            wait_s: before the second attempt [s].
            hopeless: sets it aside at once, since only another file can help.
        """
        before = self.entry(name, stamp)
        count = 1 + (before.attempts if before else 0)
        aside = hopeless or count >= attempts
        due = 0.0 if aside else time.time() + pause_s(wait_s, count)
        said = shown_name(reason[:_LONGEST_REASON])  # names of files, and libraries' errors, hold anything
        entry = Entry(stamp=stamp, status="set aside" if aside else "failed", attempts=count, reason=said, due=due)
        self._keep(name, entry)
        return entry

    def again(self) -> None:
        """Retry clips that were set aside."""
        self._entries = {name: entry for name, entry in self._entries.items() if entry.status != "set aside"}

    def _keep(self, name: str, entry: Entry) -> None:
        self._entries[name] = entry
        content = {key: one.model_dump() for key, one in sorted(self._entries.items())}
        write_bytes_atomic(self._path, json.dumps(content, indent=2).encode() + b"\n")


def pause_s(wait_s: float, attempts: int) -> float:
    """Return the wait before the next attempt [s]: doubled after each failure, at most a day.

    Args:
        wait_s: before the second attempt [s].
        attempts: failures so far.
    """
    return min(max(wait_s, _DAY_S), wait_s * 2.0 ** min(attempts - 1, 60))


def set_aside(path: Path) -> Path:
    """Rename a foreign file in the place of one of hfb's; returns its new path.

    Args:
        path: the file.
    """
    number = 1
    while os.path.lexists(place := path.with_name(f"{path.name}.set-aside-{number}")):
        number += 1
    path.rename(place)
    return place


def stamp_of(files: Sequence[Path], options: Mapping[str, object]) -> tuple[str, float]:
    """Return a hash of a clip's files and options, and the time of its latest change [s since 1970].

    A file that has just disappeared counts as one of size -1.

    Args:
        files: of the clip.
        options: of the run.
    """
    content: list[tuple[str, int, int]] = []
    for path in files:
        try:
            facts = path.stat()
            content.append((str(path), facts.st_size, facts.st_mtime_ns))
        except OSError:
            content.append((str(path), -1, 0))
    return digest([content, dict(options)]), max((written for _, _, written in content), default=0) / 1e9
