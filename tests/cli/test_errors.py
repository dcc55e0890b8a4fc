"""What a user gets wrong: one sentence that names the fix, exit code 2, and nothing left behind."""

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hfb.flows.cli.cli import main
from hfb.io.media.images.image_io import read_picture_srgb, write_png
from tests.orchestration import TINY_OPTIONS, Problem


@pytest.fixture
def files(problem: Problem, tmp_path: Path) -> dict[str, str]:
    """Good and bad files by name."""
    made = {"frame": problem.frame, "plate": problem.background}
    for name, content in {
        "text.png": b"this is no picture",
        "empty.png": b"",
        "half.png": problem.frame.read_bytes()[:900],
        "bad.toml": b"[fit\n",
        "typo.toml": b"[fit]\nsubframe = 3\n",
        "clip.toml": b"[camera]\nfocal = 3\n",
        "file": b"",
    }.items():
        made[name] = tmp_path / name
        made[name].write_bytes(content)
    made["small.png"] = tmp_path / "small.png"
    write_png(made["small.png"], read_picture_srgb(problem.background)[:50])
    made["arrays.npz"] = tmp_path / "arrays.npz"
    np.savez(made["arrays.npz"], a=np.zeros(3))
    return {name: str(path) for name, path in made.items()} | {"none": str(tmp_path / "none"), "folder": str(tmp_path)}


