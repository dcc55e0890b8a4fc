"""The database of hfb's temporary Prefect server: made once, never the user's, bounded, and set aside when damaged."""

import os
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from hfb.flows.runtime.prefect_database import PrefectDatabase, prune, prune_in_use, remove_old_files, trouble_with
from tests.orchestration import prefect_api

SERVER = """
import sys
from hfb.flows.runtime.prefect_home import make_home
from hfb.tasks.telemetry import displays, progress
with progress.showing(displays.lines_on(sys.stderr, first_s=999)):
    make_home()
    from hfb.flows.runtime.server import PrefectServer
    PrefectServer().wait()
    from hfb.flows.runtime.reaper import end_abandoned_flow_runs
    print(end_abandoned_flow_runs())
"""
BEATS = """
from prefect.settings import get_current_settings
from hfb.flows.runtime.server import PrefectServer
def beats():
    server = PrefectServer()
    server.wait()
    with server.quiet():
        print(get_current_settings().flows.heartbeat_frequency, get_current_settings().api.url == server._api)
    return server._api
address = beats()
beats()  # the address is the user's now
PrefectServer.lent = address
beats()
"""


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A database with tables and a flow run, as a server of this version leaves it."""
    api = prefect_api()
    from prefect import flow
    from prefect.settings import PREFECT_API_URL, temporary_settings

    with temporary_settings({PREFECT_API_URL: api}):
        flow(name="nothing", persist_result=False)(lambda: None)()
    (source,) = Path(os.environ["PREFECT_HOME"]).glob("prefect-*.db")
    copy = tmp_path_factory.mktemp("used") / source.name
    with closing(sqlite3.connect(source)) as live, closing(sqlite3.connect(copy)) as made:
        live.backup(made)
    return copy


def no_words(words: str) -> None:
    raise AssertionError(words)


def started(home: Path, folder: Path | None = None, program: str = SERVER) -> subprocess.CompletedProcess[str]:
    """A temporary server with a home, in a process of its own, which is in a folder."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    environment |= {"PREFECT_HOME": str(home), "DO_NOT_TRACK": "1"}
    words = [sys.executable, "-P", "-c", program]
    return subprocess.run(words, env=environment, cwd=folder, capture_output=True, text=True, timeout=240, check=False)


def test_only_the_runs_of_a_users_server_beat(tmp_path: Path) -> None:
    """A run waits up to a second for its last heartbeat."""
    done = started(tmp_path / "home", program=BEATS)
    assert done.stdout.splitlines() == ["None True", "180 True", "None True"], done.stderr


def test_the_server_imports_nothing_of_the_folder(tmp_path: Path) -> None:
    for name in ("uvicorn", "sqlalchemy", "prefect"):
        (tmp_path / f"{name}.py").write_text("open('imported', 'w')")
    done = started(tmp_path / "home", tmp_path)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "imported").exists()


def test_a_full_disk_is_named_although_the_log_lies_on_it(tmp_path: Path) -> None:
    """A disk of its own, of 4 MB with 100 kB left; only where one may be mounted."""
    home = tmp_path / "home"
    home.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(home)], capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        (home / "ballast").write_bytes(b"x" * (shutil.disk_usage(home).free - 100_000))
        told = started(home)
    finally:
        subprocess.run(["umount", "--lazy", str(home)], check=True)
    assert told.returncode != 0
    assert "the disk is full, free some space or set XDG_STATE_HOME" in told.stderr


def test_two_first_servers_come_one_after_the_other(tmp_path: Path) -> None:
    first = PrefectDatabase(tmp_path, no_words)
    waited: list[PrefectDatabase] = []
    second = threading.Thread(target=lambda: waited.append(PrefectDatabase(tmp_path, no_words)))
    second.start()
    second.join(0.5)
    assert second.is_alive(), "it has to wait for the tables"
    first.let_go()
    second.join(10)
    assert not second.is_alive()
    waited[0].let_go()


def test_where_there_are_tables_nobody_waits(used: Path, tmp_path: Path) -> None:
    shutil.copy(used, tmp_path)
    both = [PrefectDatabase(tmp_path, no_words) for _ in range(2)]
    assert both[0].path == both[1].path == tmp_path / used.name


def page_of(table: str) -> Callable[[Path], None]:
    """Overwrites the first page of a table."""

    def damage(path: Path) -> None:
        with closing(sqlite3.connect(path)) as database:
            (page,) = database.execute("select rootpage from sqlite_master where name = ?", (table,)).fetchone()
            (size,) = database.execute("pragma page_size").fetchone()
        with path.open("r+b") as file:
            file.seek((page - 1) * size)
            file.write(b"\xa5" * size)

    return damage


