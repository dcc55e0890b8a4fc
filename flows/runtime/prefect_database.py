"""The SQLite database of hfb's temporary Prefect servers: usable, of Prefect's version, and bounded in size.

One file per version of Prefect, so that two installations of hfb never migrate each other's. It holds history only:
results lie elsewhere. A damaged one is set aside instead of failing every command.
"""

from __future__ import annotations

import logging
import os
import re
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from filelock import FileLock, ReadWriteLock, Timeout

_KEPT_DAYS = 30
_LARGEST_BYTES = 256 << 20
_ENDED = "state_type in ('COMPLETED', 'FAILED', 'CRASHED', 'CANCELLED')"
_SIDE_FILES = ("", "-wal", "-shm", "-journal")
_SET_ASIDE = ".set-aside-"
_ERRORS = "storage"  # a file for every exception that ended a flow or a task
_MIGRATIONS = "server/database/_migrations/versions/sqlite"
_REVISION = re.compile(r"^revision(?::\s*str)?\s*=\s*['\"](\w+)['\"]", re.MULTILINE)
_FOLLOWS = re.compile(r"^down_revision(?::[^=]+)?\s*=\s*['\"](\w+)['\"]", re.MULTILINE)
# What has no foreign key to a flow run, with the column that says how old a row is.
_DATED = {"log": "timestamp", "artifact": "created"}
_WRITTEN = "%Y-%m-%d %H:%M:%S.%f"  # times, as Prefect's own column type writes them
_EVENTS = ("events", "event_resources")  # of servers that still wrote them: three quarters of the file
_log = logging.getLogger(__name__)


class PrefectDatabase:
    """The database of this process's temporary server.

    The first server of a version creates the tables while others wait. A process that finds no other one checks the
    whole file and removes old history.

    Attributes:
        path: the SQLite file.
    """

    def __init__(self, home: Path, say: Callable[[str], None]) -> None:
        """Wait until no other process creates the tables, then check the file.

        Args:
            home: folder of the database.
            say: tells the user that a database was set aside.
        """
        self._home, self._say = home, say
        self.path = _path(home)
        self._making = FileLock(home / "tables.lock", thread_local=False)
        self._making.acquire()
        # Shared by all servers; who takes it alone gives it back before the next one may look, see `_making`.
        self._in_use = ReadWriteLock(home / "in-use.lock", is_singleton=False)
        alone = _taken_alone(self._in_use)
        if reason := trouble_with(self.path, thorough=alone):
            self.set_aside(reason)
        if alone:
            with suppress(OSError, sqlite3.Error):  # tidying up must not stop a run
                remove_old_files(home, self.path)
                prune(self.path)
            self._in_use.release()
        self._in_use.acquire_read()
        if _revisions(self.path) == {_known_revisions()[1]}:
            self.let_go()

    @property
    def url(self) -> str:
        """Value of PREFECT_SERVER_DATABASE_CONNECTION_URL."""
        return f"sqlite+aiosqlite:///{self.path}"

    def set_aside(self, reason: str) -> None:
        """Rename the database, so that the next server creates a new one, and tell the user.

        Args:
            reason: completes the sentence "the database ...".
        """
        stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S-%f")
        for ending in _SIDE_FILES:
            path = Path(f"{self.path}{ending}")
            aside = path.with_name(f"{self.path.name}{_SET_ASIDE}{stamp}{ending}")
            with suppress(FileNotFoundError):
                path.rename(aside)
                aside.touch()  # its age counts from now
        self._say(
            f"hfb: the database of hfb's Prefect server {reason}: a new one is made, the old one is "
            f"{self._home / (self.path.name + _SET_ASIDE + stamp)}; no result is lost"
        )

    def let_go(self) -> None:
        """Release the lock: tables exist, or the server did not start and the next one may try."""
        self._making.release(force=True)


def trouble_with(path: Path, thorough: bool) -> str | None:
    """Return why Prefect cannot work with a database file; None where it can, or where there is none yet.

    Args:
        path: the file.
        thorough: whether to read the whole file.
    """
    if not path.exists():
        return None
    if not path.is_file():
        return "is no file"
    try:
        with closing(_open(path)) as database:
            tables = {name for (name,) in database.execute("select name from sqlite_master where type = 'table'")}
            if tables and "alembic_version" not in tables:
                return "is no database of Prefect"
            if thorough and database.execute("pragma quick_check(1)").fetchone() != ("ok",):
                return "is damaged"
    except sqlite3.OperationalError as error:
        return None if "lock" in str(error) or "readonly" in str(error) else f"cannot be read ({error})"
    except sqlite3.DatabaseError as error:
        return f"is damaged ({error})"
    return None if _revisions(path) <= _known_revisions()[0] else "is of another version of Prefect"


