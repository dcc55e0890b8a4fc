"""Address of the store of runs: a server, a database, or a SQLite file. Light to import: without MLflow."""

from __future__ import annotations

import errno
import os
import re
import sqlite3
import sys
import tempfile
from contextlib import closing
from importlib.metadata import entry_points
from pathlib import Path
from urllib.parse import parse_qsl, unquote, urlencode, urlsplit

import platformdirs

from hfb.errors import InputError, TemporaryError
from hfb.tasks.telemetry.secrets import shown_address, without_secrets
from hfb.tasks.tracking.addresses import check_address, no_answer

LOCAL_PORT = 5000
LOCAL_PAGES = f"http://127.0.0.1:{LOCAL_PORT}"
# What a server of pages for one person needs not do; it takes 3 GB of memory otherwise.
SMALL_SERVER = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
_HEALTH_TIMEOUT_S = 3
_VARIABLE = "MLFLOW_TRACKING_URI"
_SQLITE = re.compile(r"sqlite(?:\+(?P<driver>\w+))?:(?P<slashes>/*)(?P<rest>.*)", re.IGNORECASE | re.DOTALL)
_DATABASES = ("postgresql", "mysql", "mssql")
_ASYNCHRONOUS = re.compile(r"\w+\+(?:asyncpg|psycopg_async|aiomysql|asyncmy|aioodbc):", re.IGNORECASE)
_OTHER_STORES = ("databricks", "databricks-uc", "uc")
_NEEDED_BYTES = 4 << 20
_SQLITE_MAGIC = b"SQLite format 3\0"
_ENDINGS = (".db", ".sqlite", ".sqlite3")


def tracking_uri() -> str:
    """Return the store's address; a SQLite file by its absolute path, whatever form the user chose."""
    uri = os.environ.get(_VARIABLE, "").strip()
    if not uri:
        return sqlite_uri(platformdirs.user_data_path("hfb") / "mlflow.db")
    file = sqlite_file(uri)
    if file is None:
        return uri
    options = [(name, value) for name, value in _options(uri) if name not in ("uri", "mode", "cache")]
    return sqlite_uri(file) + (f"?{urlencode(options)}" if options else "")


def sqlite_uri(file: Path) -> str:
    """Return the address of a SQLite file.

    Args:
        file: its path.
    """
    return f"sqlite:///{file.absolute()}"


def sqlite_file(uri: str) -> Path | None:
    """Return the file of a SQLite store; None for other stores, for one in memory, and for addresses without a file.

    Args:
        uri: of the store.
    """
    found = _SQLITE.fullmatch(uri)
    if found is None or len(found["slashes"]) < 3 or found["driver"] not in (None, "pysqlite"):
        return None
    name = found["slashes"][3:] + found["rest"].partition("?")[0]
    options = dict(_options(uri))
    if options.get("mode") in ("memory", "ro") or options.get("immutable", "0") != "0":
        return None
    if name.startswith("file:"):
        name = unquote(name.removeprefix("file:"))
        name = "/" + name.lstrip("/") if name.startswith("/") else name
    return None if name in ("", ":memory:") or "\0" in name else Path(name).absolute()


def check_store(uri: str) -> None:
    """Check that runs can be recorded at an address, before any work begins and before MLflow waits minutes for it.

    Args:
        uri: of the store.

    Raises:
        InputError: MLflow does not support the address.
        TemporaryError: the store does not answer, or cannot be written.
    """
    scheme = _scheme(uri)
    if on_server(uri):
        check_address(_VARIABLE, uri, "http://127.0.0.1:5000")
        if reason := no_answer(f"{uri.rstrip('/')}/health", _HEALTH_TIMEOUT_S):
            shown = shown_address(uri)
            raise TemporaryError(
                f"the MLflow server at {shown} {reason}: start it, or unset {_VARIABLE} to record locally"
            )
    elif _ASYNCHRONOUS.match(uri):
        raise InputError(
            f"{_VARIABLE} is {without_secrets(uri)!r}, whose driver is asynchronous: leave it out, as in {scheme}://"
        )
    elif scheme == "sqlite":
        _check_sqlite(uri)
    elif uri in _OTHER_STORES:
        return
    elif scheme in ("", "file"):
        if os.environ.get("MLFLOW_ALLOW_FILE_STORE", "").lower() not in ("1", "true"):
            raise InputError(f"MLflow no longer keeps runs in plain folders: {_advice(uri)}")
    elif scheme not in (*_DATABASES, *_OTHER_STORES, *_plugins()):
        hint = "write postgresql://" if scheme == "postgres" else _advice("mlflow.db")
        shown = without_secrets(uri)
        raise InputError(f"{_VARIABLE} is {shown!r}, and MLflow knows no store of the kind {scheme!r}: {hint}")


def on_server(uri: str) -> bool:
    """Return whether runs go to a server, which has pages of its own.

    Args:
        uri: of the store.
    """
    return _scheme(uri) in ("http", "https")


