"""What a person sees while a run works: a live line on a terminal, otherwise a plain line now and then.

The second also becomes progress artifacts of the flow run, for those who watch it in Prefect's pages.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from hfb.tasks.telemetry.progress import Display, Shown, showing, shown_to_somebody

_OFTEN_S, _SELDOM_S, _LONG_S = 10.0, 60.0, 300.0
_NEARLY = 1 - 1e-6


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

    def __init__(self, write: Callable[[str], None], first_s: float = 2.0) -> None:
        self._write = write
        self._first_s = first_s
        self._steps: list[Shown] = []
        self._stop = threading.Event()

    def begin(self, shown: Shown) -> None:
        self._steps.append(shown)

    def update(self, shown: Shown) -> None:
        """The watching thread reads what it needs when its time comes."""

    def end(self, shown: Shown, failed: bool) -> None:
        self._steps.remove(shown)
        if not failed:
            self.say(f"{shown.label}: {shown.outcome()}")

    def say(self, line: str) -> None:
        self._write(printable(line))

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
        watched, due_s = None, self._first_s
        while not self._stop.wait(self._first_s / 4):
            shown = next(reversed(self._steps), None)  # the innermost one
            if shown is not watched:
                watched, due_s = shown, self._first_s
            if shown is not None and shown.seconds >= due_s:
                count = f" {shown.done}/{shown.total}" if shown.total else ""
                note = f", {shown.note}" if shown.note else ""
                self.say(f"{shown.label}{count}{note} ({shown.seconds:.0f} s) ...")
                pause_s = _OFTEN_S if shown.seconds < _LONG_S else _SELDOM_S
                due_s = min(1.5 * shown.seconds, shown.seconds + pause_s)


class Live:
    """For a terminal: a spinner and a bar that give way to finished lines and to log lines."""

    def __init__(self, console: Console) -> None:
        self.console = console
        # no markup: labels and notes may hold the names of files, and those may hold brackets
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[note]}", markup=False),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._rows: dict[int, TaskID] = {}

    def begin(self, shown: Shown) -> None:
        self._rows[id(shown)] = self._bar.add_task(printable(shown.label), total=None, note="")

    def update(self, shown: Shown) -> None:
        count = f"{shown.done}/{shown.total}" if shown.total else ""
        note = printable("  ".join(part for part in (count, shown.note) if part))
        # a full bar stands still, and its clock too: what counts to its end may have more to do
        done = shown.done if shown.total is None else min(shown.done, _NEARLY * shown.total)
        self._bar.update(self._rows[id(shown)], completed=done, total=shown.total, note=note)

    def end(self, shown: Shown, failed: bool) -> None:
        self._bar.remove_task(self._rows.pop(id(shown)))
        if not failed:
            line = Text(f"  {printable(shown.label):<24} ").append(f"{shown.outcome():>8}", "dim")
            self.console.print(line, soft_wrap=True)

    def say(self, line: str) -> None:
        self.console.print(Text(printable(line)), soft_wrap=True)

    def running(self) -> AbstractContextManager[object]:
        return self._bar


class Together:
    """Several displays of the same run."""

    def __init__(self, *displays: Display) -> None:
        self._displays = displays

    def begin(self, shown: Shown) -> None:
        for display in self._displays:
            display.begin(shown)

    def update(self, shown: Shown) -> None:
        for display in self._displays:
            display.update(shown)

    def end(self, shown: Shown, failed: bool) -> None:
        for display in self._displays:
            display.end(shown, failed)

    def say(self, line: str) -> None:
        for display in self._displays:
            display.say(line)

    @contextmanager
    def running(self) -> Iterator[None]:
        with ExitStack() as stack:
            for display in self._displays:
                stack.enter_context(display.running())
            yield


def display_for(stream: TextIO | None = None, quiet: bool = False) -> Display:
    """The display that suits a stream; standard error when not given."""
    if quiet:
        return Silent()
    target = stream or sys.stderr
    console = Console(file=target)
    if target.isatty() and not console.is_dumb_terminal:
        return Live(console)
    return Together(lines_on(target), _artifacts())


def lines_on(stream: TextIO, first_s: float = 2.0) -> Plain:
    """Plain lines on a stream."""
    return Plain(lambda line: print(line, file=stream, flush=True), first_s)


def display_of_flow_run() -> Display:
    """The display of a flow run that nobody started by hand: lines in its own log, and progress artifacts."""
    from prefect.logging import get_run_logger

    logger = get_run_logger()
    return Together(Plain(lambda line: logger.info("%s", line)), _artifacts())


@contextmanager
def show_progress() -> Iterator[None]:
    """In a flow run: one that a server started tells of its steps in its log, a command has chosen its display."""
    if shown_to_somebody():
        yield
        return
    with showing(display_of_flow_run()):
        yield


def printable(line: str) -> str:
    """A line without what would move a terminal's cursor or colour it: the name of a file can hold anything."""
    return "".join(one if one.isprintable() or one in "\n\t" else "\N{REPLACEMENT CHARACTER}" for one in line)


def _artifacts() -> Display:
    from hfb.tasks.telemetry.progress_artifacts import Artifacts

    return Artifacts()