def sql(*statements: str) -> Callable[[Path], None]:
    """Runs statements on the database."""

    def change(path: Path) -> None:
        with closing(sqlite3.connect(path)) as database:
            for statement in statements:
                database.execute(statement)
            database.commit()

    return change


CUT = {
    "no database": lambda path: path.write_bytes(os.urandom(5000)),
    "text": lambda path: path.write_text("hello\n" * 900),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "a damaged page": page_of("flow_run"),
    "newer": sql("update alembic_version set version_num = 'feedfacecafe'"),
    "another program's": sql("drop table alembic_version"),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("kind", CUT)
def test_what_cannot_be_used_is_set_aside_with_a_word(kind: str, used: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(used, tmp_path))
    assert trouble_with(path, thorough=True) is None
    CUT[kind](path)
    there = path.read_bytes() if path.is_file() else None
    said: list[str] = []
    PrefectDatabase(tmp_path, said.append)
    (words,) = said
    assert "no result is lost" in words
    assert not path.exists()
    (aside,) = tmp_path.glob("*.set-aside-*")
    assert str(aside) in words
    assert there is None or aside.read_bytes() == there, "it is renamed, not deleted"


@pytest.mark.parametrize("kind", ["a damaged page", "a column is missing"])
def test_a_server_starts_whatever_its_database_was(kind: str, used: Path, tmp_path: Path) -> None:
    """A missing column is noticed by nobody but the server, which answers /health all the same."""
    home = tmp_path / "home" / "hfb"
    home.mkdir(parents=True)
    path = Path(shutil.copy(used, home))
    (CUT | {"a column is missing": sql("alter table task_run rename column task_key to lost")})[kind](path)
    done = started(tmp_path / "home")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "0"
    assert done.stderr.count("a new one is made") == 1
    assert list(home.glob("*.set-aside-*"))
    assert trouble_with(path, thorough=True) is None
    again = started(tmp_path / "home")
    assert again.returncode == 0
    assert "a new one is made" not in again.stderr


def rows(path: Path) -> dict[str, int]:
    with closing(sqlite3.connect(path)) as database:
        names = ("flow_run", "flow_run_state", "task_run", "log", "events", "event_resources", "artifact")
        return {name: database.execute(f"select count(*) from {name}").fetchone()[0] for name in names}


def copies(path: Path, count: int, age_days: float) -> None:
    """Many more runs with their states and logs, of some age."""
    when = (datetime.now(UTC) - timedelta(days=age_days)).strftime("%Y-%m-%d %H:%M:%S.%f")
    with closing(sqlite3.connect(path)) as database:
        kinds = {"flow_run": ("id", ("updated",)), "log": ("id", ("timestamp",))}
        if not database.execute("select count(*) from log").fetchone()[0]:
            database.execute(
                "insert into log (id, created, updated, name, level, message, timestamp) "
                f"values ('a', '{when}', '{when}', 'n', 1, '{'x' * 2000}', '{when}')"
            )
        for table, (key, dates) in kinds.items():
            names = [row[1] for row in database.execute(f"pragma table_xinfo({table})") if row[6] == 0]
            values = [
                "lower(hex(randomblob(16)))"
                if name == key
                else f"'{when}'"
                if name in dates
                else "null"
                if name in ("state_id", "idempotency_key")
                else f'"{name}"'
                for name in names
            ]
            listed = ", ".join(f'"{name}"' for name in names)
            for _ in range(count):
                database.execute(
                    f"insert into {table} ({listed}) select {', '.join(values)} from (select * from {table} limit 1)"
                )
        database.commit()


def test_what_is_old_is_removed(used: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(used, tmp_path))
    before = rows(path)
    assert before["flow_run"] >= 1
    assert before["flow_run_state"] >= 1
    copies(path, 300, age_days=40)
    with closing(sqlite3.connect(path)) as database:  # states of an old run go with it
        (run,) = database.execute("select id from flow_run where updated < date('now', '-30 days') limit 1").fetchone()
        database.execute("update flow_run_state set flow_run_id = ?", (run,))
        database.commit()
    PrefectDatabase(tmp_path, no_words)
    after = rows(path)
    assert after["flow_run"] == before["flow_run"]
    assert after["flow_run_state"] == 0
    assert after["log"] == before["log"]
    assert trouble_with(path, thorough=True) is None


def test_it_never_grows_beyond_its_limit(used: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(used, tmp_path))
    copies(path, 2000, age_days=0.01)  # a busy month of somebody's
    assert path.stat().st_size > 4 << 20
    empty = used.stat().st_size
    prune(path, largest_bytes=empty + (1 << 20))
    assert path.stat().st_size <= empty + (1 << 20)
    assert trouble_with(path, thorough=True) is None


def test_of_a_file_that_is_too_large_the_newest_runs_stay(used: Path, tmp_path: Path) -> None:
    """A night of 2,000 clips made it so: that night's history went with the next command, which took minutes."""
    path = Path(shutil.copy(used, tmp_path))
    copies(path, 1500, age_days=0.5)
    copies(path, 400, age_days=0.01)
    largest = (used.stat().st_size + path.stat().st_size) // 2
    prune(path, largest_bytes=largest)
    assert rows(path)["flow_run"] == 400 + rows(used)["flow_run"]
    assert path.stat().st_size <= largest


def test_events_are_not_kept(used: Path, tmp_path: Path) -> None:
    """They took three quarters of the file, and no part of hfb reads them."""
    prefect_api()
    from prefect import flow, task

    square = task(persist_result=False)(lambda number: number**2)
    flow(name="squares", persist_result=False)(lambda: [square(number) for number in range(20)])()
    (path,) = Path(os.environ["PREFECT_HOME"]).glob("prefect-*.db")
    began, done = time.monotonic(), "select count(*) from task_run where state_type = 'COMPLETED'"
    with closing(sqlite3.connect(path)) as database:  # the recorder of task runs hears the same events
        while database.execute(done).fetchone()[0] < 20 and time.monotonic() < began + 60:
            time.sleep(0.2)
        assert database.execute(done).fetchone()[0] >= 20
    assert rows(path)["events"] == 0
    older = Path(shutil.copy(used, tmp_path))  # of hfb that kept them
    with closing(sqlite3.connect(older)) as database, database:
        columns = [row[1] for row in database.execute("pragma table_info(events)")]
        database.execute(f"insert into events ({', '.join(columns)}) values ({', '.join('2' for _ in columns)})")
    prune(older)
    assert rows(older)["events"] == 0


def test_databases_that_nobody_uses_go_after_a_month(used: Path, tmp_path: Path) -> None:
    current = Path(shutil.copy(used, tmp_path))
    month_ago = datetime.now(UTC).timestamp() - 31 * 86400
    others = [
        tmp_path / name
        for name in ("prefect-3.0.0.db", "prefect-3.0.0.db-wal", f"{current.name}.set-aside-1", "mine.txt")
    ]
    for path in (*others, current):
        path.touch()
        os.utime(path, (month_ago, month_ago))
    recent, errors = tmp_path / "prefect-3.1.0.db", tmp_path / "storage"
    recent.touch()
    errors.mkdir()
    (errors / "new").touch()
    (errors / "old").touch()
    os.utime(errors / "old", (month_ago, month_ago))
    remove_old_files(tmp_path, current)
    assert {path.name for path in tmp_path.iterdir()} == {current.name, recent.name, "mine.txt", "storage"}
    assert [path.name for path in errors.iterdir()] == ["new"]


def test_a_database_in_use_is_not_pruned(used: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(used, tmp_path))
    first = PrefectDatabase(tmp_path, no_words)
    copies(path, 3, age_days=40)
    before = rows(path)
    PrefectDatabase(tmp_path, no_words)
    assert rows(path) == before
    del first


def test_what_a_long_batch_leaves_is_bounded(used: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a watched folder: servers run all the time, and what still runs stays."""
    path = Path(shutil.copy(used, tmp_path))
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path))
    _in_use = PrefectDatabase(tmp_path, no_words)
    with closing(sqlite3.connect(path)) as database:
        database.execute("update flow_run set state_type = 'RUNNING', updated = '2020-01-01 00:00:00.000000'")
        database.commit()
    running, sizes = rows(path)["flow_run"], []
    for age_days in (40, 40, 0.1):
        copies(path, 2000, age_days)
        with closing(sqlite3.connect(path)) as database:
            database.execute("update flow_run set state_type = 'COMPLETED' where updated > '2021-01-01'")
            database.commit()
        prune_in_use(used.stat().st_size + (1 << 20))
        assert rows(path)["flow_run"] == running
        sizes.append(path.stat().st_size)
    assert max(sizes) < sizes[0] + (1 << 20)
