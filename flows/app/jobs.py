"""Jobs of the page: each is a command in a process of its own, one after the other, with a folder that outlives it.

OUT/20261129-101500-1a2b3c4d/
    job.json        what was asked for, and what became of it
    input/          the uploaded files
    progress.json   the steps of the command, and log.txt: what else it said
    result/         --out of the command
"""

from __future__ import annotations

import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from filelock import lock_descriptor

from hfb.config import Record
from hfb.errors import Busy, InputError
from hfb.flows.app.request import INPUTS, RESULTS, JobRequest, check_request
from hfb.flows.app.upload import leftovers
from hfb.interop.writers.export_names import RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.json_file import read_json
from hfb.io.names import shown_name
from hfb.io.safe_folder import check_tree, is_regular, open_file, open_lock
from hfb.io.toml_file import to_record
from hfb.report.pages.result_facts import read_facts
from hfb.tasks.core.result_folder import is_unfinished

PROGRESS = "progress.json"
_RECORD, _LOG, _ANSWER, _LOCK = "job.json", "log.txt", "answer.json", ".lock"
_NAME = re.compile(r"\d{8}-\d{6}-[0-9a-f]{8}")
_FILE = re.compile(r"[A-Za-z0-9]\w*\.[a-z0-9]{2,5}")
_MOST_WAITING = 20
_ENDS_WITHIN_S = 20.0
_LOOKS_EVERY_S = 0.1
_LOG_BYTES = 1 << 16
_UNUSABLE = 2
_FIGURES = ("matte_iou", "psnr_db", "fit_seconds", "seconds", "frames", "warnings")

State = Literal["waiting", "running", "cancelling", "done", "refused", "failed", "cancelled", "stopped"]


class JobRecord(Record):
    """The content of job.json.

    Attributes:
        message: why there is no result, in a sentence.
        began, ended: seconds since 1970.
    """

    request: JobRequest
    state: State
    message: str = ""
    began: float | None = None
    ended: float | None = None


class JobStep(Record):
    """One step of a command."""

    label: str
    state: Literal["running", "done", "failed"]
    done: int = 0
    total: int | None = None
    note: str = ""
    seconds: float = 0


class JobSteps(Record):
    """The content of progress.json."""

    steps: tuple[JobStep, ...] = ()


