"""`hfb rerun` and `hfb compare` as they are typed."""

import json
from pathlib import Path
from typing import Any

import pytest

import hfb.flows.rerun
from hfb.flows.cli.cli import main
from hfb.flows.fit_image import fit_image
from tests.flows.test_fit_image import TINY
from tests.orchestration import Problem


@pytest.fixture
def run_id(problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A recorded fit, from a given first body: looking for one takes longer than all the rest."""
    monkeypatch.chdir(tmp_path)
    first = [problem.first_body]
    return fit_image([problem.frame], problem.background, Path("out"), TINY, first_bodies=first)["mlflow_run_id"]


def test_rerun_and_compare(
    run_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["rerun", run_id, "--out", "again", "--json", "--quiet"]) == 0
    shown = capsys.readouterr()
    verdict = json.loads(shown.out)
    assert verdict["bit_equal"]
    assert (verdict["mean_mm"], verdict["max_mm"], verdict["same_environment"]) == (0, 0, True)
    assert "Downloading" not in shown.err

    assert main(["compare", "out", "again", "--json"]) == 0
    compared = json.loads(capsys.readouterr().out)
    assert compared["run_a"] == run_id
    assert compared["run_b"] == verdict["mlflow_run_id"]
    assert compared["config"] == compared["environment"] == []
    assert Path(compared["page"]).parent.name == f"compare-{run_id[:8]}-{verdict['mlflow_run_id'][:8]}"

    assert main(["compare", run_id[:10], "again", "out"]) == 0
    assert capsys.readouterr().out.count("bit-equal") == 2

    # the recorded motion is another one: what was repeated differs from it
    (recorded,) = (path for path in (tmp_path / "mlflow-artifacts" / run_id).rglob("motion.npz"))
    recorded.unlink()
    real = hfb.flows.rerun.plan_rerun

    def of_another(*words: Any, **options: Any) -> hfb.flows.rerun.Plan:
        plan = real(*words, **options)
        plan.results["motion.npz"] = "0" * 64
        return plan

    monkeypatch.setattr(hfb.flows.rerun, "plan_rerun", of_another)
    assert main(["rerun", run_id]) == 3
    assert "Not the same motion" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("rerun", "0123456789abcdef"), "there is no run 0123456789abcdef"),
        (("rerun", "my run"), "is neither the id of a run nor a result's folder"),
        (("compare", "0123", "4567"), "there is no run 0123"),
        (("rerun", "0123", "--seed", "4"), "leave --seed out"),
    ],
)
def test_mistakes(
    words: tuple[str, ...],
    says: str,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*words, "--json"]) == 2
    shown = capsys.readouterr()
    assert says in shown.err.strip().splitlines()[-1]
    assert "Traceback" not in shown.err
    assert says in json.loads(shown.out)["error"]
    assert not (tmp_path / "runs").exists()
