"""Where runs are recorded: a server, or a SQLite file of the user's own. Knows no MLflow, so it is light to import."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import urlopen

import platformdirs

from hfb.errors import InputError
from tasks.secrets import shown_address, without_login

LOCAL_PORT = 5000
LOCAL_PAGES = f"http://127.0.0.1:{LOCAL_PORT}"
# What a server of pages for one person needs not do; it takes 3 GB of memory otherwise.
SMALL_SERVER = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
_HEALTH_TIMEOUT_S = 3


def tracking_uri() -> str:
    """Where runs are recorded."""
    return os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{platformdirs.user_data_path('hfb') / 'mlflow.db'}"


def check_store(uri: str) -> None:
    """Ask a tracking server whether it is there, before MLflow waits minutes for it.

    Raises:
        InputError: the store does not answer, or MLflow no longer takes its kind.
    """
    scheme = urlsplit(uri).scheme
    if scheme in ("", "file"):
        raise InputError(
            f"MLflow no longer keeps runs in plain folders: set MLFLOW_TRACKING_URI to sqlite:///{shown_address(uri)}.db"
        )
    if not on_server(uri):
        return
    try:
        with urlopen(f"{without_login(uri).rstrip('/')}/health", timeout=_HEALTH_TIMEOUT_S):
            return
    except HTTPError as error:
        if error.code in (401, 403):  # a server that asks for a login is there
            return
        reason = f"answers {error.code}"
    except (URLError, OSError) as error:
        reason = f"does not answer ({getattr(error, 'reason', error)})"
    raise InputError(
        f"the MLflow server at {shown_address(uri)} {reason}: start it, or unset MLFLOW_TRACKING_URI to record locally"
    )


def on_server(uri: str) -> bool:
    """Whether runs go to a server, which has pages of its own."""
    return urlsplit(uri).scheme in ("http", "https")


def pages_command(port: int = LOCAL_PORT) -> list[str]:
    """The command that shows a local store's runs in a browser; it stays small in the environment SMALL_SERVER.

    Raises:
        InputError: runs go to a server.
    """
    uri = tracking_uri()
    if on_server(uri):
        raise InputError(f"runs are recorded on a server that has pages of its own: open {shown_address(uri)}")
    make_folder(uri)
    return [
        sys.executable, "-m", "mlflow", "server", "--backend-store-uri", uri, "--host", "127.0.0.1",
        "--port", str(port), "--workers", "1", "--uvicorn-opts", "--log-level warning",
    ]  # fmt: skip


def make_folder(uri: str) -> None:
    """The folder of a local store's file; SQLite makes none."""
    if uri.startswith("sqlite:///"):
        Path(uri.removeprefix("sqlite:///")).parent.mkdir(parents=True, exist_ok=True)
