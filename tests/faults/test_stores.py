"""Tracking stores that fail: told within half a minute, once, before work begins; a fit is kept and recorded later."""

import json
import shutil
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from hfb.errors import InputError, TemporaryError
from hfb.flows.cli.cli import main
from hfb.tasks.tracking import tracking
from tests.cli.conftest import _own_logging  # noqa: F401  (commands run in this process)
from tests.faults.servers import Postgres, free_port, postgres
from tests.faults.stores import (
    artifacts_of,
    assert_recorded_later,
    hanging_server,
    lost,
    older_store,
    standing_still,
)
from tests.flows.test_fit_image import run
from tests.orchestration import TINY_OPTIONS, Problem, mlflow_rows

AT_MOST_S = 30


@contextmanager
def at_most(seconds: float = AT_MOST_S) -> Iterator[None]:
    began = time.monotonic()
    yield
    assert time.monotonic() - began < seconds


def fit_command(problem: Problem, out: Path) -> int:
    return main(["fit", str(problem.frame), "--background", str(problem.background), "--out", str(out), *TINY_OPTIONS])


@pytest.mark.parametrize(
    ("kind", "scheme"),
    [
        *((kind, scheme) for kind in ("dead", "hangs") for scheme in ("postgresql", "postgresql+psycopg2", "http")),
        ("hangs after /health", "http"),
    ],
)
def test_told_before_work_begins(
    kind: str,
    scheme: str,
    problem: Problem,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with hanging_server(healthy=kind == "hangs after /health") as hanging:
        port = free_port() if kind == "dead" else hanging
        monkeypatch.setenv("MLFLOW_TRACKING_URI", f"{scheme}://me:s3cret-word@127.0.0.1:{port}/db")
        with at_most():
            assert fit_command(problem, tmp_path / "out") == 2
    shown = capsys.readouterr().err.strip().splitlines()
    assert "MLflow" in shown[-1]
    assert f"127.0.0.1:{port}" in shown[-1]
    assert "s3cret-word" not in "".join(shown)
    assert not any("Traceback" in line for line in shown)
    assert not (tmp_path / "out").exists()


def test_a_newer_schema(store: Path, problem: Problem, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with closing(sqlite3.connect(store)) as database:
        database.execute("update alembic_version set version_num = 'feedfacecafe'")
        database.commit()
    with at_most():
        assert fit_command(problem, tmp_path / "out") == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert "of a newer MLflow than" in told
    assert "set MLFLOW_TRACKING_URI to another store" in told
    assert mlflow_rows(store, "select version_num from alembic_version") == [("feedfacecafe",)], "nothing was migrated"


def test_an_older_schema_and_the_advice_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a b.db"
    revision = older_store(file)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{file}")
    with pytest.raises(TemporaryError, match="of an older MLflow: run `") as told:
        tracking.open_store()
    assert mlflow_rows(file, "select version_num from alembic_version") == [(revision,)], "nothing was migrated"
    command = str(told.value).partition("`")[2].partition("`")[0]
    subprocess.run(["/bin/sh", "-c", command], check=True, capture_output=True, timeout=240)
    tracking.open_store()


def test_a_driver_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "mysql://me@127.0.0.1/db")
    with at_most(), pytest.raises(InputError, match="mysqlclient, which has MySQLdb: install it"):
        tracking.open_store()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Postgres]:
    if reason := Postgres.missing():
        pytest.skip(reason)
    with postgres(tmp_path_factory.mktemp("postgres") / "data") as running:
        yield running


