"""Where hfb's own Prefect lives: never in the user's home of Prefect, whose settings count all the same."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.flows.runtime.prefect_home import check_home, make_home, use_own_home
from tests.orchestration import TINY_OPTIONS, Problem

ROOT = Path(__file__).parents[2]
SETTINGS = """
import json
import hfb.flows
from prefect.settings import get_current_settings
found = get_current_settings()
print(json.dumps([str(found.home), found.api.url]))
"""


@pytest.fixture(autouse=True)
def _no_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PREFECT_HOME", "PREFECT_PROFILES_PATH", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))


def own_home() -> Path:
    use_own_home()
    return Path(os.environ["PREFECT_HOME"])


def test_it_is_hfbs_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert own_home() == tmp_path / ".local/state/hfb/prefect"
    assert os.environ["PREFECT_PROFILES_PATH"] == str(tmp_path / ".prefect/profiles.toml")
    assert own_home() == tmp_path / ".local/state/hfb/prefect", "a process that hfb starts has the same"
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path / "mine"))
    monkeypatch.delenv("PREFECT_PROFILES_PATH")
    assert own_home() == tmp_path / "mine" / "hfb", "below the one that the user has set, whose database stays"
    assert os.environ["PREFECT_PROFILES_PATH"] == str(tmp_path / "mine/profiles.toml")
    assert own_home() == tmp_path / "mine" / "hfb"
    monkeypatch.delenv("PREFECT_HOME")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert own_home() == tmp_path / "state/hfb/prefect"


@pytest.mark.parametrize("folder", [".prefect", "mine"])
def test_the_users_server_is_found_and_the_users_home_untouched(folder: str, tmp_path: Path) -> None:
    users = tmp_path / folder
    users.mkdir()
    (users / "profiles.toml").write_text(
        'active = "team"\n[profiles.team]\nPREFECT_API_URL = "http://team:4200/api"\nPREFECT_HOME = "/elsewhere"\n'
    )
    (users / "prefect.db").write_bytes(b"theirs")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    if folder != ".prefect":
        environment["PREFECT_HOME"] = str(users)
    done = subprocess.run(
        [sys.executable, "-c", SETTINGS], env=environment, capture_output=True, text=True, check=True, cwd=ROOT
    )
    own = tmp_path / ".local/state/hfb/prefect" if folder == ".prefect" else users / "hfb"
    assert json.loads(done.stdout) == [str(own), "http://team:4200/api"]
    assert {path.name for path in users.iterdir()} <= {"profiles.toml", "prefect.db", "hfb"}
    assert (users / "prefect.db").read_bytes() == b"theirs"


def test_the_users_own_variable_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path / "file"))
    use_own_home()
    remark = make_home()
    assert remark is not None
    assert "set PREFECT_HOME to keep them" in remark


def test_where_it_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    own_home()
    remark = make_home()
    assert remark is not None
    assert "set XDG_STATE_HOME to keep them" in remark
    assert Path(os.environ["PREFECT_HOME"]).is_dir()
    assert own_home() == Path(os.environ["PREFECT_HOME"])
    assert make_home() is None


def test_no_home_folder_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(os, "getuid", lambda: 987654)  # a container's user, of whom nobody has heard
    with pytest.raises(InputError, match="set HOME"):
        check_home()
    use_own_home()


def command(problem: Problem, folder: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    """`hfb fit` of a user none of whose folders can be made; without kernels of before it would compile for minutes."""
    (folder / "file").touch()
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": str(folder / "file" / "home"),
        "OMP_NUM_THREADS": "1",
        "NUMBA_CACHE_DIR": os.environ["NUMBA_CACHE_DIR"],
        **settings,
    }
    words = ["fit", str(problem.frame), "--background", str(problem.background), "--out", str(folder / "out")]
    return subprocess.run(
        [sys.executable, "-m", "hfb.flows.cli.cli", *words, "--json", *TINY_OPTIONS],
        env=environment,
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
        timeout=500,
    )


def test_a_home_that_cannot_be_written_names_the_variable(problem: Problem, tmp_path: Path) -> None:
    done = command(problem, tmp_path)
    assert done.returncode == 2, done.stderr
    assert "set MLFLOW_TRACKING_URI to a file in a folder of yours" in json.loads(done.stdout)["error"]
    assert not (tmp_path / "out").exists()


def test_with_that_variable_the_run_goes_on(problem: Problem, tmp_path: Path) -> None:
    done = command(problem, tmp_path, MLFLOW_TRACKING_URI=f"sqlite:///{tmp_path}/mlflow.db", TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["mlflow_run_id"]
    assert done.stderr.count("set XDG_STATE_HOME to keep them") == 1
    assert not list(tmp_path.glob("hfb-prefect-*")), "temporary files are gone"