class Job:
    """One command and its folder."""

    def __init__(self, folder: Path, record: JobRecord, guard: threading.RLock) -> None:
        """Take a folder.

        Args:
            folder: of the job.
            record: what is known of it.
            guard: held while the state changes.
        """
        self.folder, self.record, self.guard = folder, record, guard
        self.cancelled = threading.Event()

    def keep(self, state: State, message: str = "", **times: float | None) -> None:
        """Write a new state.

        Args:
            state: of the job.
            message: why there is no result.
            **times: ``began`` and ``ended``.
        """
        with self.guard:
            self.record = self.record.model_copy(update={"state": state, "message": message, **times})
            write_bytes_atomic(self.folder / _RECORD, self.record.model_dump_json().encode())

    @property
    def is_active(self) -> bool:
        """Whether it waits or runs."""
        return self.record.state in ("waiting", "running", "cancelling")

    def summary(self) -> dict[str, Any]:
        """Return a row of the list of jobs."""
        record = self.record
        return {
            "name": self.folder.name,
            "title": record.request.title,
            "command": "video" if record.request.is_video else "fit",
            **record.model_dump(include={"state", "message", "began", "ended"}),
        }

    def details(self) -> dict[str, Any]:
        """Return everything that the page shows about it."""
        shown = self.summary() | {"steps": [], "log": self._said(_LOG)}
        if self.record.state != "waiting":
            with suppress(InputError):
                content = read_json(self.folder / PROGRESS)
                shown |= to_record(JobSteps, content if isinstance(content, dict) else {}, PROGRESS).model_dump()
        if self.record.state == "done":
            facts = read_facts(self.folder / RESULTS / RESULT, root=self.folder)
            link = facts.get("mlflow_link") or ""
            shown |= {
                "files": self.files(),
                "figures": {name: facts.get(name) for name in _FIGURES},
                "link": link if link.startswith(("http://", "https://")) else None,
            }
        return shown

    def files(self) -> dict[str, int]:
        """Return the files of the result with their sizes, by name."""
        if self.record.state != "done":
            return {}
        entries = [one for one in os.scandir(self.folder / RESULTS) if _FILE.fullmatch(one.name)]
        return {
            one.name: one.stat(follow_symlinks=False).st_size
            for one in sorted(entries, key=lambda one: one.name)
            if one.is_file(follow_symlinks=False)
        }

    def run(self, base: Sequence[str]) -> None:
        """Run the command and keep what became of it; nothing where the job does not wait any more.

        Args:
            base: words of options that every job has.
        """
        with self.guard:
            if self.record.state != "waiting":
                return
            self.keep("running", began=time.time(), ended=None)
        command, *words = self.record.request.words(self.folder)
        for name in (PROGRESS, _LOG, _ANSWER):
            (self.folder / name).unlink(missing_ok=True)  # a link, too, which is not to be written through
        with (self.folder / _LOG).open("xb") as log, (self.folder / _ANSWER).open("xb") as answer:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "hfb.flows.cli.job", str(self.folder), command, *base, *words],
                stdin=subprocess.PIPE,  # its end, also by a kill of this process, ends the command
                stdout=answer,
                stderr=log,
                start_new_session=True,
            )
            try:
                code = self._wait(process)
            finally:
                assert process.stdin is not None
                process.stdin.close()
        self.keep(*self._outcome(code), ended=time.time())

    def _wait(self, process: subprocess.Popen[bytes]) -> int:
        asked_s: float | None = None
        assert process.stdin is not None
        while (code := process.poll()) is None:
            if self.cancelled.is_set() and asked_s is None:
                asked_s = time.monotonic()
                process.stdin.close()
            if asked_s is not None and time.monotonic() - asked_s > _ENDS_WITHIN_S:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            time.sleep(_LOOKS_EVERY_S)
        return code

    def _outcome(self, code: int) -> tuple[State, str]:
        finished = is_regular(self.folder / RESULTS / RESULT) and not is_unfinished(self.folder, RESULTS)
        if code == 0 and finished:
            return "done", ""
        if self.cancelled.is_set():
            return "cancelled", "it was cancelled; run again goes on from there"
        lines = self._said(_ANSWER).splitlines()
        try:
            message = self._in_own_words(str(json.loads(lines[-1])["error"]))
        except (IndexError, KeyError, TypeError, ValueError):
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            message = f"its process ended without a word ({how}); run again goes on from there"
        return "refused" if code == _UNUSABLE else "failed", message

    def _in_own_words(self, message: str) -> str:
        """Return a message with the visitor's names of the files."""
        request = self.record.request
        for one, name in zip(request.files, request.stored_names(), strict=True):
            message = message.replace(f"{self.folder / INPUTS / name}", shown_name(one.name))
        return message.replace(f"{self.folder}/", "")

    def _said(self, name: str) -> str:
        """Return the end of what the command printed."""
        try:
            with open_file(self.folder, name) as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - _LOG_BYTES))
                return file.read().decode(errors="replace")
        except (OSError, ValueError):
            return ""