def test_postgresql_stands_still_and_comes_back(
    cluster: Postgres,
    problem: Problem,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    uri = cluster.url.replace("asyncpg", "psycopg2")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.chdir(tmp_path)
    tracking.open_store()
    with standing_still(cluster):
        with at_most():
            with pytest.raises(tracking.StoreLost, match="no answer within"):
                tracking.begin_run("clip", "another", {}, {})
            for _ in range(9):  # as frame after frame of a clip is logged
                with pytest.raises(tracking.StoreLost):
                    tracking.log_points(tracking.Run(uri, "1", "0" * 32, 0, False), {"a": {0: 1.0}})
        result = run(problem, tmp_path / "out")
        with at_most(), pytest.raises(TemporaryError, match="cannot be used"):
            tracking.open_store()
    assert result["mlflow_run_id"] is None
    assert result["files"].count("record.json") == 1
    found = assert_recorded_later(tmp_path / "out", uri, capsys)
    elsewhere = run(problem, tmp_path / "again")
    assert elsewhere["mlflow_run_id"] == found["mlflow_run_id"], "the run that it would have been"


def test_postgresql_crashes_and_comes_back(cluster: Postgres, monkeypatch: pytest.MonkeyPatch) -> None:
    uri = cluster.url.replace("asyncpg", "psycopg2")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    run_ = tracking.begin_run("clip", "a-clip", {}, {})
    cluster.crash()
    with at_most():
        for step in range(5):
            with pytest.raises(tracking.StoreLost):
                tracking.log_points(run_, {"a": {step: 1.0}})
        with pytest.raises(tracking.StoreLost):
            tracking.begin_run("clip", "a-clip", {}, {})
        with pytest.raises(TemporaryError, match="refused"):
            tracking.open_store()
    cluster.start()
    again = tracking.begin_run("clip", "a-clip", {}, {})
    assert again.run_id == run_.run_id
    tracking.log_points(again, {"a": {0: 1.0}})
    tracking.end_run(again, "FINISHED")


def test_a_fit_is_recorded_later_as_it_would_have_been(
    problem: Problem,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorded = run(problem, tmp_path / "first" / "out")  # as a result looks that was recorded at once
    names = "select key, value from params", "select key, step, value from metrics", "select key, value from tags"
    volatile = ("mlflow.runName", "hfb.owner", "mlflow.source.name", "mlflow.user")

    def rows(database: Path) -> list[list[tuple]]:
        kept = ([row for row in mlflow_rows(database, query) if row[0] not in volatile] for query in names)
        return [sorted(row for row in one if not row[0].startswith("time/")) for one in kept]

    expected = rows(store)
    artifacts = artifacts_of(store, recorded["mlflow_run_id"])
    there = Path(shutil.move(store, tmp_path / "kept.db"))
    lost(tmp_path, monkeypatch)
    assert run(problem, tmp_path / "out")["mlflow_run_id"] is None

    other = tmp_path / "other" / "mlflow.db"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{other}")
    found = assert_recorded_later(tmp_path / "out", f"sqlite:///{other}", capsys)
    assert rows(other) == expected
    assert artifacts_of(other, found["mlflow_run_id"]) == artifacts

    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{there}")
    assert main(["record", str(tmp_path / "out")]) == 2, "its run is in another store"
    assert "there is no run" in capsys.readouterr().err


def test_a_result_that_is_not_as_it_was(
    problem: Problem,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    lost(tmp_path, monkeypatch)
    out = tmp_path / "out"
    run(problem, out)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{store}")
    kept = json.loads((out / "record.json").read_text())

    def refused(says: str) -> None:
        before = mlflow_rows(store, "select count(*) from runs")
        assert main(["record", str(out)]) == 2
        told = capsys.readouterr().err.strip().splitlines()[-1]
        assert says in told
        assert mlflow_rows(store, "select count(*) from runs") == before

    secret = tmp_path / "secret.txt"
    secret.write_text("mine")
    hash_of_it = {"sha256": "0" * 64, "folder": None}
    for name in ("../secret.txt", str(secret), "..", ".lock", "", "intermediate/x"):
        (out / "record.json").write_text(json.dumps(kept | {"files": {name: hash_of_it}}))
        refused("no part of a record")
    (out / "record.json").write_text(json.dumps(kept | {"files": {"result.json": hash_of_it}}))
    refused("result.json is not as the result's command left it")
    for changed in ({"format": 2}, {"tags": {"mlflow.user": "root"}}, {"contents": {"../x.json": {}}}, {"more": 1}):
        (out / "record.json").write_text(json.dumps(kept | changed))
        refused("record.json")
    for content in (b"[]", b"\xff", b"{" * 9000, b'{"format": 1}'):
        (out / "record.json").write_bytes(content)
        refused("record.json")
    (out / "record.json").write_text(json.dumps(kept))
    (out / "strip.png").write_bytes(b"another")
    refused("strip.png is not as the result's command left it")
    (out / "strip.png").unlink()
    (out / "strip.png").symlink_to(secret)
    refused("strip.png is a symbolic link")
    (out / "record.json").unlink()
    refused("run its own command again")
    assert main(["record", str(tmp_path / "none")]) == 2
    assert "result.json" in capsys.readouterr().err


def test_a_store_that_goes_in_the_middle_costs_a_sentence(
    problem: Problem, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = tmp_path / "gone", tmp_path / "out"
    folder.mkdir()
    shutil.copy(store, folder / "mlflow.db")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{folder}/mlflow.db")
    command = [sys.executable, "-m", "hfb.flows.cli.cli", "fit", str(problem.frame), "--background"]
    command += [str(problem.background), "--out", str(out), *TINY_OPTIONS]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as fit:
        said = []
        for line in fit.stderr or ():
            if line.startswith("matte") and folder.exists():
                shutil.rmtree(folder)
            said.append(line)
    assert fit.returncode == 0, said
    (sentence,) = [line for line in said if "not recorded in MLflow" in line]
    assert "raised as a result" not in sentence
    assert f"`hfb record {out}` records it" in sentence
    assert not [line for line in said if "Traceback" in line or "ERROR" in line], said
    folder.mkdir()
    assert_recorded_later(out, f"sqlite:///{folder}/mlflow.db", capsys)
