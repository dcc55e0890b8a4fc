"""What tasks say about how far they are: the step they are in, how much of it is done, a line now and then.

Everything goes to standard error; standard output is for results. Whoever starts a run chooses the display with
``showing`` (see tasks/telemetry/displays.py). Tasks call ``step``, ``advance`` and ``say``, which do nothing without
a display.
Light to import.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Protocol

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
        return time.monotonic() - self.began

    def outcome(self) -> str:
        return "reused" if self.reused else f"{self.seconds:.1f} s"


class Display(Protocol):
    """Where steps are shown. Any thread may call; steps may lie within each other."""

    def begin(self, shown: Shown) -> None: ...
    def update(self, shown: Shown) -> None: ...
    def end(self, shown: Shown, failed: bool) -> None: ...
    def say(self, line: str) -> None: ...
    def running(self) -> AbstractContextManager[object]: ...


class Listener(Protocol):
    """Who hears of every step beside the display. Any thread may call."""

    def begin(self, shown: Shown) -> None: ...
    def update(self, shown: Shown) -> None: ...
    def end(self, shown: Shown, failed: bool) -> None: ...
    def fail(self, step: str, reason: str) -> None: ...


# One for the whole process, not one per context: threads that libraries start log too, and nothing is to be swallowed.
_displays: list[Display] = []
_listeners: list[Listener] = []
_step: ContextVar[tuple[Shown, Display | None] | None] = ContextVar("step", default=None)


def shown_to_somebody() -> bool:
    """Whether a display was chosen."""
    return bool(_displays)


@contextmanager
def showing(display: Display) -> Iterator[None]:
    """Show the steps inside on a display."""
    _displays.append(display)
    try:
        with display.running():
            yield
    finally:
        _displays.remove(display)


@contextmanager
def add_listener(listener: Listener) -> Iterator[None]:
    """Somebody hears of the steps inside."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


@contextmanager
def step(label: str) -> Iterator[Shown]:
    """One step of a run, from here to the end of the block."""
    display, shown = _display(), Shown(label)
    token = _step.set((shown, display))
    for one in _audience(display):
        one.begin(shown)
    failed = True
    try:
        yield shown
        failed = False
    finally:
        for one in _audience(display):
            one.end(shown, failed)
        _step.reset(token)


def advance(done: int, total: int, note: str = "") -> None:
    """How far the current step is."""
    current = _step.get()
    if current is not None:
        shown, display = current
        shown.done, shown.total, shown.note = done, total, note
        for one in _audience(display):
            one.update(shown)


def fail(reason: str) -> None:
    """One of the current step's inputs failed; the step goes on."""
    current = _step.get()
    for listener in _listeners:
        listener.fail(current[0].label if current else "", reason)


def say(line: str) -> None:
    """A line for the person who waits."""
    display = _display()
    if display is not None:
        display.say(without_secrets(line))


def _audience(display: Display | None) -> list[Display | Listener]:
    return [*([display] if display is not None else []), *_listeners]


def _display() -> Display | None:
    return _displays[-1] if _displays else None
