"""A folder of clips, one after another: each once, failures again later, hopeless ones set aside with their reason."""

from __future__ import annotations

import logging
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.errors import InfrastructureError, InputError, ServerLost, TemporaryError
from hfb.flows.everyone import run_clip
from hfb.flows.runtime.prefect_database import prune_in_use
from hfb.flows.runtime.reaper import end_abandoned_flow_runs
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.interop.writers.export_names import RESULT
from hfb.io.names import shown_name
from hfb.io.safe_folder import check_ordinary
from hfb.io.toml_file import read_toml, to_record
from hfb.tasks.batch.batch_ledger import Entry, Ledger, pause_s, set_aside, stamp_of
from hfb.tasks.batch.batch_summary import PAGE, BatchSummary
from hfb.tasks.batch.notifications import ClipTrouble, notify, notify_end
from hfb.tasks.core.handles import files_in
from hfb.tasks.core.result_folder import is_unfinished
from hfb.tasks.inputs.clip_places import ClipPlace, find_clips
from hfb.tasks.inputs.out_place import check_batch_out, check_not_clips
from hfb.tasks.inputs.video_inputs import check_options, take_video_inputs
from hfb.tasks.results.workspace import workspace
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.displays import show_progress
from hfb.tasks.tracking import tracking
from hfb.tasks.workers.engine import Engine, engine_of

_STILL_S = 3.0  # a file that was written to so recently may still be on its way
_LOG = "batch.json"
_THUMBNAILS = "thumbnails"  # among the intermediate files: no clip has a folder there
_log = logging.getLogger(__name__)


@recorded_flow("batch", validate_parameters=False)
def batch(
    folder: Path | str,
    out: Path | str,
    config: dict[str, Any] | str | None = None,
    *,
    workers: int | str = 1,
    attempts: int = 3,
    wait_s: float = 60.0,
    watch_s: float | None = None,
    again: bool = False,
    store: str | None = None,
) -> dict[str, Any]:
    """Run every clip of a folder through `hfb.flows.everyone.run_clip`, into ``out/NAME``, with ``out/summary.html``.

    A problem of one clip, such as an impossible folder name or a damaged result, does not affect the others.

    Args:
        folder: of the clips.
        out: where the results go.
        config: options as plain content, or a file of them.
        workers: see `hfb.tasks.workers.engine.engine_of`.
        attempts: failures after which a clip is set aside.
        wait_s: before the second attempt [s], doubled for each further.
        watch_s: interval of the search for new clips [s]; None: end when nothing is left to do.
        again: whether to retry clips that were set aside.
        store: see `hfb.tasks.workers.engine.engine_of`.

    Returns:
        clips, done, set_aside, waiting (numbers), ``out`` and ``page``.

    Raises:
        InputError: the folder or a file that the options name cannot be read or ``out`` not be written, or another
            process works on it.
        ServerLost: Prefect's server went away; what is finished is kept.
    """
    folder, out = Path(folder), Path(out)
    check_batch_out(folder, out)
    content = read_toml(Path(config)) if isinstance(config, str) else config or {}
    options = to_record(RunConfig, content, "options")
    check_options(options)
    with suppress(Exception):  # tidying up after killed looks must not stop this one
        tracking.open_store()
        end_abandoned_flow_runs()
    with show_progress(), workspace(out) as intermediate:
        summary = BatchSummary(f"Clips of {folder.resolve().name}", out, intermediate / _THUMBNAILS)
        round_ = _Rounds(
            folder, out, options, engine_of(workers, store), attempts=attempts, wait_s=wait_s, summary=summary
        )
        if again:
            round_.ledger.again()
        while True:
            try:
                due_s = round_.once()
            except Exception as error:
                notify_end(shown_name(folder.resolve().name), str(error) or type(error).__name__)
                raise
            if due_s is None and watch_s is None:
                return round_.summary()
            pause_s = min(one for one in (due_s, watch_s) if one is not None)
            progress.say(f"hfb: looking again in {pause_s:.0f} s")
            time.sleep(pause_s)


