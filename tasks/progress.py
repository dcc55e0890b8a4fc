"""What a person sees while a run works: a live line on a terminal, otherwise a plain line now and then.

Everything goes to standard error; standard output is for results. Whoever starts a run chooses the display with
``showing``; tasks only say ``step`` and ``advance``, and say it to nobody when no display was chosen.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Protocol, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn


@dataclass
class Shown:
    """One step on display."""

    label: str
    reused: bool = False
    done: int = 0
    total: int | None = None
    note: str = ""
    began: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began

    def outcome(self) -> str:
        return "reused" if self.reused else f"{self.seconds:.1f} s"


class Display(Protocol):
    """Where steps are shown."""

    def begin(self, shown: Shown) -> None: ...
    def update(self, shown: Shown) -> None: ...
    def end(self, shown: Shown, failed: bool) -> None: ...
    def say(self, line: str) -> None: ...
    def running(self) -> AbstractContextManager[object]: ...


class Silent:
    """Shows nothing."""

    def begin(self, shown: Shown) -> None: ...
    def update(self, shown: Shown) -> None: ...
    def end(self, shown: Shown, failed: bool) -> None: ...
    def say(self, line: str) -> None: ...
    def running(self) -> AbstractContextManager[object]:
        return nullcontext()


class Plain:
    """For logs and pipes: a line when a step ends, and after 2, 3, 5, 7, 10 ... seconds how far it is."""

    def __init__(self, stream: TextIO, first_s: float = 2.0) -> None:
        self._stream = stream
        self._first_s = first_s
        self._current: Shown | None = None
        self._stop = threading.Event()

    def begin(self, shown: Shown) -> None:
        self._current = shown

    def update(self, shown: Shown) -> None:
        """The watching thread reads what it needs when its time comes."""

    def end(self, shown: Shown, failed: bool) -> None:
        self._current = None
        if not failed:
            self.say(f"{shown.label}: {shown.outcome()}")

    def say(self, line: str) -> None:
        print(line, file=self._stream, flush=True)

    @contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=self._watch, name="hfb-progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _watch(self) -> None:
        watched, due_s = self._current, self._first_s
        while not self._stop.wait(self._first_s / 4):
            shown = self._current
            if shown is not watched:
                watched, due_s = shown, self._first_s
            if shown is not None and shown.seconds >= due_s:
                count = f" {shown.done}/{shown.total}" if shown.total else ""
                note = f", {shown.note}" if shown.note else ""
                self.say(f"{shown.label}{count}{note} ({shown.seconds:.0f} s) ...")
                due_s = min(1.5 * shown.seconds, shown.seconds + 10)


class Live:
    """For a terminal: a spinner and a bar that give way to finished lines and to log lines."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._bar = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24),
            TextColumn("{task.fields[note]}"), TimeElapsedColumn(), console=console, transient=True,
        )  # fmt: skip
        self._rows: dict[int, TaskID] = {}

    def begin(self, shown: Shown) -> None:
        self._rows[id(shown)] = self._bar.add_task(shown.label, total=None, note="")

    def update(self, shown: Shown) -> None:
        self._bar.update(self._rows[id(shown)], completed=shown.done, total=shown.total, note=shown.note)

    def end(self, shown: Shown, failed: bool) -> None:
        self._bar.remove_task(self._rows.pop(id(shown)))
        if not failed:
            self.console.print(f"  {shown.label:<24} [dim]{shown.outcome():>8}[/dim]", highlight=False)

    def say(self, line: str) -> None:
        self.console.print(line, highlight=False, markup=False)

    def running(self) -> AbstractContextManager[object]:
        return self._bar


_SILENT = Silent()
_display: ContextVar[Display | None] = ContextVar("display", default=None)
_step: ContextVar[Shown | None] = ContextVar("step", default=None)


@contextmanager
def showing(display: Display) -> Iterator[None]:
    """Show the steps inside on a display."""
    token = _display.set(display)
    try:
        with display.running():
            yield
    finally:
        _display.reset(token)


@contextmanager
def step(label: str) -> Iterator[Shown]:
    """One step of a run, from here to the end of the block."""
    display, shown = _display.get() or _SILENT, Shown(label)
    token = _step.set(shown)
    display.begin(shown)
    failed = True
    try:
        yield shown
        failed = False
    finally:
        display.end(shown, failed)
        _step.reset(token)


def advance(done: int, total: int, note: str = "") -> None:
    """How far the current step is."""
    shown = _step.get()
    if shown is not None:
        shown.done, shown.total, shown.note = done, total, note
        (_display.get() or _SILENT).update(shown)


def say(line: str) -> None:
    """A line for the person who waits."""
    (_display.get() or _SILENT).say(line)


def display_for(stream: TextIO = sys.stderr, quiet: bool = False) -> Display:
    """The display that suits a stream."""
    if quiet:
        return Silent()
    return Live(Console(file=stream)) if stream.isatty() else Plain(stream)
