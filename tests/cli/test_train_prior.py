"""`hfb train-prior`: what a user types, and what is printed."""

import json
from pathlib import Path

import pytest

from hfb.flows.cli.cli import main
from hfb.priors.load import load_pose_prior
from tests.flows.test_train_prior import record


def test_train_prior(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motions, out = record(tmp_path / "motions", 4), tmp_path / "poses.safetensors"
    words = ["train-prior", "--motions", str(motions), "--kind", "pose", "--epochs", "2", "--out", str(out)]
    assert main([*words, "--json", "--quiet"]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {"out", "sha256", "data", "measures", "training", "mlflow_run_id", "mlflow_link"} <= printed.keys()
    assert load_pose_prior(out) is not None

    assert main([*words, "--held-out", "motion_2*", "motion_3*", "--json", "--quiet"]) == 0
    data = json.loads(capsys.readouterr().out.splitlines()[-1])["data"]
    assert data["held_out"] == ["motion_2.npz", "motion_3.npz"]
    assert data["trained"] == ["motion_0.npz", "motion_1.npz"]

    assert main([*words, "--test", "motion_0*"]) == 0
    shown = capsys.readouterr()
    assert "learned from" in shown.out
    assert "tested" in shown.out
    assert "training" in shown.err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "--motions"),
        (["--motions", "{none}"], "is no folder"),
        (["--motions", "{motions}", "--epochs", "0"], "epochs"),
        (["--motions", "{motions}", "--seed", "-1"], "seed"),
        (["--motions", "{motions}", "--test", "nobody*"], "nobody"),
        (["--motions", "{motions}", "--held-out", "nobody*"], "nobody"),
        (["--motions", "{motions}", "--out", "{folder}/prior.txt"], "safetensors"),
        (["--motions", "{motions}", "--kind", "gait"], "gait"),
    ],
)
def test_mistakes_are_one_sentence(
    words: list[str], told: str, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motions = record(tmp_path / "motions", 2)
    places = {"none": tmp_path / "none", "motions": motions, "folder": tmp_path}
    filled = [word.format(**places) for word in words]
    out = [] if "--out" in filled else ["--out", str(tmp_path / "out" / "prior.safetensors")]
    assert main(["train-prior", *filled, *out, "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("hfb: ")
    assert told in line
    assert not (tmp_path / "out").exists()
