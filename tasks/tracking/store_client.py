"""MLflow's client for a store, with bounded waiting, and the check of a store before any work begins."""

from __future__ import annotations

import functools
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hfb.errors import InputError, TemporaryError
from hfb.tasks.telemetry.secrets import without_secrets
from hfb.tasks.tracking.patience import Patience
from hfb.tasks.tracking.store_place import (
    make_folder,
    on_database,
    on_server,
    sqlite_file,
    tracking_uri,
    upgrade_command,
)

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from sqlalchemy import Engine

# A server that goes away must cost seconds, not MLflow's default of four minutes.
_HTTP_LIMITS = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1", "MLFLOW_HTTP_REQUEST_TIMEOUT": "14"}
_CONNECT_LIMITS = dict.fromkeys(("psycopg2", "psycopg", "mysqldb", "pymysql"), "connect_timeout") | {
    "pysqlite": "timeout"
}
_CONNECT_S = 8
_SLOWEST_UPLOAD_BYTES_S = 250_000
_MIGRATES_S = 4.0
_MAKES_TABLES_S = 180.0  # dozens of migrations, on a slow disk or far away
_SHOWN = 160  # characters of another program's own account, which goes on for lines
os.environ.setdefault("MLFLOW_CONFIGURE_LOGGING", "false")  # its handler would print tracebacks before our sentences


class StoreLost(Exception):
    """The tracking store could not be reached or written."""


def client() -> MlflowClient:
    """Return the store's client; `store_losses` turns its exceptions into StoreLost."""
    return client_of(tracking_uri())


@functools.cache
def client_of(uri: str) -> MlflowClient:
    """Return the client of a store, whose calls wait no longer than `hfb.tasks.tracking.patience` allows.

    Args:
        uri: of the store.

    Raises:
        StoreLost: its tables are of another version of MLflow.
    """
    for name, value in _HTTP_LIMITS.items():
        os.environ.setdefault(name, value)
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")  # bars of its own would break ours
    from mlflow import MlflowClient

    make_folder(uri)
    if on_database(uri):
        patience(uri).call(lambda: _check_tables(uri))
    made = patience(uri).call(lambda: MlflowClient(uri), _MAKES_TABLES_S if on_database(uri) else 0.0)
    return cast("MlflowClient", _BoundedClient(made, patience(uri)))


def load_mlflow() -> None:
    """Import MLflow, ahead of the first use."""
    import mlflow  # noqa: F401


def load_stores() -> None:
    """Import what MLflow needs for a store in a database, ahead of the first use."""
    import alembic.autogenerate  # noqa: F401
    import mlflow.store.db.utils
    import mlflow.store.tracking.sqlalchemy_store  # noqa: F401


@functools.cache
def patience(uri: str) -> Patience:
    """Return the time that this process still waits for a store; one object per store.

    Args:
        uri: of the store.
    """
    return Patience()


@contextmanager
def store_losses() -> Iterator[None]:
    """Turn any exception of a store inside the block into StoreLost."""
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (MlflowException, SQLAlchemyError, OSError) as error:  # requests' errors are OSErrors
        raise StoreLost(_first_line(error)) from error


@contextmanager
def usable_store(uri: str) -> Iterator[None]:
    """Check a store's tables, and turn exceptions of opening it inside the block into one sentence.

    Args:
        uri: of the store.

    Raises:
        TemporaryError: the store does not answer, or its tables are of another version of MLflow.
        InputError: a library for such a store is missing, or the address is wrong.
    """
    import mlflow  # noqa: F401  (takes seconds, which do not count as waiting)

    shown = without_secrets(uri)
    try:
        yield
    except InputError:
        raise
    except StoreLost as lost:
        raise TemporaryError(str(lost)) from lost
    except ModuleNotFoundError as error:
        package = "mysqlclient, which has MySQLdb" if error.name == "MySQLdb" else error.name
        raise InputError(f"the runs in {shown} need the Python package {package}: install it") from None
    except Exception as error:
        where = f"the MLflow server at {shown}" if on_server(uri) else f"the MLflow store {shown}"
        what = "check its address and start it" if sqlite_file(uri) is None else "mend it"
        raise TemporaryError(
            f"{where} cannot be used ({_first_line(error)}): {what}, or set MLFLOW_TRACKING_URI to another"
        ) from error


class _BoundedClient:
    """MlflowClient whose calls have a time limit."""

    def __init__(self, made: MlflowClient, waiting: Patience) -> None:
        self._made, self._waiting = made, waiting

    def __getattr__(self, name: str) -> Any:
        member = getattr(self._made, name)
        if not callable(member) or name == "download_artifacts":  # as long as it takes: the client bounds each read
            return member

        def bounded(*args: Any, **kwargs: Any) -> Any:
            least_s = Path(args[1]).stat().st_size / _SLOWEST_UPLOAD_BYTES_S if name == "log_artifact" else 0.0
            return self._waiting.call(lambda: member(*args, **kwargs), least_s)

        return bounded


def _check_tables(uri: str) -> None:
    """Connect once, without the ten attempts of MLflow, and compare the tables with the installed MLflow.

    MLflow would migrate the tables of an older version silently where they lack a table, and fail at others.
    """
    import mlflow
    from alembic.script import ScriptDirectory
    from sqlalchemy import create_engine, make_url
    from sqlalchemy.pool import NullPool

    limit = _CONNECT_LIMITS.get(make_url(uri).get_driver_name())
    engine = create_engine(uri, poolclass=NullPool, connect_args={limit: _CONNECT_S} if limit else {})
    migrations = ScriptDirectory(str(Path(mlflow.__file__).parent / "store" / "db_migrations"))
    head = migrations.get_current_head()
    found = _wait_until_settled(lambda: _revision(engine), head)
    if found in (None, head):
        return
    known = {script.revision for script in migrations.walk_revisions()}
    told = f"the tables of the MLflow store {without_secrets(uri)} are of"
    if found in known:
        raise StoreLost(f"{told} an older MLflow: run `{upgrade_command(uri)}`, or set MLFLOW_TRACKING_URI to another")
    raise StoreLost(
        f"{told} a newer MLflow than {mlflow.__version__}: set MLFLOW_TRACKING_URI to another store, or install that "
        f"MLflow into {sys.prefix}"
    )


def _wait_until_settled(read: Callable[[], str | None], wanted: str | None) -> str | None:
    """Read until the value no longer changes: another process may be creating the tables."""
    found, since = read(), time.monotonic()
    while found not in (None, wanted) and time.monotonic() - since < _MIGRATES_S:
        time.sleep(0.5)
        if (now := read()) != found:
            found, since = now, time.monotonic()
    return found


def _revision(engine: Engine) -> str | None:
    from alembic.migration import MigrationContext

    with closing(engine.connect()) as connection:
        return MigrationContext.configure(connection).get_current_revision()


def _first_line(error: BaseException) -> str:
    """Return the beginning of a library's account, from its reason on."""
    # SQLAlchemy begins with a remark on its flushes, and with the driver's class.
    text = re.sub(r"^(\(raised as [^\n]*\n)?(\(\w[\w.]*\)\s*)?", "", str(error).strip())
    if "Max retries exceeded" in text:  # of requests, whose reason is the last of its causes
        text = re.split(r": |\('", text.rpartition("(Caused by ")[2])[-1].partition(" (")[0].strip("\"').")
    lines = text.splitlines()
    return without_secrets(lines[0] if lines else type(error).__name__)[:_SHOWN]