def on_database(uri: str) -> bool:
    """Return whether runs go directly into a database, including a SQLite file.

    Args:
        uri: of the store.
    """
    return _scheme(uri) in ("sqlite", *_DATABASES)


def pages_command(port: int = LOCAL_PORT) -> list[str]:
    """Return the command that shows a local store's runs in a browser; the environment SMALL_SERVER keeps it small.

    Args:
        port: of the pages.

    Raises:
        InputError: runs go to a server, or the store cannot be used.
    """
    uri = tracking_uri()
    if on_server(uri):
        raise InputError(f"runs are recorded on a server that has pages of its own: open {shown_address(uri)}")
    check_store(uri)
    server = [sys.executable, "-P", "-m", "mlflow", "server", "--backend-store-uri", uri]
    address = ["--host", "127.0.0.1", "--port", str(port)]
    return [*server, *address, "--workers", "1", "--uvicorn-opts", "--log-level warning"]


def upgrade_command(uri: str) -> str:
    """Return the command that migrates a store's tables to the installed MLflow; it shows no password.

    Args:
        uri: of the store.
    """
    named = f'"${_VARIABLE}"' if os.environ.get(_VARIABLE) else f"'{uri}'"
    return f"{sys.executable} -m mlflow db upgrade {named}"


def make_folder(uri: str) -> None:
    """Create the folder of a local store's file; SQLite creates none.

    Args:
        uri: of the store.
    """
    if file := sqlite_file(uri):
        file.parent.mkdir(parents=True, exist_ok=True)


def _scheme(uri: str) -> str:
    """Return the kind of a store, without its driver; empty for a folder."""
    found = re.match(r"([a-zA-Z][\w.+-]*):", uri)
    return found[1].lower().partition("+")[0] if found else ""


def _options(uri: str) -> list[tuple[str, str]]:
    return parse_qsl(uri.partition("?")[2], keep_blank_values=True)


def _plugins() -> set[str]:
    return {plugin.name for plugin in entry_points(group="mlflow.tracking_store")}


def _advice(place: str) -> str:
    """Return advice to record into a SQLite file near the place."""
    path = unquote(urlsplit(place).path) if place.startswith("file:") else place
    whole = Path(path or "mlruns").expanduser().absolute()
    file = whole if whole.suffix in _ENDINGS and not whole.is_dir() else whole.with_name(f"{whole.name or 'mlruns'}.db")
    return f"set {_VARIABLE} to {sqlite_uri(Path(str(file).replace('?', '_')))}"


def _check_sqlite(uri: str) -> None:
    file = sqlite_file(uri)
    if file is None:
        found = _SQLITE.fullmatch(uri)
        assert found is not None
        name = found["rest"].partition("?")[0]
        named = "" if ":memory:" in name else name.removeprefix("file:")
        lasts = "names no file in which runs could be kept" if named else "keeps runs only until the command ends"
        raise InputError(f"{_VARIABLE} is {uri!r}, which {lasts}: {_advice(named or 'mlflow.db')}")
    given = os.environ.get(_VARIABLE, "").strip().partition(":")[2].lstrip("/")
    if given.startswith("~"):  # SQLite would make a folder of that name
        home = Path(given.partition("?")[0]).expanduser()
        raise InputError(
            f"{_VARIABLE} is {os.environ[_VARIABLE]!r}, and ~ is not replaced there: set {_VARIABLE} to "
            f"{sqlite_uri(home)}"
        )
    other = f"set {_VARIABLE} to a file in a folder of yours, such as sqlite:////home/me/mlflow.db"
    try:
        make_folder(uri)
        if file.is_dir():
            raise TemporaryError(
                f"runs cannot be recorded in {file}, which is a folder: {_advice(str(file / 'mlflow.db'))}"
            )
        if file.exists() and file.stat().st_size and not _is_sqlite(file):
            raise TemporaryError(f"runs cannot be recorded in {file}, which is no SQLite database: {other}")
        with tempfile.TemporaryFile(dir=file.parent) as probe:
            os.posix_fallocate(probe.fileno(), 0, _NEEDED_BYTES)
        if file.exists():
            with closing(sqlite3.connect(file, timeout=0)) as database:
                database.execute("begin immediate")
                database.execute("create table hfb_can_write (a)")  # SQLite begins on a file that it may only read
                database.rollback()
    except OSError as error:
        raise TemporaryError(
            f"runs cannot be recorded in {file} ({error.strerror or error}): {_mend(error, other)}"
        ) from None
    except sqlite3.DatabaseError as error:
        if "locked" not in str(error):  # by a record of another process, which is soon over
            raise TemporaryError(f"runs cannot be recorded in {file} ({error}): {other}") from None


def _is_sqlite(file: Path) -> bool:
    with file.open("rb") as opened:
        return opened.read(len(_SQLITE_MAGIC)) == _SQLITE_MAGIC


def _mend(error: OSError, other: str) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return f"free some space, or {other}" if full else other
