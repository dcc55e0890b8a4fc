"""`hfb synth clip` as it is typed: its own options, and a folder that holds something."""

from pathlib import Path

import pytest

from hfb.flows.cli.cli import main


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["clip", "--count", "20"], "--count is for the cases of a set: leave it out"),
        (["clip", "--fill=even"], "--fill is for the cases of a set: leave it out"),
        (["bt-amass", "--mp4"], "leave --mp4 out, or take `hfb synth clip`"),
    ],
)
def test_options_of_the_other_kind_are_refused(
    words: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["synth", *words, "--out", "made"]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "made").exists()
