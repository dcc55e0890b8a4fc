"""`hfb models` names everything that can be plugged in, offline."""

import json
from pathlib import Path

import pytest

from hfb.flows.cli.cli import main
from hfb.networks.registry import list_models


def test_everything_has_a_licence_and_a_way_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path))
    models = list_models()
    assert all(model.licence and model.get and model.role and model.use for model in models)
    named = " ".join(model.name for model in models)
    for name in (
        "SMPL",
        "BackgroundMattingV2",
        "METRO",
        "RTMPose",
        "ViTPose",
        "WHAM",
        "PHALP",
        "GVHMR",
        "MediaPipe",
        "VPoser",
    ):
        assert name in named
    assert {model.present for model in models} == {True, False, None}


def test_the_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path))
    assert main(["models", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["present"] for one in told["networks"]] == [False] * 3
    assert len(told["models"]) == len(list_models())
    assert main(["models"]) == 0
    text = capsys.readouterr().out
    assert "--matting bgmv2 --matting-weights FILE" in text
    assert max(map(len, text.splitlines())) <= 110
