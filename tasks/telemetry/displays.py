"""Displays of a run's progress: a live line on a terminal, otherwise periodic plain lines.

Without a terminal, progress artifacts of the flow run show it in Prefect's pages, too.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from hfb.tasks.telemetry.progress import Display, Shown, showing, shown_to_somebody
from hfb.tasks.telemetry.progress_artifacts import Artifacts

_OFTEN_S, _SELDOM_S, _LONG_S = 10.0, 60.0, 300.0
_NEARLY = 1 - 1e-6


class Plain(Display):
    """For logs and pipes: a line when a step ends, and its progress after 2, 3, 5, 7, 10 ... seconds."""

    def __init__(self, write: Callable[[str], None], first_s: float = 2.0) -> None:
        """Begin without steps.

        Args:
            write: prints a line.
            first_s: seconds before a step's first line.
        """
        self._write = write
        self._first_s = first_s
        self._steps: list[Shown] = []
        self._stop = threading.Event()

    def begin(self, shown: Shown) -> None:
        """Add the step.

        Args:
            shown: the step.
        """
        self._steps.append(shown)

    # `update` does nothing: the watching thread reads the step when its time comes.

    def end(self, shown: Shown, failed: bool) -> None:
        """Remove the step and print its outcome.

        Args:
            shown: the step.
            failed: whether it raised.
        """
        self._steps.remove(shown)
        if not failed:
            self.say(f"{shown.label}: {shown.outcome()}")

    def say(self, line: str) -> None:
        """Print a line.

        Args:
            line: text without secrets.
        """
        self._write(printable(line))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the watching thread."""
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


class Live(Display):
    """For a terminal: a spinner and a bar that give way to finished lines and to log lines."""

    def __init__(self, console: Console) -> None:
        """Begin without steps.

        Args:
            console: of the terminal.
        """
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
        """Add a row for the step.

        Args:
            shown: the step.
        """
        self._rows[id(shown)] = self._bar.add_task(printable(shown.label), total=None, note="")

    def update(self, shown: Shown) -> None:
        """Redraw the step's row.

        Args:
            shown: the step.
        """
        count = f"{shown.done}/{shown.total}" if shown.total else ""
        note = printable("  ".join(part for part in (count, shown.note) if part))
        # a full bar stands still, and its clock too: what counts to its end may have more to do
        done = shown.done if shown.total is None else min(shown.done, _NEARLY * shown.total)
        self._bar.update(self._rows[id(shown)], completed=done, total=shown.total, note=note)

    def end(self, shown: Shown, failed: bool) -> None:
        """Replace the step's row by its outcome.

        Args:
            shown: the step.
            failed: whether it raised.
        """
        self._bar.remove_task(self._rows.pop(id(shown)))
        if not failed:
            line = Text(f"  {printable(shown.label):<24} ").append(f"{shown.outcome():>8}", "dim")
            self.console.print(line, soft_wrap=True)

    def say(self, line: str) -> None:
        """Print a line above the rows.

        Args:
            line: text without secrets.
        """
        self.console.print(Text(printable(line)), soft_wrap=True)

    def running(self) -> AbstractContextManager[object]:
        """Draw the rows."""
        return self._bar


def displays_for(stream: TextIO | None = None, quiet: bool = False) -> tuple[Display, ...]:
    """Return the displays that suit a stream.

    Args:
        stream: standard error where None.
        quiet: shows nothing.
    """
    if quiet:
        return (Display(),)
    target = stream or sys.stderr
    console = Console(file=target)
    if target.isatty() and not console.is_dumb_terminal:
        return (Live(console),)
    return lines_on(target), Artifacts()


def lines_on(stream: TextIO, first_s: float = 2.0) -> Plain:
    """Return a display of plain lines on a stream.

    Args:
        stream: where lines go.
        first_s: seconds before a step's first line.
    """
    return Plain(lambda line: print(line, file=stream, flush=True), first_s)


@contextmanager
def show_progress() -> Iterator[None]:
    """Show progress inside a flow run that a server started: lines in its log, and progress artifacts.

    A command has chosen its displays already.
    """
    if shown_to_somebody():
        yield
        return
    from prefect.logging import get_run_logger

    logger = get_run_logger()
    with showing(Plain(lambda line: logger.info("%s", line)), Artifacts()):
        yield


def printable(line: str) -> str:
    """Replace characters that would move a terminal's cursor or colour it: a file's name can hold anything.

    Args:
        line: the text.
    """
    return "".join(one if one.isprintable() or one in "\n\t" else "\N{REPLACEMENT CHARACTER}" for one in line)