CASES = {
    "missing frame": ("{none} --background {plate}", "none does not exist"),
    "missing plate": ("{frame} --background {none}", "none does not exist"),
    "a folder": ("{folder} --background {plate}", "is a folder"),
    "text as picture": ("{text.png} --background {plate}", "text.png"),
    "empty file": ("{empty.png} --background {plate}", "empty.png"),
    "half a picture": ("{half.png} --background {plate}", "half.png"),
    "text as plate": ("{frame} --background {text.png}", "text.png"),
    "plate of another size": ("{frame} --background {small.png}", "small.png 96 x 50 px"),
    "second frame of another size": ("{frame} {small.png} --background {plate}", "small.png is 96 x 50 px"),
    "empty matte": ("{plate} --background {plate}", "no person"),
    "missing body": ("{frame} --background {plate} --body.model {none}", "none does not exist"),
    "a body that is none": ("{frame} --background {plate} --body.model {arrays.npz}", "arrays.npz"),
    "text as body": ("{frame} --background {plate} --body.model {text.png}", "text.png"),
    "missing prior": ("{frame} --background {plate} --prior.pose {none}", "none does not exist"),
    "missing motion prior": ("{frame} --background {plate} --prior.motion {none}", "none does not exist"),
    "text as motion prior": ("{frame} --background {plate} --prior.motion {text.png}", "hfb train-prior"),
    "no TOML": ("{frame} --background {plate} --config {bad.toml}", "not valid TOML"),
    "unknown option": ("{frame} --background {plate} --fit.subframe 4", "did you mean --fit.subframes?"),
    "unlike any option": ("{frame} --background {plate} --zzz", "see `hfb fit --help`"),
    "unknown key": ("{frame} --background {plate} --config {typo.toml}", "did you mean fit.subframes"),
    "bad clip": ("{frame} --background {plate} --clip {clip.toml}", "did you mean camera.focal_px"),
    "exposure longer than the interval": (
        "{frame} {frame} --background {plate} --exposure.seconds 1",
        "does not fit",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_one_sentence_and_nothing_left(
    case: str, files: dict[str, str], store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words, says = CASES[case]
    out = tmp_path / "deep" / "out"
    arguments = [files[word[1:-1]] if word.startswith("{") else word for word in words.split()]
    code = main(["fit", *arguments, "--out", str(out), "--json", *TINY_OPTIONS])
    shown = capsys.readouterr()
    assert code == 2
    last = shown.err.strip().splitlines()[-1]
    assert last.startswith("hfb: ")
    assert says in last
    assert "Traceback" not in shown.err + shown.out
    assert json.loads(shown.out.splitlines()[-1]) == {"error": last.removeprefix("hfb: ")}
    assert not out.parent.exists()


@pytest.mark.parametrize("command", ["fit", "demo"])
def test_a_place_that_cannot_be_written(
    command: str, files: dict[str, str], store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = [files["frame"], "--background", files["plate"]] if command == "fit" else []
    for out in (files["file"], files["file"] + "/deeper"):
        assert main([command, *pictures, "--out", out]) == 2
        assert "choose another --out" in capsys.readouterr().err
        assert Path(files["file"]).read_bytes() == b""


def test_two_at_once(problem: Problem, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hfb.tasks.results.workspace import workspace

    with workspace(tmp_path / "out"):
        code = main(
            ["fit", str(problem.frame), "--background", str(problem.background), "--out", str(tmp_path / "out")]
        )
    assert code == 2
    assert "another hfb is working in" in capsys.readouterr().err
    assert (tmp_path / "out" / "intermediate").exists()


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("MLFLOW_TRACKING_URI", "http://127.0.0.1:9", "MLflow server at http://127.0.0.1:9 does not answer"),
        ("MLFLOW_TRACKING_URI", "mlruns", "set MLFLOW_TRACKING_URI to sqlite:///"),
        ("MLFLOW_TRACKING_URI", "sqlite://", "keeps runs only until the command ends"),
        ("MLFLOW_TRACKING_URI", "http://[::1", "MLFLOW_TRACKING_URI is 'http://[::1'"),
        ("PREFECT_API_URL", "notaurl", "PREFECT_API_URL is 'notaurl', which does not begin with http://"),
        ("PREFECT_API_URL", "http://host:port/api", "PREFECT_API_URL is 'http://host:port/api'"),
    ],
)
def test_servers_that_are_not_there(
    name: str,
    value: str,
    says: str,
    problem: Problem,
    store: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv(name, value)
    out = tmp_path / "out"
    code = main(["fit", str(problem.frame), "--background", str(problem.background), "--out", str(out)])
    assert code == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


def test_a_prefect_server_that_is_not_there(
    problem: Problem, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from prefect.settings import PREFECT_API_URL, temporary_settings

    with temporary_settings({PREFECT_API_URL: "http://127.0.0.1:9/api"}):
        code = main(
            ["fit", str(problem.frame), "--background", str(problem.background), "--out", str(tmp_path / "out")]
        )
    assert code == 2
    assert "Prefect server at http://127.0.0.1:9/api does not answer" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("variable", "profiles"),
    [("PREFECT_CLIENT_MAX_RETRIES", ""), ("NONE", "active = 'mine'\n[profiles.mine"), ("NONE", "a\0b"), ("NONE", None)],
)
def test_settings_of_prefect_that_cannot_be_used(variable: str, profiles: str | None, tmp_path: Path) -> None:
    """Prefect reads them while it is imported, before anything can be asked. None: a folder in the file's place."""
    if profiles is None:
        (tmp_path / "profiles.toml").mkdir()
    else:
        (tmp_path / "profiles.toml").write_text(profiles)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    environment |= {"PREFECT_HOME": str(tmp_path), "XDG_STATE_HOME": str(tmp_path), variable: "abc"}
    done = subprocess.run(
        [sys.executable, "-m", "hfb.flows.cli.cli", "report", str(tmp_path), "--quiet"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    (told,) = done.stderr.strip().splitlines()
    assert done.returncode == 2, done.stderr
    assert told.startswith("hfb: Prefect's settings cannot be used")
    assert str(tmp_path / "profiles.toml") in told
    assert "Traceback" not in done.stderr


def test_the_unexpected_points_to_the_log(
    problem: Problem,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import hfb.tasks.image.matte

    def broken(*_arguments: object, **_named: object) -> None:
        raise RuntimeError("a wire came loose")

    monkeypatch.setattr(hfb.tasks.image.matte, "person_matting", broken)
    # a command that an earlier test of this process ran logs into that test's folder
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    out = tmp_path / "out"
    code = main(["fit", str(problem.frame), "--background", str(problem.background), "--out", str(out), "--json"])
    shown = capsys.readouterr()
    assert code == 1
    assert "unexpected RuntimeError: a wire came loose" in json.loads(shown.out)["error"]
    assert "Traceback" not in shown.err
    log = Path(shown.err.strip().rpartition("the log is ")[2])
    assert "a wire came loose" in log.read_text()
    assert not (out / "result.json").exists()
