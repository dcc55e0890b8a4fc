"""The judge, whole: cases are made, methods run on them, and the tables hold what happened."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas
import pytest

from hfb.datasets.case import load_case
from hfb.datasets.motions.sources import open_motions
from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.flows.benchmark import BenchmarkPlan, run_benchmark, run_synthesis
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.motion.motion_file import load_motion, save_motion
from hfb.motion.sampled import SampledMotion
from hfb.tasks.core.result_folder import is_unfinished
from tests.orchestration import mlflow_rows

_OTHER_SEED = """
import sys
from pathlib import Path
from hfb.datasets.set_spec import SetSpec
from hfb.flows.benchmark import run_synthesis
run_synthesis(SetSpec(set="bt-amass", size_px=64, seed=4), 2, Path(sys.argv[1]), 1)
"""
TINY_TOML = """
preset = "best"
[fit]
subframes = 2
texture_px = 16
stages = [{ size_px = 32, iterations = 3 }]
"""


@pytest.fixture
def plan(tmp_path: Path) -> BenchmarkPlan:
    (tmp_path / "tiny.toml").write_text(TINY_TOML)
    methods = (method_spec("static"), method_spec(f"tiny={tmp_path / 'tiny.toml'}"))
    spec = SetSpec(set="bt-amass", size_px=64, seed=3, fill="even")
    return BenchmarkPlan(spec=spec, count=2, methods=methods, start="simulated")


def contents(out: Path) -> dict[str, bytes]:
    """Everything that has to come out the same; how long a method took does not."""
    kept = {"cases.parquet", "summary.json", "table.md", "result.json", "row.json", "report.html"}
    files = [path for path in sorted(out.rglob("*")) if path.is_file() and "intermediate" not in path.parts]
    return {str(path.relative_to(out)): path.read_bytes() for path in files if path.name not in kept}


def rows(out: Path) -> list[dict]:
    return json.loads(pandas.read_parquet(out / "cases.parquet").drop(columns="seconds").to_json(orient="records"))


def test_tables_record_and_workers(plan: BenchmarkPlan, store: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    result = run_benchmark(plan, one, 1)

    cells = result["methods"]
    assert list(cells) == ["static", "tiny"]
    assert cells["static"]["all"]["ratio"] == pytest.approx(1)
    assert cells["tiny"]["all"]["n"] == 2
    assert json.loads((one / "summary.json").read_text())["methods"] == cells
    assert {"table.md", "gallery.png", "error_by_blur.png", "error_by_joint.png"} <= {p.name for p in one.iterdir()}
    assert read_picture_srgb(one / "gallery.png").shape[0] > 200  # of the first method that has something to show
    table = pandas.read_parquet(one / "cases.parquet")
    assert len(table) == 4
    assert table["failed"].isna().all()
    said = table[table["method"] == "tiny"]
    assert said["within_p50"].between(0, 1).all()
    assert (said["radius_mm"] > 1).all()
    assert cells["tiny"]["all"]["radius_error"] is not None
    assert cells["static"]["all"]["radius_error"] is None
    assert (one / "reliability.png").exists()
    assert "How sure it is" in (one / "table.md").read_text()
    assert len(list((one / "methods" / "tiny").glob("case_*/alternatives.npz"))) == 2
    assert (table.groupby("case")["initial_mpjpe_mm"].nunique() == 1).all()

    page = (one / "report.html").read_text()
    assert result["page"] == str(one / "report.html")
    assert "method tiny" in page
    assert page.count('id="case-') == 2
    artifacts = {path.name for path in (tmp_path / "mlflow-artifacts").rglob("*") if path.is_file()}
    assert {"report.html", "table.md", "gallery.png"} <= artifacts

    runs = mlflow_rows(store, "select name, status from runs")
    assert sorted(runs) == [("bt-amass", "FINISHED"), ("bt-amass/static", "FINISHED"), ("bt-amass/tiny", "FINISHED")]
    parents = mlflow_rows(store, "select value from tags where key = 'mlflow.parentRunId'")
    assert {value for (value,) in parents} == {result["mlflow_run_id"]}

    run_benchmark(plan, two, 2)  # another folder takes nothing from the first: all is computed again, by two processes
    assert contents(two) == contents(one)
    assert rows(two) == rows(one)


def test_goes_on_where_it_stopped(plan: BenchmarkPlan, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_benchmark(plan, out, 1)
    first = {path: path.stat().st_mtime_ns for path in out.rglob("row.json")}
    (out / "methods" / "tiny" / "case_0002" / "row.json").write_text("{}")  # damaged meanwhile
    result = run_benchmark(plan.model_copy(update={"count": 3}), out, 1)
    assert result["methods"]["tiny"]["all"]["n"] == 3
    again = [path for path, stamp in first.items() if path.stat().st_mtime_ns != stamp]
    assert again == [out / "methods" / "tiny" / "case_0002" / "row.json"]


def test_damaged_motions_are_named_and_left_out(plan: BenchmarkPlan, store: Path, tmp_path: Path) -> None:
    motions = tmp_path / "motions"
    motions.mkdir()
    write_motion(motions / "good.npz")
    write_motion(motions / "nan.npz", broken=np.nan)
    (motions / "empty.bvh").write_text("")
    (motions / "text.npz").write_text("no archive")
    spec = plan.spec.model_copy(update={"motions": motions, "fill": "natural"})
    result = run_benchmark(plan.model_copy(update={"spec": spec, "methods": plan.methods[:1]}), tmp_path / "out", 1)
    assert result["methods"]["static"]["all"]["n"] == 2
    assert result["skipped"] == 3
    assert set(result["skipped_reasons"]) == {"nan.npz", "empty.bvh", "text.npz"}
    for name in ("good.npz",):
        (motions / name).unlink()
    with pytest.raises(InputError, match="no case can be made"):
        run_benchmark(plan.model_copy(update={"spec": spec}), tmp_path / "none", 1)
    assert not (tmp_path / "none").exists()


def test_cases_alone(store: Path, tmp_path: Path) -> None:
    result = run_synthesis(SetSpec(set="bt-amass", size_px=64, seed=3, frames=2), 1, tmp_path / "out", 1)
    assert result["count"] == 1
    case = load_case(tmp_path / "out" / "case_0001")
    named = [*case.frame_paths(), case.background, case.clip, case.truth, *case.true_matte_paths(), *case.start_paths()]
    assert all(path.is_file() for path in named)
    assert run_synthesis(SetSpec(set="bt-amass", size_px=64, seed=3, frames=2), 1, tmp_path / "again", 1)["count"] == 1
    again = load_case(tmp_path / "again" / "case_0001")  # files of its own, not the first folder's
    assert [path.read_bytes() for path in again.frame_paths()] == [path.read_bytes() for path in case.frame_paths()]


def test_cases_of_two_sets_are_told_after_a_kill(store: Path, tmp_path: Path) -> None:
    out, facts = tmp_path / "out", tmp_path / "out" / "case_0001" / "case.json"
    run_synthesis(SetSpec(set="bt-amass", size_px=64, seed=3), 2, out, 1)
    process = subprocess.Popen([sys.executable, "-c", _OTHER_SEED, str(out)], cwd=Path(__file__).parents[2])
    while not facts.exists() or json.loads(facts.read_text())["seed"] == 3:
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert is_unfinished(out)
    run_synthesis(SetSpec(set="bt-amass", size_px=64, seed=4), 2, out, 1)
    assert not is_unfinished(out)
    assert [load_case(path).facts["seed"] for path in sorted(out.glob("case_*"))] == [4, 4]


def write_motion(path: Path, broken: float | None = None) -> None:
    """A lively motion file of our own, in camera coordinates."""
    clip = open_motions(None, 0).load(1)
    frames = len(clip.poses)
    poses = clip.poses.copy()
    if broken is not None:
        poses[5, 3, 1] = broken
    times_s = np.arange(frames) / clip.fps
    motion = SampledMotion(
        poses.reshape(frames, 72),
        clip.translations,
        np.zeros(10),
        np.zeros((frames, 24, 3)),
        times_s,
        np.zeros(frames, int),
        np.eye(3),
    )
    save_motion(path, motion, "hfb")
    assert broken is not None or np.isfinite(load_motion(path)[0].poses).all()
