"""Tracking stores that do not work, real ones; and what is recorded later, when they do."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from hfb.tasks.tracking import tracking
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


def statuses(uri: str) -> list[tuple[str, str]]:
    """(id, status) of the runs that a store has."""
    client = tracking.client_of(uri)
    experiment = client.get_experiment_by_name("hfb")
    return [(run.info.run_id, run.info.status) for run in client.search_runs([experiment.experiment_id])]


def artifacts_of(store: Path, run_id: str) -> set[str]:
    folder = store.parent / "mlflow-artifacts" / run_id / "artifacts"
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def lost(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on there is no store."""
    (folder / "file").touch()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{folder}/file/mlflow.db")


def assert_recorded_later(out: Path, uri: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """`hfb record` makes the run, names it in the result, and does nothing the second time."""
    from hfb.flows.cli.cli import main

    there = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    capsys.readouterr()
    assert main(["record", str(out), "--json"]) == 0
    (first,) = json.loads(capsys.readouterr().out)["runs"]
    assert first["new"]
    assert (first["mlflow_run_id"], "FINISHED") in statuses(uri)
    result = json.loads((out / "result.json").read_text())
    assert result["mlflow_run_id"] == first["mlflow_run_id"]
    assert result["mlflow_link"] == first["mlflow_link"]
    assert "record.json" not in result["files"]
    assert {path.name for path in out.iterdir() if path.is_file()} == there.keys() - {"record.json"}
    unchanged = there.keys() - {"record.json", "result.json"}
    assert {name: (out / name).read_bytes() for name in unchanged} == {name: there[name] for name in unchanged}

    assert main(["record", str(out), "--json"]) == 0
    (second,) = json.loads(capsys.readouterr().out)["runs"]
    assert (second["mlflow_run_id"], second["new"]) == (first["mlflow_run_id"], False)
    return first
