"""Bounded waiting for servers. Light to import.

Client libraries bound a single read or connection attempt, and then retry; a server that hangs costs minutes. Here the
wall clock counts.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

TOTAL_S = 24.0
CALL_S = 16.0
_ANOTHER_TRY_S = 6.0
_SHORTEST_S = 0.5


def within(seconds: float, action: Callable[[], T]) -> T:
    """Return the result of a call, or raise its exception; a call that takes longer is left to end by itself.

    Args:
        seconds: to wait.
        action: the call.

    Raises:
        TimeoutError: it did not end in time.
    """
    results: list[T] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            results.append(action())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=work, daemon=True, name="bounded call")
    thread.start()
    thread.join(seconds)
    if errors:
        raise errors[0]
    if not results:
        raise TimeoutError(f"no answer within {seconds:.0f} s")
    return results[0]


class Patience:
    """The total time that failing calls may take; a successful call renews it."""

    def __init__(self, total_s: float = TOTAL_S, call_s: float = CALL_S) -> None:
        """Begin with all the time.

        Args:
            total_s: for all failing calls together.
            call_s: for one call.
        """
        self._total_s, self._call_s = total_s, call_s
        self._left_s = total_s
        self._lock = threading.Lock()

    def call(self, action: Callable[[], T], least_s: float = 0.0) -> T:
        """Run an action as `within` does, for as long as time remains.

        Args:
            action: the call.
            least_s: time that the action may take in any case, such as for an upload of a large file.

        Raises:
            TimeoutError: it took too long, or earlier calls have used up the time.
        """
        limit_s = min(self._call_s, self._left_s)
        if limit_s < _SHORTEST_S:
            raise TimeoutError("it did not answer before")
        began = time.monotonic()
        try:
            result = within(max(limit_s, least_s), action)
        except Exception:
            with self._lock:
                self._left_s -= time.monotonic() - began
            raise
        with self._lock:
            self._left_s = self._total_s
        return result

    def another_try(self) -> None:
        """Allow a short wait for the next run, also where an earlier one has used up the time."""
        with self._lock:
            self._left_s = max(self._left_s, _ANOTHER_TRY_S)
