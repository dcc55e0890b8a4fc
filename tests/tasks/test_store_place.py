"""Addresses of tracking stores: each works, or is refused in a sentence whose advice works when it is followed."""

import os
import re
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from hfb.errors import InputError, TemporaryError
from hfb.tasks.tracking.store_place import check_store, pages_command, sqlite_file, tracking_uri

UNPRIVILEGED = 65534


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_ALLOW_FILE_STORE", raising=False)


WORK = {
    "sqlite:///mlflow.db": "mlflow.db",
    "sqlite:///deep/er/mlflow.db": "deep/er/mlflow.db",
    "sqlite:////{here}/a b/ü.db": "a b/ü.db",
    "sqlite+pysqlite:///mlflow.db": "mlflow.db",
    "SQLite:///mlflow.db": "mlflow.db",
    "sqlite:///mlflow.db?timeout=30": "mlflow.db",
    "sqlite+pysqlite:////{here}/x.db?timeout=30&check_same_thread=false": "x.db",
    "sqlite:///file:mlflow.db?uri=true": "mlflow.db",
    "sqlite:///file:///{here}/x%20y.db?mode=rwc&uri=true": "x y.db",
    " sqlite:///mlflow.db ": "mlflow.db",
}


@pytest.mark.parametrize("given", WORK)
def test_a_sqlite_file_by_any_address(given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", given.replace("/{here}", str(tmp_path)))
    uri = tracking_uri()
    assert sqlite_file(uri) == tmp_path / WORK[given]
    assert uri.startswith(f"sqlite:///{tmp_path}")
    assert "pysqlite" not in uri
    assert ("timeout=30" in uri) == ("timeout=30" in given)
    check_store(uri)
    assert (tmp_path / WORK[given]).parent.is_dir()
    assert uri in pages_command()


@pytest.mark.parametrize("given", list(WORK)[:5])
def test_runs_are_recorded_there(given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hfb.tasks.tracking import tracking

    monkeypatch.setenv("MLFLOW_TRACKING_URI", given.replace("/{here}", str(tmp_path)))
    tracking.open_store()
    (tmp_path / "a.txt").write_text("a")
    with tracking.record_run("name", "k", {}, {}) as run:
        tracking.log_files(run, [tmp_path / "a.txt"])
    file = tmp_path / WORK[given]
    with closing(sqlite3.connect(file)) as database:
        assert database.execute("select status from runs").fetchall() == [("FINISHED",)]
    assert [path.read_text() for path in file.parent.glob("mlflow-artifacts/*/artifacts/a.txt")] == ["a"]


REFUSED = {
    "sqlite://": "only until the command ends",
    "sqlite:///": "only until the command ends",
    "sqlite:": "only until the command ends",
    "sqlite:///:memory:": "only until the command ends",
    "sqlite:///file::memory:?cache=shared&uri=true": "only until the command ends",
    "sqlite+pysqlite://": "only until the command ends",
    "sqlite://mlflow.db": "names no file",
    "sqlite:mlflow.db": "names no file",
    "sqlite+aiosqlite:///mlflow.db": "names no file",
    "sqlite:///file:x.db?mode=ro&uri=true": "names no file",
    "sqlite:///~/x.db": "~ is not replaced there",
    "sqlite:////~/x.db": "~ is not replaced there",
    "mlruns": "plain folders",
    "./mlruns": "plain folders",
    "/{here}/mlruns": "plain folders",
    "/{here}/runs.db": "plain folders",
    "file:///{here}/mlruns": "plain folders",
    "file:/{here}/mlruns": "plain folders",
    "file:mlruns": "plain folders",
    "file:///{here}/with%20space": "plain folders",
    "file:": "plain folders",
    "what?ever": "plain folders",
    "ftp://host/x": "knows no store of the kind 'ftp'",
    "redis://host": "knows no store of the kind 'redis'",
    "C:\\mlruns": "knows no store of the kind 'c'",
    "sqlite3:///mlflow.db": "knows no store of the kind 'sqlite3'",
    "localhost:5000": "knows no store of the kind 'localhost'",
}


@pytest.mark.parametrize("given", REFUSED)
def test_advice_works_when_it_is_followed(given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("MLFLOW_TRACKING_URI", given.replace("/{here}", str(tmp_path)))
    with pytest.raises(InputError, match=re.escape(REFUSED[given])) as told:
        check_store(tracking_uri())
    before = set(tmp_path.iterdir())
    assert not before, "nothing is made for a store that is refused"
    (advice,) = re.findall(r"set MLFLOW_TRACKING_URI to (\S.*)$", str(told.value))
    monkeypatch.setenv("MLFLOW_TRACKING_URI", advice)
    assert tracking_uri() == advice
    check_store(advice)
    assert sqlite_file(advice) is not None


def test_postgres_is_told_its_name() -> None:
    with pytest.raises(InputError, match="postgresql://") as told:
        check_store("postgres://me:s3cret-word@host/db")
    assert "s3cret-word" not in str(told.value)


@pytest.mark.parametrize("driver", ["postgresql+asyncpg", "mysql+aiomysql", "MYSQL+asyncmy"])
def test_an_asynchronous_driver_is_refused_before_work_begins(driver: str) -> None:
    with pytest.raises(
        InputError, match=f"asynchronous: leave it out, as in {driver.lower().partition('+')[0]}://"
    ) as told:
        check_store(f"{driver}://me:s3cret-word@host/db")
    assert "s3cret-word" not in str(told.value)


@pytest.mark.parametrize(
    "given",
    [
        "http://",
        "http:",
        "https:///x",
        "http:/host:5000",
        "http://ho st:5000",
        "http://host:port",
        "http://host:99999",
        "http://[::1",
        "http://host:5000\n",
        "http://a..b:5000",
        "http://:5000",
        "http://host:0",
    ],
)
def test_an_address_that_is_none(given: str) -> None:
    with pytest.raises(InputError, match=r"MLFLOW_TRACKING_URI is .* set it to an address like http://127.0.0.1:5000"):
        check_store(given)


def test_file_stores_where_mlflow_allows_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    check_store(f"file://{tmp_path}/mlruns")


def test_a_folder_in_the_files_place(tmp_path: Path) -> None:
    with pytest.raises(TemporaryError, match=r"is a folder: set MLFLOW_TRACKING_URI to sqlite:////.*/mlflow.db"):
        check_store(f"sqlite:///{tmp_path}")


def test_a_file_that_is_no_database(tmp_path: Path) -> None:
    (tmp_path / "a.db").write_text("hello " * 100)
    with pytest.raises(TemporaryError, match="no SQLite database"):
        check_store(f"sqlite:///{tmp_path}/a.db")


def test_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(TemporaryError, match="set MLFLOW_TRACKING_URI to a file in a folder of yours"):
        check_store(f"sqlite:///{tmp_path}/file/mlflow.db")


FULL = """
import resource, sys
from hfb.tasks.tracking.store_place import check_store
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    check_store(sys.argv[1])
except ValueError as error:
    print(error)
"""
OTHERS = """
import os, sys
from hfb.tasks.tracking.store_place import check_store
os.setgroups([]); os.setgid(int(sys.argv[2])); os.setuid(int(sys.argv[2]))
try:
    check_store(sys.argv[1])
except ValueError as error:
    print(error)
"""


def said(script: str, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script, *words],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    return done.stdout.strip()


@pytest.mark.integration
def test_a_full_disk_is_told_before_work_begins(tmp_path: Path) -> None:
    told = said(FULL, f"sqlite:///{tmp_path}/mlflow.db")
    assert "cannot be recorded" in told
    assert "free some space" in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.integration
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_belongs_to_somebody_else(kind: str, tmp_path: Path) -> None:
    for above in (tmp_path, *tmp_path.parents):
        if above != Path("/") and above.stat().st_uid == 0:
            above.chmod(above.stat().st_mode | 0o055)
    file = tmp_path / "place" / "mlflow.db"
    file.parent.mkdir()
    with closing(sqlite3.connect(file)) as database:
        database.execute("create table a (b)")
    if kind == "file":
        file.parent.chmod(0o777)
    told = said(OTHERS, f"sqlite:///{file}", str(UNPRIVILEGED))
    assert "cannot be recorded" in told
    assert "set MLFLOW_TRACKING_URI to a file in a folder of yours" in told
