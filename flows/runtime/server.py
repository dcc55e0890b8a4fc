"""The surroundings of a run: a Prefect server and a log."""

from __future__ import annotations

import atexit
import io
import logging
import logging.handlers
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from contextlib import AbstractContextManager, redirect_stderr
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import platformdirs

from hfb.errors import InfrastructureError, InputError
from hfb.flows.runtime.prefect_database import PrefectDatabase
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.secrets import SecretFormatter, shown_address, without_secrets
from hfb.tasks.telemetry.structured_log import JsonFormatter, WithIds
from hfb.tasks.tracking.addresses import check_address, no_answer

LOG_VARIABLE = "HFB_LOG"
_EXAMPLE = "http://127.0.0.1:4200/api"
_HEALTH_TIMEOUT_S = 3
_READ_TIMEOUT_S = 60  # a new server is busy with its own start
_SERVER_ERROR = 500
_FULL = re.compile(r"disk is full|No space left|File too large")
_LOG_BYTES = 2_000_000
_NEEDED_BYTES = 1 << 20  # of a new database
# Searching its imports for garbage would take three tenths of the time until the server answers.
_SERVE = "import gc; gc.disable(); import prefect.server.api.server, uvicorn; gc.freeze(); gc.enable(); uvicorn.main()"


def log_path() -> Path:
    """Return the path of the log of all this user's runs."""
    return Path(platformdirs.user_log_path("hfb")) / "hfb.log"


def keep_log(verbose: bool = False) -> None:
    """Log everything to the log file, warnings also to the display; Prefect's own lines only when verbose.

    With HFB_LOG=json the file has one JSON object per line; see tasks/telemetry/structured_log.py. Must be called
    before Prefect is imported, which keeps existing handlers.

    Args:
        verbose: whether to display Prefect's lines.
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


def check_api_url() -> None:
    """Raise InputError if PREFECT_API_URL is no address of a server."""
    if url := os.environ.get("PREFECT_API_URL"):
        check_address("PREFECT_API_URL", url, _EXAMPLE)


def load_prefect() -> None:
    """Import Prefect, which reads its settings.

    Raises:
        InputError: a setting, in the environment or in the user's profiles, cannot be used.
    """
    said = io.StringIO()  # Prefect prints pydantic's lines before it fails
    try:
        with redirect_stderr(said):
            import prefect.main  # noqa: F401
            from prefect.settings import get_current_settings

            get_current_settings()
        from hfb.tasks.core.result_records import read_own_records_alone

        read_own_records_alone()
        sys.stderr.write(said.getvalue())
    except (ValueError, TypeError, OSError) as error:  # of pydantic, of TOML, of a file that cannot be read
        reason = "; ".join(line.strip() for line in str(error).splitlines()[1:3]) or str(error)
        raise InputError(
            f"Prefect's settings cannot be used ({without_secrets(reason)}): mend the PREFECT_... variable or "
            f"{os.environ['PREFECT_PROFILES_PATH']}"
        ) from error


class PrefectServer:
    """The server of this process's flows: the user's, or a temporary one that ends with the process.

    Prefect would start a temporary one on first use, while everything waits; it would load the whole server into this
    process, too, and leave it running after a kill. Here it starts during the imports.
    """

    lent = ""  # the address of a temporary server that another process of hfb keeps for this one

    def __init__(self) -> None:
        """Start the server. Raises InputError when the user's server does not answer."""
        from prefect.context import refresh_global_settings_context
        from prefect.settings import get_current_settings

        settings = get_current_settings()
        self._process: subprocess.Popen[bytes] | None = None
        self._database: PrefectDatabase | None = None
        self._patience_s = settings.server.ephemeral.startup_timeout_seconds
        self._api = settings.api.url or f"http://127.0.0.1:{_free_port()}/api"
        if settings.api.url:
            check_address("PREFECT_API_URL", self._api, _EXAMPLE)
            reason = does_not_answer(self._api)
            if reason:
                raise InputError(
                    f"the Prefect server at {shown_address(self._api)} {reason}: "
                    "start it, or unset PREFECT_API_URL for a temporary one"
                )
        else:
            self._home = Path(settings.home)
            self._home.mkdir(parents=True, exist_ok=True)
            self._database = PrefectDatabase(self._home, progress.say)
            self._settings = settings.to_environment_variables(exclude_unset=True)
            self._start(self._database)
            os.environ["PREFECT_API_URL"] = self._api
            refresh_global_settings_context()

    def quiet(self) -> AbstractContextManager[object]:
        """Return a context whose runs send no heartbeats to a temporary server, where nobody reads them."""
        from prefect.settings import PREFECT_FLOWS_HEARTBEAT_FREQUENCY, temporary_settings

        # At a run's end Prefect (3.8.8) waits for the thread that sends them, which sleeps a second at a time.
        is_temporary = self._database is not None or self._api == self.lent
        return temporary_settings({PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None} if is_temporary else {})

    def wait(self) -> None:
        """Return when the server answers, with a new database if it cannot work with the existing one."""
        if self._database is None:
            return
        try:
            reason = self._trouble()
            if reason and self._is_about_database():
                assert self._process is not None
                _end(self._process)
                self._database.set_aside("cannot be used")
                self._start(self._database)
                reason = self._trouble()
            if reason:
                full = ": the disk is full, free some space or set XDG_STATE_HOME" if self._is_full() else ""
                raise InfrastructureError(f"the temporary Prefect server {reason}{full}; its own log is {self._log}")
        finally:
            self._database.let_go()

    @property
    def _log(self) -> Path:
        return self._home / "server.log"

    def _start(self, database: PrefectDatabase) -> None:
        self._process = _start_server(self._api, database.url, self._settings, self._log)

    def _trouble(self) -> str | None:
        """Return why the temporary server does not work; None as soon as it does."""
        assert self._process is not None
        began = time.monotonic()
        while reason := does_not_answer(self._api):
            if self._process.poll() is not None:
                return "ended"
            if time.monotonic() - began > self._patience_s:
                return reason
            time.sleep(0.05)
        return _cannot_read_runs(self._api)

    def _is_about_database(self) -> bool:
        """Return whether the server's log blames its database, and neither a full disk nor another process."""
        said = self._said()
        full_or_busy = _FULL.search(said) or "database is locked" in said
        return re.search(r"sqlite3\.|sqlalchemy|alembic", said) is not None and not full_or_busy

    def _is_full(self) -> bool:
        """Return whether the disk is full; the log lies on it, too, and may say nothing."""
        return bool(_FULL.search(self._said())) or shutil.disk_usage(self._home).free < _NEEDED_BYTES

    def _said(self) -> str:
        return self._log.read_text(errors="replace")


