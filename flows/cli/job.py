"""A job of `hfb app`: a command of `hfb` in a process of its own, whose steps are written to a file.

    python -m hfb.flows.cli.job FOLDER COMMAND WORDS...

The command is told to end when standard input does, which its starter holds open: by closing it, or by being killed.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Literal

from hfb.flows.app.jobs import PROGRESS, JobStep, JobSteps
from hfb.flows.cli.cli import main
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.telemetry.progress import Listener, Shown, add_listener

_EVERY_S = 0.4
_MOST_STEPS = 200
_State = Literal["running", "done", "failed"]


class _Steps(Listener):
    """Writes the steps to a file: their labels, and how much of each is done."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock, self._written_s = path, threading.Lock(), 0.0
        self._steps: list[tuple[Shown, JobStep]] = []

    def begin(self, shown: Shown) -> None:
        with self._lock:
            self._steps = [*self._steps[-_MOST_STEPS:], (shown, _told(shown, "running"))]
            self._write()

    def update(self, shown: Shown) -> None:
        with self._lock:
            if time.monotonic() - self._written_s > _EVERY_S:
                self._replace(shown, "running")

    def end(self, shown: Shown, failed: bool) -> None:
        with self._lock:
            self._replace(shown, "failed" if failed else "done")

    def _replace(self, shown: Shown, state: _State) -> None:
        self._steps = [(one, _told(shown, state) if one is shown else told) for one, told in self._steps]
        self._write()

    def _write(self) -> None:
        self._written_s = time.monotonic()
        steps = JobSteps(steps=tuple(told for _, told in self._steps))
        write_bytes_atomic(self._path, steps.model_dump_json().encode())


def _told(shown: Shown, state: _State) -> JobStep:
    seconds = round(shown.seconds, 1)
    return JobStep(label=shown.label, state=state, done=shown.done, total=shown.total, note=shown.note, seconds=seconds)


def _end_with_input() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    folder, *words = sys.argv[1:]
    threading.Thread(target=_end_with_input, name="hfb-input", daemon=True).start()
    with add_listener(_Steps(Path(folder) / PROGRESS)):
        code = main(words)
    sys.exit(code)
