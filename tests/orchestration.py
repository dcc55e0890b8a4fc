"""One real Prefect server and a migrated MLflow store for all tests of tasks and flows, and a tiny problem for them."""

import atexit
import functools
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import cv2
import platformdirs
import pytest
from filelock import FileLock

TINY_FIT = '[{"size_px": 32, "iterations": 3}]'
TINY_OPTIONS = (
    "--init.method",
    "matte",
    "--fit.stages",
    TINY_FIT,
    "--fit.subframes",
    "2",
    "--fit.texture-px",
    "16",
    "--export.report",
    "false",
    "--export.films",
    "none",
)
_SIDE_PX = 96
RUN_FOLDER = "TEST_RUN_FOLDER"  # the variable that names the folder which a run's processes share
_CACHE = platformdirs.user_cache_path("hfb") / "tests"


@functools.cache
def _session_folder() -> Path:
    folder = tempfile.mkdtemp(prefix="hfb-tests-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def made_for_run(name: str, make: Callable[[Path], None]) -> Path:
    """A folder that all processes of this test run read, made by the first that needs it."""
    run = Path(os.environ.get(RUN_FOLDER) or _session_folder())
    folder, done = run / name, run / f"{name}.done"
    with FileLock(run / f"{name}.lock"):
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


@functools.cache
def prefect_api() -> str:
    """A temporary server with its own home, started once for the whole session; it ends with the process."""
    os.environ.pop("PREFECT_API_URL", None)
    os.environ["PREFECT_HOME"] = str(_session_folder() / "prefect")
    os.environ["PREFECT_PROFILES_PATH"] = str(_session_folder() / "profiles.toml")  # no settings of the developer's
    os.environ["PREFECT_LOGGING_TO_API_ENABLED"] = "false"
    os.environ["XDG_STATE_HOME"] = str(_session_folder() / "state")
    from prefect.context import refresh_global_settings_context
    from prefect.logging.configuration import setup_logging

    from hfb.flows.runtime.server import PrefectServer

    refresh_global_settings_context()
    setup_logging()  # now: the first flow of a process would take caplog's handler away
    (_session_folder() / "prefect").mkdir(exist_ok=True)
    shutil.copy(prefect_tables(), _session_folder() / "prefect")
    PrefectServer().wait()
    return os.environ["PREFECT_API_URL"]


def prefect_tables() -> Path:
    """The database of a temporary server on which nothing ran; its name is the one that servers look for."""
    return made_once(f"prefect-{version('prefect')}.db", _make_prefect_tables)


def _make_prefect_tables(path: Path) -> None:
    """The database of a first server, which makes its tables for ten seconds."""
    home = path.with_suffix(".home")
    program = "from hfb.flows.runtime.server import PrefectServer; PrefectServer().wait()"
    settings = {name: value for name, value in os.environ.items() if name != "PREFECT_API_URL"}
    root = str(Path(__file__).parents[1])
    subprocess.run([sys.executable, "-c", program], check=True, cwd=root, env={**settings, "PREFECT_HOME": str(home)})
    (source,) = home.glob("**/prefect-*.db")
    with closing(sqlite3.connect(source)) as live, closing(sqlite3.connect(path)) as copy:
        live.backup(copy)
    shutil.rmtree(home)


def made_once(name: str, make: Callable[[Path], None]) -> Path:
    """A file that takes long to make and never changes, kept for other test processes and runs.

    Args:
        name: with the versions that it depends on.
        make: writes the file.
    """
    try:
        _CACHE.mkdir(parents=True, exist_ok=True)
        path = _CACHE / name
    except OSError:  # no folder of the user's can be written
        path = _session_folder() / name
    with FileLock(f"{path}.lock"):
        if not path.exists():
            part = path.with_name(f"part-{name}")
            part.unlink(missing_ok=True)
            make(part)
            part.rename(path)
    return path


@functools.cache
def migrated_store() -> Path:
    """An MLflow database with tables and nothing in them: making one takes seconds, copying it does not."""
    return made_once(f"mlflow-{version('mlflow')}.db", _make_store)


def _make_store(path: Path) -> None:
    from hfb.tasks.tracking import tracking

    tracking.client_of(f"sqlite:///{path}").get_experiment_by_name("none")


@contextmanager
def orchestrated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Everything that a run leaves outside its --out goes into a folder; yields the MLflow database."""
    api = prefect_api()
    store = folder / "mlflow.db"
    shutil.copy(migrated_store(), store)
    monkeypatch.setenv("PREFECT_API_URL", api)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{store}")
    monkeypatch.setenv("PREFECT_LOCAL_STORAGE_PATH", str(folder / "records"))
    monkeypatch.setenv("XDG_DATA_HOME", str(folder / "data"))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    from prefect.settings import PREFECT_LOCAL_STORAGE_PATH, temporary_settings

    with temporary_settings({PREFECT_LOCAL_STORAGE_PATH: folder / "records"}):
        yield store


@dataclass(frozen=True)
class Problem:
    """The embedded example, small, and its true middle pose."""

    frame: Path
    background: Path
    first_body: Path


@functools.cache
def example() -> Path:
    """The embedded example at its full size, made once."""
    from hfb.datasets.example import write_example

    return made_for_run("example", lambda folder: write_example(folder, 0))


def true_first_body(path: Path) -> Path:
    """The true pose in the middle of the example's exposure, as a first-body file."""
    import torch

    from hfb.datasets.truth import load_truth
    from hfb.motion.static_pose import FirstBody, save_first_body

    true = load_truth(example() / "truth.npz").motion
    middle = len(true.poses) // 2
    numbers = (true.poses[middle].reshape(24, 3), true.trans[middle], true.betas)
    save_first_body(path, FirstBody(*(torch.from_numpy(one).float() for one in numbers), "truth"))
    return path


def tiny_problem(folder: Path) -> Problem:
    """A 96 px copy of the example; its guessed camera sees the same as the example's."""
    folder.mkdir(parents=True, exist_ok=True)
    problem = Problem(folder / "frame.png", folder / "background.png", true_first_body(folder / "first_body.npz"))
    for name, target in (("frame_0.png", problem.frame), ("background.png", problem.background)):
        small = cv2.resize(cv2.imread(str(example() / name)), (_SIDE_PX, _SIDE_PX), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(target), small)
    return problem


def mlflow_rows(store: Path, query: str) -> list[tuple]:
    """What lies in the MLflow database."""
    with sqlite3.connect(store) as database:
        return database.execute(query).fetchall()


def is_finished(folder: Path) -> bool:
    """Whether a folder holds a complete result."""
    from hfb.tasks.core.result_folder import is_unfinished

    return (folder / "result.json").is_file() and not is_unfinished(folder)
