"""Names, times and progress of the stages of a fit."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_log = logging.getLogger(__name__)

Progress = Callable[[int, int, str], None]
"""Called with the iterations done, their total, and the stage's name, with the loss once it is known."""


class StageClock:
    """Times every stage by its name, logs it, and reports progress.

    Attributes:
        seconds: wall time per stage, in the order of the schedule.
    """

    def __init__(self, n_iterations: int, on_progress: Progress | None) -> None:
        """Start with no stage.

        Args:
            n_iterations: number of iterations of all image stages together.
            on_progress: called at the beginning of a stage and after every iteration.
        """
        self.seconds: dict[str, float] = {}
        self._n_iterations = n_iterations
        self._done = 0
        self._name = ""
        self._on_progress = on_progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the work inside as one stage.

        Args:
            name: name such as `stage_1`.
        """
        self._name = name
        self._report(name.replace("_", " "))
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = time.perf_counter() - started
            _log.debug("fit stage %s: %.2f s", name, self.seconds[name])

    def inner(self, prefix: str) -> "StageClock":
        """Return a clock for stages inside the current one, whose iterations count here.

        Args:
            prefix: of what it reports.
        """
        done = self._done

        def report(inner_done: int, _: int, note: str) -> None:
            if self._on_progress:
                self._on_progress(done + inner_done, self._n_iterations, prefix + note)

        return StageClock(self._n_iterations, report)

    def advance(self, n_iterations: int, loss: float) -> None:
        """Report iterations that are done.

        Args:
            n_iterations: since the last call.
            loss: the last iteration's.
        """
        self._done += n_iterations
        self._report(f"{self._name.replace('_', ' ')}, loss {loss:.4f}")

    def skip(self, n_iterations: int) -> None:
        """Count iterations that a stage ends without.

        Args:
            n_iterations: number of iterations that are left out.
        """
        self._done += n_iterations

    def _report(self, note: str) -> None:
        if self._on_progress:
            self._on_progress(self._done, self._n_iterations, note)
