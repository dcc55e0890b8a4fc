"""A folder of clips, one after another: each once, failures again later, hopeless ones set aside with their reason."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from prefect import flow

from flows.people import run_clip
from flows.reaper import end_abandoned_flow_runs, mark_owner
from flows.workplace import workplace
from hfb.config import RunConfig
from hfb.errors import Busy, InputError, Unavailable
from hfb.export.names import REPORT
from hfb.media.atomic import write_bytes_atomic
from hfb.toml_file import read_toml, to_record
from tasks import progress, tracking
from tasks.batch_ledger import Entry, Ledger, stamp_of
from tasks.clip_places import ClipPlace, find_clips
from tasks.displays import shown_somewhere
from tasks.video_inputs import take_video_inputs

_STILL_S = 3.0  # a file that was written to so recently may still be on its way
_LOG = "batch.json"
_PAGE = "summary.html"
_log = logging.getLogger(__name__)


@flow(name="batch", persist_result=False, validate_parameters=False, on_running=[mark_owner])
def batch(
    folder: Path | str,
    out: Path | str,
    config: dict[str, Any] | str | None = None,
    workers: int = 1,
    attempts: int = 3,
    wait_s: float = 60.0,
    watch_s: float | None = None,
    again: bool = False,
) -> dict[str, Any]:
    """Every clip of a folder through `flows.people.run_clip`, into ``out/NAME``; ``out/summary.html`` tells of all.

    Args:
        config: options as plain content, or the file that holds them.
        attempts: failures after which a clip is set aside; wait_s: before the second attempt, doubled for each further.
        watch_s: keep looking for new clips, so often [s]; None: end when nothing is left to do.
        again: take clips that were set aside once more.

    Returns:
        clips, done, set_aside, waiting (numbers), ``out`` and ``page``.

    Raises:
        InputError: the folder cannot be read or ``out`` not be written, or another process works on it.
    """
    folder, out = Path(folder), Path(out)
    content = read_toml(Path(config)) if isinstance(config, str) else config or {}
    options = to_record(RunConfig, content, "options")
    with suppress(Exception):  # tidying up after killed looks must not stop this one
        tracking.open_store()
        end_abandoned_flow_runs()
    with shown_somewhere(), workplace(out):
        round_ = _Rounds(folder, out, options, workers, attempts, wait_s)
        if again:
            round_.ledger.again()
        while True:
            due_s = round_.once()
            if due_s is None and watch_s is None:
                return round_.summary()
            pause_s = min(one for one in (due_s, watch_s) if one is not None)
            progress.say(f"hfb: looking again in {pause_s:.0f} s")
            time.sleep(pause_s)


class _Rounds:
    """A folder, looked through again and again."""

    def __init__(
        self, folder: Path, out: Path, config: RunConfig, workers: int, attempts: int, wait_s: float
    ) -> None:  # fmt: skip
        self._folder, self._out, self._config = folder, out, config
        self._workers, self._attempts, self._wait_s = workers, attempts, wait_s
        self._options = config.model_dump(mode="json")
        self.ledger = Ledger(out / _LOG)

    def once(self) -> float | None:
        """Work on every clip whose time has come; the seconds until the next one's, None where nothing waits."""
        due: list[float] = []
        for place in find_clips(self._folder, self._out):
            stamp, written = stamp_of(place.files, self._options)
            entry = self.ledger.entry(place.name, stamp)
            now = time.time()
            ready = max(entry.due if entry else 0.0, written + _STILL_S)
            if entry is not None and entry.status != "failed":
                continue
            if ready <= now:
                entry = self._work(place, stamp)
                if entry is None or entry.status != "failed":
                    continue
                ready = entry.due
            due.append(ready)
        self._write_page()
        return max(0.2, min(due) - time.time()) if due else None

    def _work(self, place: ClipPlace, stamp: str) -> Entry | None:
        """One clip; None where it is done."""
        progress.say(f"hfb: {place.name}")
        hopeless = False
        try:
            inputs = take_video_inputs(place.source, self._config, clip=place.clip)
            result = run_clip(inputs, self._out / place.name, self._config, self._workers)
        except (Busy, Unavailable) as error:
            reason = str(error)
        except InputError as error:
            reason, hopeless = str(error), True  # only another file can mend it, and then it is a new clip
        except Exception as error:
            _log.exception("%s", place.name)
            reason = f"unexpected {type(error).__name__}: {error}"
        else:
            self.ledger.finished(place.name, stamp, result.get("mlflow_link"))
            self._write_page()
            return None
        entry = self.ledger.failed(place.name, stamp, reason, self._attempts, self._wait_s, hopeless)
        progress.say(f"hfb: {place.name}: {entry.status}: {reason}")
        _log.info("%s: %s: %s", place.name, entry.status, reason)
        self._write_page()
        return entry

    def summary(self) -> dict[str, Any]:
        """How many clips there are, and what became of them."""
        states = [status for _, status, _ in self._states()]
        return {
            "clips": len(states), "done": states.count("done"), "set_aside": states.count("set aside"),
            "waiting": len(states) - states.count("done") - states.count("set aside"),
            "out": str(self._out.resolve()), "page": str(self._out.resolve() / _PAGE),
        }  # fmt: skip

    def _states(self) -> Sequence[tuple[ClipPlace, str, Entry | None]]:
        states = []
        for place in find_clips(self._folder, self._out):
            entry = self.ledger.entry(place.name, stamp_of(place.files, self._options)[0])
            waits = f"tried {entry.attempts} times, again later" if entry else "new"
            states.append((place, entry.status if entry and entry.status != "failed" else waits, entry))
        return states

    def _write_page(self) -> None:
        from hfb.report.batch_page import BatchClip, batch_page

        clips = []
        for place, status, entry in self._states():
            done = self._out / place.name
            finished = status == "done" and (done / "result.json").exists()
            figures = json.loads((done / "result.json").read_bytes()) if finished else {}
            reason, link = (entry.reason, entry.link) if entry else ("", None)
            strip, report = (_strip_in(done), self._report_in(done)) if finished else (None, None)
            clips.append(BatchClip(place.name, status, reason, figures, strip, link, report=report))
            for one in figures.get("people", ()):
                state = "no motion" if one["error"] else "done"
                name = f"{place.name}: {one['name']}"
                theirs = Path(one["out"])
                shown, report = _strip_in(theirs), self._report_in(theirs)
                clips.append(BatchClip(name, state, one["error"] or "", one, shown, person=True, report=report))
        write_bytes_atomic(self._out / _PAGE, batch_page(f"Clips of {self._folder.resolve().name}", clips).encode())

    def _report_in(self, folder: Path) -> Path | None:
        """A result's page, from the folder of the summary."""
        whole, here = folder.resolve() / REPORT, self._out.resolve()
        return whole.relative_to(here) if whole.is_file() and whole.is_relative_to(here) else None


def _strip_in(folder: Path) -> Path | None:
    return folder / "strip.png" if (folder / "strip.png").exists() else None