class Jobs:
    """All jobs of a folder. Those of earlier starts are there, too; one process at a time has the folder."""

    def __init__(self, out: Path, base: Sequence[str] = ()) -> None:
        """Take the folder, and begin to run what is asked for.

        Args:
            out: folder of all jobs.
            base: words of options that every job has.

        Raises:
            Busy: another process has the folder.
        """
        self.out, self._base = out, tuple(base)
        out.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._lock_file = open_lock(out, _LOCK)
        if not lock_descriptor(self._lock_file, blocking=False):
            raise Busy(f"another `hfb app` has {out}: use its page, or choose another --out")
        for part in leftovers(out):
            shutil.rmtree(part, ignore_errors=True)
        self._jobs: dict[str, Job] = {}
        self._guard, self._ended = threading.RLock(), threading.Event()
        for folder in sorted(out.iterdir()):
            if _NAME.fullmatch(folder.name) and not folder.is_symlink():
                with suppress(InputError):  # not ours, or damaged: it stays where it is
                    self._jobs[folder.name] = _earlier(folder, self._guard)
        self._waiting: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="hfb-jobs", daemon=True)
        self._thread.start()

    def __getitem__(self, name: str) -> Job:
        """Return a job. Raises KeyError where there is none of this name."""
        return self._jobs[name]

    def summaries(self) -> list[dict[str, Any]]:
        """Return the list of jobs, the newest first."""
        with self._guard:
            return [job.summary() for _, job in sorted(self._jobs.items(), reverse=True)]

    def check_room(self) -> None:
        """Raise InputError where too many jobs wait."""
        with self._guard:
            waiting = sum(job.is_active for job in self._jobs.values())
        if waiting > _MOST_WAITING:
            raise InputError(f"{_MOST_WAITING} jobs are waiting already: wait, or cancel some")

    def add(self, name: str, request: JobRequest) -> Job:
        """Begin a new job.

        Args:
            name: of its folder.
            request: what is asked for.
        """
        job = Job(self.out / name, JobRecord(request=request, state="waiting"), self._guard)
        with self._guard:
            self._jobs[name] = job
            self._begin(job)
        return job

    def again(self, name: str) -> None:
        """Run a job again that has ended; it goes on from what is there. Raises KeyError.

        Args:
            name: of the job.
        """
        with self._guard:
            if not self._jobs[name].is_active:
                self._begin(self._jobs[name])

    def cancel(self, name: str) -> None:
        """End a job that waits or runs. Raises KeyError.

        Args:
            name: of the job.
        """
        with self._guard:
            job = self._jobs[name]
            if job.record.state == "waiting":
                job.keep("cancelled", "it was cancelled before it began")
            elif job.record.state == "running":
                job.keep("cancelling")
            job.cancelled.set()

    def remove(self, name: str) -> None:
        """Remove a job that has ended, and all of its files. Raises KeyError.

        Args:
            name: of the job.
        """
        with self._guard:
            if not self._jobs[name].is_active:
                shutil.rmtree(self._jobs.pop(name).folder)

    def close(self) -> None:
        """End the running job; those that wait are told as stopped at the next start."""
        self._ended.set()
        for job in self._jobs.values():
            job.cancelled.set()
        self._waiting.put(None)
        self._thread.join()
        os.close(self._lock_file)

    def _begin(self, job: Job) -> None:
        job.cancelled.clear()
        job.keep("waiting", began=None, ended=None)
        self._waiting.put(job)

    def _work(self) -> None:
        while (job := self._waiting.get()) is not None:
            if self._ended.is_set():
                return
            try:
                job.run(self._base)
            except OSError as error:
                with suppress(OSError):
                    job.keep("failed", f"its folder cannot be written: {error.strerror}", ended=time.time())
            if self._ended.is_set() and job.record.state == "cancelled":
                job.keep("stopped", _STOPPED)


_STOPPED = "the app ended before it did; run again goes on from there"


def _earlier(folder: Path, guard: threading.RLock) -> Job:
    """Read a job of an earlier start. Raises InputError where it is damaged."""
    content = read_json(folder / _RECORD, root=folder)
    record = to_record(JobRecord, content if isinstance(content, dict) else {}, str(folder))
    check_request(record.request.model_dump())
    check_tree(folder, INPUTS)
    job = Job(folder, record, guard)
    if job.is_active:
        job.keep("stopped", _STOPPED)
    return job
