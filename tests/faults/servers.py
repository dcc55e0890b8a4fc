"""A Prefect server on PostgreSQL, both of which can be taken away and brought back; real ones, of the test's own."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.request import urlopen

_OWNER = "postgres"
_PATIENCE_S = 120


def free_port() -> int:
    """One that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Postgres:
    """A database cluster in a folder."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self._data = folder / "cluster"
        self._as_owner: list[str] = []
        folder.mkdir(parents=True)
        if os.geteuid() == 0:  # PostgreSQL does not run as root
            self._as_owner = ["setpriv", f"--reuid={_OWNER}", f"--regid={_OWNER}", "--clear-groups"]
            shutil.chown(folder, _OWNER)
            for above in folder.parents:
                if above.stat().st_uid == 0 and above != Path("/"):
                    above.chmod(above.stat().st_mode | 0o011)
        self._do("initdb", "--pgdata", self._data, "--username", "hfb", "--auth", "trust", "--no-sync")

    @staticmethod
    def missing() -> str | None:
        """Why it cannot run here."""
        return None if _programs() else "needs PostgreSQL: the Debian package postgresql"

    @property
    def url(self) -> str:
        """What Prefect is told."""
        return f"postgresql+asyncpg://hfb@127.0.0.1:{self.port}/postgres"

    @property
    def pid(self) -> int:
        """Of the process that the others of the cluster come from."""
        return int((self._data / "postmaster.pid").read_text().split()[0])

    def start(self) -> None:
        """Return when it takes connections."""
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories= -c fsync=off"
        self._do("pg_ctl", "--pgdata", self._data, "--wait", "-o", options, "--log", self._data / "log", "start")

    def crash(self) -> None:
        """As a power cut: nothing is finished."""
        self._do("pg_ctl", "--pgdata", self._data, "--mode", "immediate", "--wait", "stop")

    def _do(self, program: str, *words: str | Path) -> None:
        subprocess.run(
            [*self._as_owner, str(_programs() / program), *map(str, words)],
            check=True,
            cwd="/",
            stdout=subprocess.DEVNULL,
        )


def _programs() -> Path | None:
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda one: int(one.parts[-3]))
    on_path = shutil.which("initdb")
    return found[-1].parent if found else Path(on_path).parent if on_path else None


@contextmanager
def postgres(folder: Path) -> Iterator[Postgres]:
    """A cluster that runs, and ends with the block."""
    cluster = Postgres(folder)
    cluster.start()
    try:
        yield cluster
    finally:
        with suppress(subprocess.CalledProcessError):  # it is down
            cluster.crash()


class PrefectProcess:
    """A server of its own process group, as `prefect server start` makes it."""

    def __init__(self, folder: Path, database: str) -> None:
        self._folder, self._port = folder, free_port()
        self._settings = {
            "PREFECT_HOME": str(folder / "prefect"),
            "PREFECT_API_DATABASE_CONNECTION_URL": database,
            "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
            "PREFECT_UI_ENABLED": "false",
            "DO_NOT_TRACK": "true",
        }
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def api(self) -> str:
        """PREFECT_API_URL."""
        return f"http://127.0.0.1:{self._port}/api"

    @property
    def pid(self) -> int:
        """Of its first process."""
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Return when it answers."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
        with (self._folder / "server.log").open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(self._port)],
                env={**environment, **self._settings},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        until = time.monotonic() + _PATIENCE_S
        while True:
            try:
                with urlopen(f"{self.api}/health", timeout=2):
                    return
            except OSError:
                assert self._process.poll() is None, self.said()
                assert time.monotonic() < until, self.said()
                time.sleep(0.2)

    def kill(self) -> None:
        """Send SIGKILL to it and all that it started."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def said(self) -> str:
        """The end of its log."""
        return (self._folder / "server.log").read_text(errors="replace")[-4000:]


@contextmanager
def prefect_server(folder: Path, database: str) -> Iterator[PrefectProcess]:
    """A server that runs, and ends with the block."""
    server = PrefectProcess(folder, database)
    server.start()
    try:
        yield server
    finally:
        server.kill()
