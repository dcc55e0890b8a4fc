"""Tracking stores that do not work: servers that hang, and databases of other versions of MLflow. Real ones."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.faults.servers import Postgres

_HEALTHY = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nConnection: close\r\n\r\nOK"


@contextmanager
def hanging_server(healthy: bool = False) -> Iterator[int]:
    """Takes connections on its port and says nothing; yields the port.

    Args:
        healthy: it answers to /health, as MLflow's server does.
    """
    taken: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                taken.append(connection)
                if healthy:
                    threading.Thread(target=answer, args=(connection,), daemon=True).start()

        def answer(connection: socket.socket) -> None:
            with suppress(OSError):
                if connection.recv(4096).startswith(b"GET /health"):
                    connection.sendall(_HEALTHY)
                    connection.close()

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]
    for connection in taken:
        connection.close()


@contextmanager
def standing_still(cluster: Postgres) -> Iterator[None]:
    """Every process of a database cluster is stopped, and goes on after the block: connections stay, nobody answers."""
    tasks = Path(f"/proc/{cluster.pid}/task/{cluster.pid}/children").read_text().split()
    everyone = [cluster.pid, *map(int, tasks)]
    for process in everyone:
        os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        for process in reversed(everyone):
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGCONT)


def older_store(path: Path) -> str:
    """A SQLite store as an older MLflow left it; returns its revision."""
    import mlflow.store.db.utils as tables
    from alembic import command
    from alembic.script import ScriptDirectory
    from sqlalchemy import create_engine

    engine = create_engine(f"sqlite:///{path}")
    tables.InitialBase.metadata.create_all(engine)
    config = tables._get_alembic_config(str(engine.url))
    revisions = [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()]
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revisions[3])
    engine.dispose()
    return revisions[3]
