"""Progress of tasks: the current step, how much of it is done, and lines for the user.

Everything goes to standard error; standard output is for results. The caller of a run chooses the displays with
``showing`` (see tasks/telemetry/displays.py). Tasks call ``step``, ``advance`` and ``say``, which do nothing without
a display.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field

from hfb.tasks.telemetry.secrets import without_secrets


@dataclass(eq=False)
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
        """Seconds since the step began."""
        return time.monotonic() - self.began

    def outcome(self) -> str:
        """Return the outcome in a few characters."""
        return "reused" if self.reused else f"{self.seconds:.1f} s"


class StepObserver:
    """Observer of every step; it does nothing. Any thread may call; steps may be nested."""

    def begin(self, shown: Shown) -> None:
        """Observe a new step.

        Args:
            shown: the step.
        """

    def update(self, shown: Shown) -> None:
        """Observe the progress of a step.

        Args:
            shown: the step.
        """

    def end(self, shown: Shown, failed: bool) -> None:
        """Observe the end of a step.

        Args:
            shown: the step.
            failed: whether it raised.
        """


class Display(StepObserver):
    """Display of steps and lines; it shows nothing."""

    def say(self, line: str) -> None:
        """Show a line.

        Args:
            line: text without secrets.
        """

    def running(self) -> AbstractContextManager[object]:
        """Keep the display up inside the block."""
        return nullcontext()


class Listener(StepObserver):
    """Observer of steps and failed inputs."""

    def fail(self, step: str, reason: str) -> None:
        """Observe a failed input of a step.

        Args:
            step: its label.
            reason: kind of the failure.
        """


# One for the whole process, not one per context: threads that libraries start log too, and nothing is to be swallowed.
_displays: list[tuple[Display, ...]] = []
_listeners: list[Listener] = []
_step: ContextVar[tuple[Shown, tuple[Display, ...]] | None] = ContextVar("step", default=None)


def shown_to_somebody() -> bool:
    """Return whether displays were chosen."""
    return bool(_displays)


@contextmanager
def showing(*displays: Display) -> Iterator[None]:
    """Show the steps inside the block on some displays.

    Args:
        *displays: where they are shown.
    """
    _displays.append(displays)
    try:
        with ExitStack() as stack:
            for display in displays:
                stack.enter_context(display.running())
            yield
    finally:
        _displays.remove(displays)


@contextmanager
def add_listener(listener: Listener) -> Iterator[None]:
    """Pass the steps inside the block to an observer.

    Args:
        listener: the observer.
    """
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


@contextmanager
def step(label: str) -> Iterator[Shown]:
    """Show a step of a run, which lasts as long as the block.

    Args:
        label: as displayed.
    """
    displays, shown = _chosen(), Shown(label)
    token = _step.set((shown, displays))
    for one in (*displays, *_listeners):
        one.begin(shown)
    failed = True
    try:
        yield shown
        failed = False
    finally:
        for one in (*displays, *_listeners):
            one.end(shown, failed)
        _step.reset(token)


def advance(done: int, total: int, note: str = "") -> None:
    """Set the progress of the current step.

    Args:
        done: finished inputs.
        total: number of inputs.
        note: short text behind the count.
    """
    current = _step.get()
    if current is not None:
        shown, displays = current
        shown.done, shown.total, shown.note = done, total, note
        for one in (*displays, *_listeners):
            one.update(shown)


def fail(reason: str) -> None:
    """Report that an input of the current step failed; the step goes on.

    Args:
        reason: kind of the failure.
    """
    current = _step.get()
    for listener in _listeners:
        listener.fail(current[0].label if current else "", reason)


def say(line: str) -> None:
    """Show a line to the user.

    Args:
        line: secrets in it are hidden.
    """
    for display in _chosen():
        display.say(without_secrets(line))


def _chosen() -> tuple[Display, ...]:
    return _displays[-1] if _displays else ()
