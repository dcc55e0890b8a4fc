"""The benchmark of real video, whole: recordings of known pixels and joints, whatever the number of workers."""

import json
from pathlib import Path

import pandas
import pytest

from hfb.config import InitConfig
from hfb.datasets.real.real_spec import RealSpec
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.flows.benchmark import BenchmarkPlan, run_benchmark
from tests.datasets.real.videos import write_recording
from tests.flows.test_benchmark import contents, rows
from tests.orchestration import mlflow_rows

_METHODS = ("static", "static@true-front", "static@true-start", "oracle-floor")


@pytest.fixture
def plan(tmp_path: Path) -> BenchmarkPlan:
    for name in ("gym", "park"):
        write_recording(tmp_path / "videos" / name, count=10)
    (tmp_path / "videos" / "park" / "text.mp4").write_bytes(b"no video" * 50)
    folders = tuple(tmp_path / "videos" / name for name in ("gym", "park"))
    spec = RealSpec(set="real", videos=folders, average=(1, 4), seed=3, size_px=128)
    methods = tuple(method_spec(name) for name in _METHODS)
    return BenchmarkPlan(spec=spec, count=2, methods=methods, start="estimated", init=InitConfig(method="matte"))


def test_recordings_oracles_record_and_workers(plan: BenchmarkPlan, store: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    result = run_benchmark(plan, one, 1)
    assert (result["set"], result["count"], result["skipped"]) == ("real", 2, 1)
    table = pandas.read_parquet(one / "cases.parquet")
    assert table["failed"].isna().all()
    assert set(table["recording"]) == {"gym", "park"}  # both had their turn, and both K
    assert set(table["average"]) == {1, 4}
    assert set(table["source"]) == {"gym/cam01_walk.mp4", "park/cam01_walk.mp4"}
    cells = {name: both["all"] for name, both in result["methods"].items()}
    assert cells["oracle-floor"]["mpjpe_mm"] < cells["static"]["mpjpe_mm"]
    assert cells["static@true-front"]["front_wrong"] == 0  # the figure's joints face away from the camera
    assert cells["static"]["motion_ratio"] == pytest.approx(1)
    assert cells["oracle-floor"]["motion_ratio"] < 0.3
    assert cells["static"]["n_motion"] == 1  # a sharp frame has no motion to tell
    assert [one["average"] for one in result["recordings"]][:3] == [1, 4, None]
    page = (one / "table.md").read_text()
    for words in ("# real: 2 cases", "mean of K = 1, 4 frames", "## By recording and K", "| K = 1 | K = 4 | all K |"):
        assert words in page
    assert "By recording and K" in (one / "report.html").read_text()
    runs = {name for (name,) in mlflow_rows(store, "select name from runs")}
    assert {"real", "real/oracle-floor"} < runs
    assert json.loads((one / "summary.json").read_text())["recordings"] == result["recordings"]

    run_benchmark(plan, two, 2)
    assert contents(two) == contents(one)
    assert rows(two) == rows(one)
