"""Failures of a run's surroundings, each reported as one sentence that names the fix."""

from __future__ import annotations

import errno
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
from prefect.exceptions import PrefectHTTPStatusError, TerminationSignal
from prefect.settings import PREFECT_API_URL

from hfb.errors import InfrastructureError, InputError, ServerLost
from hfb.flows.runtime.server import does_not_answer
from hfb.tasks.core.handles import StaleFile
from hfb.tasks.telemetry.secrets import shown_address
from hfb.tasks.workers.engine import WorkerLost

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS}
_GOES_ON = "what is finished is kept, and the same command goes on from there"
_SERVER_ERROR = 500
_ASK_EVERY_S = 5.0
_PATIENCE_S = (3.0, 10.0, 30.0)  # a busy server may take its time


@contextmanager
def explain_failures(out: Path) -> Iterator[None]:
    """Turn failures of disk, server and store inside the block into `InfrastructureError`; other exceptions pass.

    Prefect may fail when it is stopped while it writes a task's state: this is reported as the end of the command, not
    as a failure of the clip.

    Args:
        out: where the results go.
    """
    try:
        yield
    except (InputError, InfrastructureError):
        raise
    except Exception as error:
        if end := next(filter(None, map(_end, _causes(error))), None):
            raise end from error
        if any(isinstance(one, httpx.TransportError) for one in _causes(error)):
            raise _server_lost() from error
        sentence = next((told for one in _causes(error) if (told := _sentence(one, out))), None)
        if sentence is None:
            raise
        raise InfrastructureError(f"{sentence}; {_GOES_ON}") from error


class ServerWatch:
    """Checks periodically whether Prefect's server still answers.

    Tasks would go on without it, each report retried for seconds, and the end of the flow could not be reported.
    """

    def __init__(self) -> None:
        self._asked = time.monotonic()

    def look(self) -> None:
        """Raise ServerLost if the server has gone; asks at most every few seconds."""
        if time.monotonic() - self._asked >= _ASK_EVERY_S:
            ask_server()
            self._asked = time.monotonic()


def ask_server() -> None:
    """Raise ServerLost if Prefect's server has gone."""
    if all(does_not_answer(str(PREFECT_API_URL.value()), patience_s) for patience_s in _PATIENCE_S):
        raise _server_lost()


def _end(cause: BaseException) -> BaseException | None:
    """Return the exception that ends a command after a signal, if a signal is the cause."""
    if isinstance(cause, TerminationSignal):
        return SystemExit(128 + cause.signal)
    return type(cause)(*cause.args) if isinstance(cause, KeyboardInterrupt | SystemExit) else None


def _server_lost() -> ServerLost:
    return ServerLost(f"the Prefect server at {_server()} no longer answers: start it again; {_GOES_ON}")


def _server() -> str:
    return shown_address(str(PREFECT_API_URL.value()))


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an exception and its causes, each once."""
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        seen.add(id(current))
        yield current
        current = current.__cause__ or current.__context__


def _sentence(error: BaseException, out: Path) -> str | None:
    if isinstance(error, OSError) and error.errno in _FULL:
        where = error.filename or out
        return f"the disk is full, {where} could not be written ({error.strerror}): free some space"
    if isinstance(error, OSError) and error.errno in _FORBIDDEN:
        where = f"{error.filename or out} may not be opened or changed ({error.strerror})"
        return f"{where}: see to whose it is, or choose another --out"
    if isinstance(error, sqlite3.OperationalError) and "full" in str(error):
        return f"the disk is full ({error}): free some space"
    if isinstance(error, PrefectHTTPStatusError) and error.response.status_code >= _SERVER_ERROR:
        return f"the Prefect server at {_server()} answers {error.response.status_code}: see its log"
    if isinstance(error, StaleFile):
        return f"a file was changed or removed while it was needed ({error})"
    if isinstance(error, WorkerLost):
        return str(error)
    return None
