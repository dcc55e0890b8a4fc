"""Timing several things in turn, so that what slows the machine down for a while slows down all of them."""

import itertools
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Times:
    """What one subject took, a number per round.

    Attributes:
        seconds: on the wall's clock. cpu_seconds: of all its threads on the processors: for one thread the same where
            nothing else runs, and what it costs where something does.
    """

    seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]

    @property
    def best(self) -> float:
        """The round that was disturbed least."""
        return min(self.seconds)

    @property
    def best_cpu(self) -> float:
        """The least that it cost the processors."""
        return min(self.cpu_seconds)

    @property
    def median(self) -> float:
        """On this machine, as busy as it was."""
        return statistics.median(self.seconds)

    def __str__(self) -> str:
        rounds = f"{len(self.seconds)} round{'s' * (len(self.seconds) > 1)}"
        return f"{_short(self.best)} ({_short(self.best_cpu)} of CPU; median {_short(self.median)}, {rounds})"


def _short(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1 else f"{seconds * 1e3:.2f} ms"


def together(*times: Times) -> Times:
    """All rounds of one subject."""
    return Times(tuple(s for one in times for s in one.seconds), tuple(s for one in times for s in one.cpu_seconds))


def clock() -> tuple[float, float]:
    """Now: (wall, CPU of this process)."""
    return time.perf_counter(), time.process_time()


def between(stamps: Sequence[tuple[float, float]]) -> Times:
    """From each of `clock`'s readings to the next."""
    pairs = list(itertools.pairwise(stamps))
    return Times(*(tuple(after[k] - before[k] for before, after in pairs) for k in (0, 1)))


def interleaved(subjects: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Times]:
    """Call each subject once unrecorded, then all in turn for so many rounds, every other round in reverse."""
    for subject in subjects.values():
        subject()
    found: dict[str, list[Times]] = {name: [] for name in subjects}
    for number in range(rounds):
        order = list(subjects.items())
        for name, subject in order if number % 2 == 0 else reversed(order):
            began = clock()
            subject()
            found[name].append(between([began, clock()]))
    return {name: together(*times) for name, times in found.items()}