class _Rounds:
    """A folder that is looked through repeatedly."""

    def __init__(
        self,
        folder: Path,
        out: Path,
        config: RunConfig,
        engine: Engine,
        *,
        attempts: int,
        wait_s: float,
        summary: BatchSummary,
    ) -> None:
        self._folder, self._out, self._config = folder, out, config
        self._engine, self._attempts, self._wait_s = engine, attempts, wait_s
        self._options, self._summary = config.model_dump(mode="json"), summary
        self.ledger = Ledger(out / _LOG)
        if self.ledger.damage:
            progress.say(f"hfb: {self.ledger.damage}; the file is now {set_aside(out / _LOG).name}")
        self._troubles: list[ClipTrouble] = []  # of this look
        self._seen: dict[str, float] = {}  # stamp of a clip -> when it was first seen, on a clock that does not jump

    def once(self) -> float | None:
        """Run every clip that is due; return the seconds until the next one, None where none waits."""
        due: list[float] = []
        self._troubles.clear()
        for place in self._look():
            stamp, written = stamp_of(place.files, self._options)
            entry = self._entry(place, stamp)
            if entry is not None and entry.status != "failed":
                continue
            wait_s = self._wait(stamp, entry, written)
            if wait_s <= 0:
                entry = self._work(place, stamp)
                prune_in_use()
                replaced = stamp_of(place.files, self._options)[0] != stamp
                if not replaced and (entry is None or entry.status != "failed"):
                    continue
                wait_s = self._pause(entry) if entry is not None and not replaced else _STILL_S
            due.append(time.monotonic() + wait_s)
        with suppress(Exception):  # those whose end a server took no word of; it may still be away
            end_abandoned_flow_runs()
        self._look()
        notify(shown_name(self._folder.resolve().name), self._troubles, self.summary())
        return max(0.2, min(due) - time.monotonic()) if due else None

    def _entry(self, place: ClipPlace, stamp: str) -> Entry | None:
        """Return the state of a clip; None also where its result is missing: it is then made again."""
        entry = self.ledger.entry(place.name, stamp)
        result = self._out / place.name / RESULT
        there = os.path.lexists(result) and not is_unfinished(self._out, place.name)
        gone = entry is not None and entry.status == "done" and not there
        return None if gone else entry

    def _wait(self, stamp: str, entry: Entry | None, written: float) -> float:
        """Return the seconds until a clip is due.

        Clocks jump, and files carry the times of other machines' clocks: implausibly late times are ignored.
        """
        now = time.time()
        still_s, again_s = written + _STILL_S - now, entry.due - now if entry else 0.0
        if still_s > _STILL_S:  # written to in the future: how long it has been lying there is counted here
            still_s = self._seen.setdefault(stamp, time.monotonic()) + _STILL_S - time.monotonic()
        if entry is not None and again_s > self._pause(entry):
            again_s = 0.0
        return max(still_s, again_s)

    def _pause(self, entry: Entry) -> float:
        """Return the seconds between a failure and the next attempt."""
        return pause_s(self._wait_s, entry.attempts)

    def _work(self, place: ClipPlace, stamp: str) -> Entry | None:
        """Run one clip; returns None where it is done."""
        progress.say(f"hfb: {place.shown}")
        hopeless = False
        try:
            place.check()
            target = self._out / place.name
            check_not_clips(self._folder, target)  # as of a clip `b` in `a/b` with --out a
            check_ordinary(self._out, place.name)
            inputs = take_video_inputs(place.source, self._config, clip=place.clip, out=target)
            place.check_read(files_in((inputs.video, inputs.background, inputs.calibration, inputs.track)))
            result = run_clip(inputs, target, self._config, self._engine)
        except ServerLost:  # no clip's fault, and nothing can be reported any more: the next look goes on
            raise
        except (TemporaryError, InfrastructureError) as error:
            reason, kind = str(error), type(error).__name__
        except InputError as error:
            reason, kind = str(error), "InputError"
            hopeless = True  # only another file can mend it, and then it is a new clip
        except Exception as error:
            _log.exception("%s", place.shown)
            kind = type(error).__name__
            reason = f"unexpected {kind}: {error}"
        else:
            if not _unrecorded(result):
                link = result.get("mlflow_link")
                self.ledger.finished(place.name, stamp, link)
                self._summary.show(place.name, "done", link=link)
                return None
            reason, kind = "it is finished, but MLflow did not take its record: that is tried again", "StoreLost"
        progress.fail(kind)
        entry = self.ledger.failed(
            place.name, stamp, reason, attempts=self._attempts, wait_s=self._wait_s, hopeless=hopeless
        )
        progress.say(f"hfb: {place.shown}: {entry.status}: {entry.reason}")
        _log.info("%s: %s: %s", place.shown, entry.status, entry.reason)
        self._summary.show(place.name, _state(entry), entry.reason)
        if entry.attempts == 1 or entry.status == "set aside":  # every further attempt is no news
            self._troubles.append(ClipTrouble(place.shown, entry.status, entry.reason))
        return entry

    def summary(self) -> dict[str, Any]:
        """Return the number of clips in each state."""
        counts, out = self._summary.counts(), self._out.resolve()
        return {
            "clips": counts.clips,
            "done": counts.done,
            "set_aside": counts.set_aside,
            "waiting": counts.waiting,
            "out": str(out),
            "page": str(out / PAGE),
        }

    def _look(self) -> tuple[ClipPlace, ...]:
        """List the clips as they are now, and update the pages."""
        places = find_clips(self._folder, self._out)
        states = []
        for place in places:
            entry = self._entry(place, stamp_of(place.files, self._options)[0])
            reason, link = (entry.reason, entry.link) if entry else ("", None)
            states.append((place.name, _state(entry), reason, link))
        self._summary.show_all(states)
        return places


def _state(entry: Entry | None) -> str:
    """Return the displayed state of a clip."""
    if entry is None:
        return "new"
    return entry.status if entry.status != "failed" else f"tried {entry.attempts} times, again later"


def _unrecorded(result: dict[str, Any]) -> bool:
    """Return whether the tracking store was unavailable when a finished clip, or a person in it, was recorded."""
    parts = [one for one in result["people"] if not one["error"]] if result.get("people") else [result]
    return any(one.get("mlflow_run_id") is None for one in parts)
