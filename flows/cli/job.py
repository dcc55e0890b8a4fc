"""A job of `hfb app`: a command of `hfb` in a process of its own, whose steps are written to a file.

    python -m hfb.flows.cli.job FOLDER COMMAND WORDS...

The command is told to end when standard input does, which its starter holds open: by closing it, or by being killed.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from hfb.flows.app.jobs import PROGRESS
from hfb.flows.cli.cli import main
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.telemetry.progress import Listener, Shown, add_listener

_EVERY_S = 0.4
_MOST_STEPS = 200


class _Steps(Listener):
    """Writes the steps to a file: their labels, and how much of each is done."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._steps: list[tuple[Shown, dict[str, Any]]] = []
        self._lock = threading.Lock()
        self._written_s = 0.0

    def begin(self, shown: Shown) -> None:
        with self._lock:
            self._steps = [*self._steps[-_MOST_STEPS:], (shown, {"state": "running"})]
        self._write(now=True)

    def update(self, shown: Shown) -> None:
        self._write()

    def end(self, shown: Shown, failed: bool) -> None:
        with self._lock:
            for known, told in self._steps:
                if known is shown:
                    told |= {"state": "failed" if failed else "done", "seconds": round(shown.seconds, 1)}
        self._write(now=True)

    def _write(self, now: bool = False) -> None:
        with self._lock:
            if not now and time.monotonic() - self._written_s < _EVERY_S:
                return
            self._written_s = time.monotonic()
            told = [
                {"label": one.label, "done": one.done, "total": one.total, "note": one.note, **more}
                for one, more in self._steps
            ]
            write_bytes_atomic(self._path, json.dumps(told).encode())


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
