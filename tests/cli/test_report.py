"""`hfb report` of a folder that holds nothing but a motion."""

import json
from pathlib import Path

import pytest

from hfb.body.assets import load_default_body
from hfb.flows.cli.cli import main
from hfb.motion.motion_file import save_motion
from tests.interop.writers.motions import motion_of


@pytest.fixture
def result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A result's folder, away from the user's own files."""
    for name in ("XDG_DATA_HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    folder = tmp_path / "a result & more"
    save_motion(folder / "motion.npz", motion_of(load_default_body()), "hfb")
    return folder


def test_a_page_from_a_motion_alone(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(result), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    page = result / "report.html"
    assert told == {"report": str(page), "bytes": page.stat().st_size, "film": False, "surface": True}
    said = page.read_text()
    assert "Human from Blur: a result &amp; more" in said
    assert "was not recorded in MLflow" in said


def test_a_page_elsewhere_and_of_a_body_that_is_gone(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (result / "result.json").write_text(json.dumps({"config": {"body": {"model": "gone.npz"}}}))
    out = result.parent / "elsewhere"
    assert main(["report", str(result), "--out", str(out)]) == 0
    shown = capsys.readouterr()
    assert f"{out / 'report.html'}  (" in shown.out
    assert "without film, without surface" in shown.out
    assert "only the skeleton is shown" in shown.err
    assert not (result / "report.html").exists()


def test_what_is_no_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path), "--json"]) == 2
    assert "no motion file" in json.loads(capsys.readouterr().out)["error"]
