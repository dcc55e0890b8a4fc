"""The judge from the command line: what a user types, and what is printed."""

import argparse
import json
from pathlib import Path

import pytest

from hfb.config import InitConfig
from hfb.datasets.case import load_case
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.evaluation.experiments import find_experiment
from hfb.flows.benchmark import BenchmarkPlan
from hfb.flows.cli import judging
from hfb.flows.cli.cli import main
from tests.evaluation.test_tables import NAMED_IN_THE_INTERFACE

TOML = """
[fit]
subframes = 2
texture_px = 16
stages = [{ size_px = 32, iterations = 2 }]
"""


@pytest.fixture
def tiny(tmp_path: Path) -> str:
    (tmp_path / "tiny.toml").write_text(TOML)
    return f"tiny={tmp_path / 'tiny.toml'}"


def test_benchmark(tiny: str, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = [
        "benchmark",
        "bt-amass",
        "--count",
        "1",
        "--size",
        "64",
        "--seed",
        "2",
        "--workers",
        "1",
        "--out",
        str(out),
    ]
    assert main([*words, "--methods", f"{tiny},static", "--json", "--quiet"]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {"set", "count", "skipped", "seed", "methods"} <= printed.keys()
    cell = printed["methods"]["tiny"]["all"]
    assert cell.keys() >= NAMED_IN_THE_INTERFACE
    assert cell["best_of_two_iou"] > 0
    assert [one["blur"] for one in printed["methods"]["tiny"]["bins"]][-1] == [0.9, 1.1]

    # The very case, as a user's own pictures.
    case = load_case(out / "cases" / "case_0001")
    fitted = ["fit", str(case.frame_paths()[0]), "--background", str(case.background), "--clip", str(case.clip)]
    options = ["--config", str(tmp_path / "tiny.toml"), "--init.method", "matte", "--quiet", "--json"]
    assert main([*fitted, *options, "--out", str(tmp_path / "fit")]) == 0


def test_reproduce(
    tiny: str, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    words = ["reproduce", "table1", "--count", "1", "--size", "64", "--workers", "1", "--out", str(out)]
    assert main([*words, "--methods", "static"]) == 0
    printed = capsys.readouterr().out
    assert "104.3" in printed  # the paper's METRO, weighted by cases
    assert (out / "beside_paper.md").read_text() in printed
    assert "Table 1: " in (out / "report.html").read_text()


def test_every_experiment_is_found() -> None:
    for number in range(1, 6):
        experiment = find_experiment(f"table{number}")
        judging.method_specs(",".join(experiment.methods), None)


def _plan(words: str) -> BenchmarkPlan:
    parser = argparse.ArgumentParser()
    parser.add_argument("set")
    judging.add_set_flags(parser)
    judging.add_method_flags(parser)
    return judging.plan_of(parser.parse_args(words.split()), 1)


def test_a_way_to_estimated_starts() -> None:
    own = _plan("bt-amass --init keypoints --init-weights k.onnx")
    assert own.start == "estimated"
    assert own.init == InitConfig(method="keypoints", weights=Path("k.onnx"))
    assert _plan("bt-amass --init auto").start == "estimated"
    assert _plan("bt-amass").init == InitConfig()
    with pytest.raises(InputError, match="leave --start simulated out"):
        _plan("bt-amass --start simulated --init matte")


def test_sets_of_real_video() -> None:
    plan = _plan("real --videos a --videos b/c --average 1,3,5 --count 7")
    assert isinstance(plan.spec, RealSpec)
    assert (plan.spec.set, plan.spec.videos, plan.spec.average) == ("real", (Path("a"), Path("b/c")), (1, 3, 5))
    names = [method.name for method in plan.methods]
    assert {"static", "best", "oracle-middle", "oracle-floor", "best@true-start", "best@true-front"} == set(names)
    assert (plan.start, plan.count) == ("estimated", 7)
    usual = _plan("real --videos a").spec
    assert isinstance(usual, RealSpec)
    assert usual.average == (1, 3, 5, 9, 15)
    paper = _plan("b-aist --videos a --average 1")
    assert isinstance(paper.spec, RealSpec)
    assert (paper.spec.set, paper.spec.videos, paper.spec.average) == ("b-aist", (Path("a"),), (1,))
    assert [method.name for method in paper.methods] == ["best", "paper", "static"]
    (nine,) = _plan("b-aist --videos a").spec.average  # type: ignore[union-attr]
    assert nine == 9
    drawn = _plan("bt-amass --methods static")
    assert isinstance(drawn.spec, SetSpec)
    assert (drawn.start, [method.name for method in drawn.methods]) == ("simulated", ["static"])


@pytest.mark.parametrize("given", ["0", "3,0", "x", "", ",", "3,,x", "400"])
def test_an_impossible_number_of_frames_is_told(given: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["benchmark", "real", "--videos", str(tmp_path), "--average", given, "--out", str(tmp_path / "out")]
    try:
        code = main(words)
    except SystemExit as left:
        code = left.code
    assert code == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "average" in said
    assert not (tmp_path / "out").exists()


def test_real_without_videos_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "real"]) == 2
    assert "real is made from real video: give a folder with --videos DIR" in capsys.readouterr().err
