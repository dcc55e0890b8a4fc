"""`hfb batch` from the command line: what a scheduler that started it is told."""

import json
import os
from pathlib import Path

import pytest

from hfb.flows.cli.cli import main


def test_the_exit_code_tells_of_a_clip_without_a_result(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clips, out = tmp_path / "clips", tmp_path / "out"
    clips.mkdir()
    words = ["batch", str(clips), "--out", str(out), "--workers", "1", "--json"]
    assert main(words) == 0  # nothing to do
    (clips / "broken.mp4").write_text("no video")
    os.utime(clips / "broken.mp4", (1_700_000_000, 1_700_000_000))
    assert main(words) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["set_aside"] == 1
