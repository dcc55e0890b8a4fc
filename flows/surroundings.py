"""What a run needs around it: a Prefect server and a log."""

from __future__ import annotations

import atexit
import fcntl
import logging
import logging.handlers
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import urlopen

import platformdirs

from hfb.errors import InputError
from tasks import progress
from tasks.secrets import SecretFormatter, shown_address, without_login, without_secrets
from tasks.structured_log import JsonFormatter, WithIds

LOG_VARIABLE = "HFB_LOG"
_HEALTH_TIMEOUT_S = 3
_LOG_BYTES = 2_000_000


def log_path() -> Path:
    """The log of all runs of this user."""
    return Path(platformdirs.user_log_path("hfb")) / "hfb.log"


def _server_log() -> Path:
    return log_path().with_name("prefect-server.log")


def keep_log(verbose: bool = False) -> None:
    """Everything into the log file, warnings also to the person; Prefect's own lines only when asked for.

    With HFB_LOG=json the file has one JSON object per line; see tasks/structured_log.py.

    Has to come before Prefect is imported: it leaves handlers alone that it finds.
    """
    root = logging.getLogger()
    if any(isinstance(handler, _Telling) for handler in root.handlers):
        return
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)
    for chatty in ("httpx", "alembic"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    for handler in (_file_handler(), _Telling(verbose)):
        if handler is not None:
            handler.setFormatter(
                JsonFormatter()
                if os.environ.get(LOG_VARIABLE) == "json"
                else SecretFormatter("%(asctime)s %(process)d %(levelname)s %(name)s: %(message)s")
            )
            handler.addFilter(WithIds())
            root.addHandler(handler)


class PrefectServer:
    """The server of this process's flows: the one that the user set, or a temporary one that ends with it.

    Prefect would start a temporary one by itself, on first use and while everything waits; it would load the
    whole server into this process too, and leave it running after kill -9. Here it starts beside the imports.
    """

    def __init__(self) -> None:
        """Raises InputError when the server that the user set does not answer."""
        from prefect.context import refresh_global_settings_context
        from prefect.settings import get_current_settings

        settings = get_current_settings()
        self._process: subprocess.Popen[bytes] | None = None
        self._first: FirstStart | None = None
        self._patience_s = settings.server.ephemeral.startup_timeout_seconds
        self._api = settings.api.url or f"http://127.0.0.1:{_free_port()}/api"
        if settings.api.url:
            reason = does_not_answer(self._api)
            if reason:
                raise InputError(
                    f"the Prefect server at {shown_address(self._api)} {reason}: "
                    "start it, or unset PREFECT_API_URL for a temporary one"
                )
        else:
            self._first = FirstStart(Path(settings.home))
            self._process = _start_server(self._api, settings.to_environment_variables(exclude_unset=True))
            os.environ["PREFECT_API_URL"] = self._api
            refresh_global_settings_context()

    def wait(self) -> None:
        """Return when the server answers."""
        try:
            self._wait()
            if self._first is not None:
                self._first.there_are_tables()
        finally:
            if self._first is not None:
                self._first.let_go()

    def _wait(self) -> None:
        began = time.monotonic()
        while self._process is not None and (reason := does_not_answer(self._api)):
            ended = self._process.poll() is not None
            if ended or time.monotonic() - began > self._patience_s:
                state = "ended" if ended else reason
                raise RuntimeError(f"the temporary Prefect server {state}; its own log is {_server_log()}")
            time.sleep(0.05)


class FirstStart:
    """The first server of a version makes the tables of its database; two at once would be in each other's way.

    Held from before a temporary server starts until it answers; free for whoever comes when there are tables.
    """

    def __init__(self, home: Path) -> None:
        from prefect import __version__

        home.mkdir(parents=True, exist_ok=True)
        self._done = home / f".hfb-tables-{__version__}"
        self._lock = None if self._done.exists() else (home / ".hfb-tables.lock").open("w")
        if self._lock is not None:
            fcntl.flock(self._lock, fcntl.LOCK_EX)
            if self._done.exists():  # made while this one waited
                self.let_go()

    def there_are_tables(self) -> None:
        """The server answers."""
        if self._lock is not None:
            self._done.touch()
            self.let_go()

    def let_go(self) -> None:
        """The next one may try."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _start_server(api: str, settings: dict[str, str]) -> subprocess.Popen[bytes]:
    temporary = {"PREFECT_UI_ENABLED": "0", "PREFECT__SERVER_EPHEMERAL": "1", "PREFECT__SERVER_FINAL": "1"}
    _server_log().parent.mkdir(parents=True, exist_ok=True)
    with _server_log().open("wb") as log:
        process = subprocess.Popen(
            [
                sys.executable, "-m", "uvicorn", "--factory", "prefect.server.api.server:create_app",
                "--host", "127.0.0.1", "--port", str(urlsplit(api).port), "--log-level", "error", "--lifespan", "on",
            ],
            env={**os.environ, **settings, **temporary},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for this process, which still has to tell the server
        )  # fmt: skip
    _end_with_this_process(process.pid)
    atexit.register(_end, process)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def does_not_answer(api: str, patience_s: float = _HEALTH_TIMEOUT_S) -> str | None:
    """Why a server is of no use, or None where it answers."""
    try:
        with urlopen(f"{without_login(api).rstrip('/')}/health", timeout=patience_s):
            return None
    except HTTPError as error:
        # one that asks for a login is there
        return None if error.code in (401, 403) else f"answers {error.code}"
    except (URLError, OSError) as error:
        return f"does not answer ({getattr(error, 'reason', error)})"


def _end_with_this_process(server_pid: int) -> None:
    """End the temporary server even after kill -9, when nothing of this process runs any more.

    The watcher reads a pipe that only this process holds open; the read ends when the process does.
    """
    reading, _stays_open = os.pipe()
    subprocess.Popen(
        ["/bin/sh", "-c", f"read -r _; kill {server_pid} 2>/dev/null"],
        stdin=reading,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # it outlives this process
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
            progress.say(without_secrets(f"{record.levelname.lower()}: {record.getMessage()}"))


def _file_handler() -> logging.Handler | None:
    try:
        log_path().parent.mkdir(parents=True, exist_ok=True)
        return logging.handlers.RotatingFileHandler(log_path(), maxBytes=_LOG_BYTES, backupCount=2, encoding="utf-8")
    except OSError:  # a read-only home must not stop a run
        return None
