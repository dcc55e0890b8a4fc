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
from hfb.flows.app.request import RESULTS, JobRequest, check_request
from hfb.flows.app.upload import leftovers
from hfb.interop.writers.export_names import RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.json_file import read_json
from hfb.io.safe_folder import is_regular, open_lock, read_head
from hfb.io.toml_file import to_record
from hfb.tasks.core.result_folder import is_unfinished, read_result_content

PROGRESS = "progress.json"
_RECORD, _LOG, _ANSWER, _LOCK = "job.json", "log.txt", "answer.json", ".lock"
_NAME = re.compile(r"\d{8}-\d{6}-[0-9a-f]{8}")
_FILE = re.compile(r"[A-Za-z0-9]\w*\.[a-z0-9]{2,5}")
_MOST_WAITING = 20
_ENDS_WITHIN_S = 20.0
_LOOKS_EVERY_S = 0.1
_LOG_BYTES = 1 << 20
_UNUSABLE = 2
_FIGURES = ("matte_iou", "psnr_db", "foot_skate_mm", "fit_seconds", "seconds", "frames", "warnings", "unknown")

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


class Job:
    """One command and its folder."""

    def __init__(self, folder: Path, record: JobRecord) -> None:
        """Take a folder.

        Args:
            folder: of the job.
            record: what is known of it.
        """
        self.folder, self.record = folder, record
        self.cancelled = threading.Event()

    def keep(self, state: State, message: str = "", **times: float | None) -> None:
        """Write a new state.

        Args:
            state: of the job.
            message: why there is no result.
            **times: ``began`` and ``ended``.
        """
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
                shown |= {"steps": read_json(self.folder / PROGRESS)}
        if self.record.state == "done":
            result = read_result_content(self.folder, RESULTS)
            link = result.get("mlflow_link")
            shown |= {
                "files": self.files(),
                "figures": {name: result.get(name) for name in _FIGURES},
                "link": link if isinstance(link, str) and link.startswith(("http://", "https://")) else None,
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
        """Run the command and keep what became of it.

        Args:
            base: words of options that every job has.
        """
        command, *words = self.record.request.words(self.folder)
        self.keep("running", began=time.time(), ended=None)
        with (self.folder / _LOG).open("wb") as log, (self.folder / _ANSWER).open("wb") as answer:
            process = subprocess.Popen(
                [sys.executable, "-m", "hfb.flows.cli.job", str(self.folder), command, *base, *words],
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
            message = str(json.loads(lines[-1])["error"]).replace(f"{self.folder}/", "")
        except (IndexError, KeyError, TypeError, ValueError):
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            message = f"its process ended without a word ({how}); run again goes on from there"
        return "refused" if code == _UNUSABLE else "failed", message

    def _said(self, name: str) -> str:
        try:
            return read_head(self.folder, name, size=_LOG_BYTES).decode(errors="replace")
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
        for folder in sorted(out.iterdir()):
            if _NAME.fullmatch(folder.name) and not folder.is_symlink():
                with suppress(InputError):  # not ours, or damaged: it stays where it is
                    self._jobs[folder.name] = _earlier(folder)
        self._waiting: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._guard, self._ended = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._work, name="hfb-jobs", daemon=True)
        self._thread.start()

    def __getitem__(self, name: str) -> Job:
        """Return a job. Raises KeyError where there is none of this name."""
        return self._jobs[name]

    def summaries(self) -> list[dict[str, Any]]:
        """Return the list of jobs, the newest first."""
        return [job.summary() for _, job in sorted(self._jobs.items(), reverse=True)]

    def check_room(self) -> None:
        """Raise InputError where too many jobs wait."""
        if sum(job.is_active for job in self._jobs.values()) > _MOST_WAITING:
            raise InputError(f"{_MOST_WAITING} jobs are waiting already: wait, or cancel some")

    def add(self, name: str, request: JobRequest) -> Job:
        """Begin a new job.

        Args:
            name: of its folder.
            request: what is asked for.
        """
        job = Job(self.out / name, JobRecord(request=request, state="waiting"))
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
                job.keep("cancelling", began=job.record.began)
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
            with self._guard:
                runs = job.record.state == "waiting"
            if not runs:  # it was cancelled
                continue
            try:
                job.run(self._base)
            except OSError as error:
                with suppress(OSError):
                    job.keep("failed", f"its folder cannot be written: {error.strerror}", ended=time.time())
            if self._ended.is_set():
                job.keep("stopped", _STOPPED, ended=time.time())


_STOPPED = "the app ended before it did; run again goes on from there"


def _earlier(folder: Path) -> Job:
    """Read a job of an earlier start. Raises InputError where it is damaged."""
    content = read_json(folder / _RECORD, root=folder)
    record = to_record(JobRecord, content if isinstance(content, dict) else {}, str(folder))
    check_request(record.request.model_dump())
    job = Job(folder, record)
    if job.is_active:
        job.keep("stopped", _STOPPED)
    return job