def remove_old_files(home: Path, current: Path) -> None:
    """Remove databases that were set aside or belong to other versions of Prefect, and errors it kept, after a month.

    Args:
        home: folder of the databases.
        current: the database in use.
    """
    for path in (*home.glob("prefect-*.db*"), *home.glob(f"{_ERRORS}/*")):
        if not path.name.startswith(current.name) or _SET_ASIDE in path.name:
            with suppress(OSError):
                if path.is_file() and path.stat().st_mtime < time.time() - _KEPT_DAYS * 86400:
                    path.unlink()


def prune_in_use(largest_bytes: int = _LARGEST_BYTES) -> None:
    """Remove old history while servers are running: a batch may go on for months.

    Args:
        largest_bytes: of the history.
    """
    with suppress(KeyError, OSError, sqlite3.Error):  # tidying up must not stop a run
        home = Path(os.environ["PREFECT_HOME"])
        remove_old_files(home, _path(home))
        prune(_path(home), largest_bytes, in_use=True)


def prune(path: Path, largest_bytes: int = _LARGEST_BYTES, in_use: bool = False) -> None:
    """Remove events and history older than a month; while it takes too much room, also the older half of all runs.

    Args:
        path: the database.
        largest_bytes: of the history; of the file, too, where no server is running.
        in_use: a server may be running: only runs that ended are removed, and the room is used again by the next ones.
    """
    if not path.is_file():
        return
    with closing(_open(path)) as database:
        database.execute("pragma foreign_keys = on")
        which = _ENDED if in_use else "true"
        with database:
            for table in _EVENTS:
                database.execute(f"delete from {table}")
        for until in _ends_of_history(database, which, to_the_last=not in_use):
            _remove_until(database, until, which)
            pages, unused, page_bytes = (
                database.execute(f"pragma {name}").fetchone()[0]
                for name in ("page_count", "freelist_count", "page_size")
            )
            if (pages - unused) * page_bytes <= largest_bytes:
                break
        if not in_use and (unused > pages // 2 or pages * page_bytes > largest_bytes):
            database.execute("vacuum")


def _path(home: Path) -> Path:
    return home / f"prefect-{version('prefect')}.db"


def _ends_of_history(database: sqlite3.Connection, which: str, to_the_last: bool) -> Iterator[str]:
    """Yield until when history is removed: a month ago; then the end of the older half, and so on; then now."""
    ago, now = (datetime.now(UTC) - timedelta(days=days) for days in (_KEPT_DAYS, 0))
    yield ago.strftime(_WRITTEN)
    (runs,) = database.execute(f"select count(*) from flow_run where {which}").fetchone()
    while runs := runs // 2:
        older = f"select updated from flow_run where {which} order by updated desc limit 1 offset ?"
        yield from database.execute(older, (runs,)).fetchone() or ()
    if to_the_last:
        yield now.strftime(_WRITTEN)


def _remove_until(database: sqlite3.Connection, until: str, which: str) -> None:
    with database:
        # task runs, states and inputs go with their flow run
        count = database.execute(f"delete from flow_run where updated <= ? and {which}", (until,)).rowcount
        database.execute("delete from task_run where flow_run_id is null and updated <= ?", (until,))
        for table, column in _DATED.items():
            database.execute(f"delete from {table} where {column} <= ?", (until,))
        database.execute("delete from artifact_collection where latest_id not in (select id from artifact)")
    if count:
        _log.info("Prefect's history: %d flow runs until %s removed", count, until)


def _open(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, timeout=5)


def _revisions(path: Path) -> set[str]:
    """Return the Prefect revisions of the tables; empty where there are none."""
    if not path.is_file():
        return set()
    try:
        with closing(_open(path)) as database:
            return {name for (name,) in database.execute("select version_num from alembic_version")}
    except sqlite3.Error:
        return set()


def _known_revisions() -> tuple[set[str], str]:
    """Return every revision that the installed Prefect can migrate from, and its own.

    Read from its files: importing its server takes seconds.
    """
    found = find_spec("prefect")
    assert found is not None
    assert found.origin is not None
    sources = [path.read_text(encoding="utf-8") for path in (Path(found.origin).parent / _MIGRATIONS).glob("*.py")]
    known = {name for source in sources for name in _REVISION.findall(source)}
    (head,) = known - {name for source in sources for name in _FOLLOWS.findall(source)}
    return known, head


def _taken_alone(lock: ReadWriteLock) -> bool:
    """Return whether nobody else holds the lock; this process then does."""
    try:
        lock.acquire_write(blocking=False)
    except Timeout:
        return False
    return True