def _start_server(api: str, database: str, settings: dict[str, str], log_path: Path) -> subprocess.Popen[bytes]:
    temporary = {
        "PREFECT_UI_ENABLED": "0",
        "PREFECT__SERVER_EPHEMERAL": "1",
        "PREFECT__SERVER_FINAL": "1",
        "PREFECT_SERVER_SERVICES_EVENT_PERSISTER_ENABLED": "false",  # nobody reads them, and they fill the database
        "PREFECT_SERVER_DATABASE_CONNECTION_URL": database,
        "PREFECT_SERVER_DATABASE_MIGRATE_ON_START": "true",
    }
    command = [sys.executable, "-P", "-c", _SERVE, "--factory", "prefect.server.api.server:create_app"]
    command += ["--host", "127.0.0.1", "--port", str(urlsplit(api).port), "--log-level", "error", "--lifespan", "on"]
    with log_path.open("wb") as log:
        process = subprocess.Popen(
            command,
            env={**os.environ, **settings, **temporary},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for this process, which still has to tell the server
        )
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
    """Return why a server is unusable, or None where it answers.

    Args:
        api: address of its API.
        patience_s: for the whole answer.
    """
    return no_answer(f"{api.rstrip('/')}/health", patience_s)


def _cannot_read_runs(api: str) -> str | None:
    """Return why a server cannot read its tables, which its /health does not check."""
    for kind in ("flow_runs", "task_runs"):
        request = Request(f"{api}/{kind}/filter", data=b'{"limit": 1}', headers={"Content-Type": "application/json"})
        try:
            with urlopen(request, timeout=_READ_TIMEOUT_S):
                pass
        except HTTPError as error:
            if error.code >= _SERVER_ERROR:
                return f"answers {error.code}"
        except OSError as error:
            return f"does not answer ({error})"
    return None


def _end_with_this_process(server_pid: int) -> None:
    """End the temporary server with this process, even if that is killed.

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
    """Shows warnings through the display, so that no progress bar hides them."""

    def __init__(self, verbose: bool) -> None:
        super().__init__(logging.INFO if verbose else logging.WARNING)
        self._verbose = verbose

    def emit(self, record: logging.LogRecord) -> None:
        # What fails inside a task surfaces as an exception; Prefect's account of it is for the log.
        """Show a record.

        Args:
            record: of the log.
        """
        if self._verbose or not record.name.startswith(("prefect", "py.warnings", "alembic", "mlflow")):
            progress.say(without_secrets(f"{record.levelname.lower()}: {record.getMessage()}"))


def _file_handler() -> logging.Handler | None:
    try:
        log_path().parent.mkdir(parents=True, exist_ok=True)
        return logging.handlers.RotatingFileHandler(log_path(), maxBytes=_LOG_BYTES, backupCount=2, encoding="utf-8")
    except OSError:  # a read-only home must not stop a run
        return None
