"""What a run needs around it: a Prefect server and a log."""

from __future__ import annotations

import logging
import logging.handlers
import os
import subprocess
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

import platformdirs

from hfb.errors import InputError
from tasks import progress

if TYPE_CHECKING:
    from prefect.server.api.server import SubprocessASGIServer

_HEALTH_TIMEOUT_S = 3
_LOG_BYTES = 2_000_000


def log_path() -> Path:
    """The log of all runs of this user."""
    return Path(platformdirs.user_log_path("hfb")) / "hfb.log"


def keep_log(verbose: bool = False) -> None:
    """Everything into the log file, warnings also to the person; Prefect's own lines only when asked for.

    Has to come before Prefect is imported: it leaves handlers alone that it finds.
    """
    root = logging.getLogger()
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)
    for chatty in ("httpx", "alembic"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    for handler in (_file_handler(), _Telling(verbose)):
        if handler is not None:
            handler.setFormatter(logging.Formatter("%(asctime)s %(process)d %(levelname)s %(name)s: %(message)s"))
            root.addHandler(handler)


class PrefectServer:
    """The server of this process: the one that the user set, or a temporary one that starts in the background.

    The temporary one takes seconds; meanwhile this process can import and compute. Only the waiting happens in
    a thread: two threads that import the same libraries can meet half-initialised modules.
    """

    def __init__(self) -> None:
        """Raises InputError when the server that the user set does not answer."""
        from prefect.settings import get_current_settings

        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None
        api = get_current_settings().api.url
        if api:
            _check_prefect(api)
        else:
            server = _temporary_server()
            self._thread = threading.Thread(target=self._start, args=(server,), name="hfb-prefect", daemon=True)
            self._thread.start()

    def wait(self) -> None:
        """Return when the server answers."""
        if self._thread is not None:
            self._thread.join()
        if self._error is not None:
            raise self._error

    def _start(self, server: SubprocessASGIServer) -> None:
        try:
            server.start()
        except Exception as error:
            self._error = error


def _temporary_server() -> SubprocessASGIServer:
    from prefect.server.api.server import SubprocessASGIServer

    class Watched(SubprocessASGIServer):
        """Prefect's own, but it ends with this process even after kill -9."""

        def _run_uvicorn_command(self) -> subprocess.Popen[Any]:
            process: subprocess.Popen[Any] = super()._run_uvicorn_command()
            _end_with_this_process(process.pid)
            return process

    return Watched()  # Prefect keeps one per process and finds this one


def _check_prefect(api: str) -> None:
    try:
        with urlopen(f"{api.rstrip('/')}/health", timeout=_HEALTH_TIMEOUT_S):
            return
    except HTTPError as error:
        if error.code in (401, 403):  # it is there and asks for a login
            return
        reason = f"answers {error.code}"
    except (URLError, OSError) as error:
        reason = f"does not answer ({getattr(error, 'reason', error)})"
    raise InputError(f"the Prefect server at {api} {reason}: start it, or unset PREFECT_API_URL for a temporary one")


def _end_with_this_process(server_pid: int) -> None:
    """End the temporary server even after kill -9: Prefect's own clean-up would not run then.

    The watcher reads a pipe that only this process holds open; the read ends when the process does.
    """
    reading, _stays_open = os.pipe()
    subprocess.Popen(
        ["/bin/sh", "-c", f"read -r _; kill {server_pid} 2>/dev/null"],
        stdin=reading,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for this process; the watcher outlives it
    )
    os.close(reading)


class _Telling(logging.Handler):
    """Warnings to the person who waits, through the display, so that no bar swallows them."""

    def __init__(self, verbose: bool) -> None:
        super().__init__(logging.INFO if verbose else logging.WARNING)
        self._verbose = verbose

    def emit(self, record: logging.LogRecord) -> None:
        # What fails inside a task surfaces as an exception; Prefect's account of it is for the log.
        if self._verbose or not record.name.startswith(("prefect", "py.warnings", "alembic", "mlflow")):
            progress.say(f"{record.levelname.lower()}: {record.getMessage()}")


def _file_handler() -> logging.Handler | None:
    try:
        log_path().parent.mkdir(parents=True, exist_ok=True)
        return logging.handlers.RotatingFileHandler(log_path(), maxBytes=_LOG_BYTES, backupCount=2, encoding="utf-8")
    except OSError:  # a read-only home must not stop a run
        return None
