"""The same clip on other engines: threads, and a real Dask cluster whose workers see nothing but a store."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.flows.benchmark import BenchmarkPlan, run_benchmark
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.workers.engine import Engine, engine_of
from tests.flows.test_benchmark import TINY_TOML, contents, rows
from tests.orchestration import mlflow_rows
from tests.small_clips import assert_every_frame_once, finished, run_clip, small_clip

COMPARED = ("motion.npz", "strip.png", "texture.png", "edges.json")


def assert_same_bytes(out: Path) -> None:
    undisturbed, _, _ = finished()
    for name in COMPARED:
        assert (out / name).read_bytes() == (undisturbed / name).read_bytes()


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a Dask cluster of two worker processes."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def test_threads(store: Path, tmp_path: Path) -> None:
    made = small_clip()
    run_clip(made.truth.parent, tmp_path / "out", truth=made.truth, workers=engine_of("threads:2"))
    assert_same_bytes(tmp_path / "out")
    assert_every_frame_once(store)


def test_dask_with_a_store(scheduler: str, store: Path, tmp_path: Path) -> None:
    made, out = small_clip(), tmp_path / "out"
    engine = engine_of(f"dask:{scheduler}", (tmp_path / "shared").as_uri())
    result = run_clip(made.truth.parent, out, truth=made.truth, workers=engine)
    assert_same_bytes(out)
    assert_every_frame_once(store)
    assert 0 < result["workers_busy"] < 1
    shared = [path for path in (tmp_path / "shared").rglob("*") if path.is_file()]
    assert len(shared) > 3 * result["frames"]  # picture, matte, body, window
    assert all(path.name.isalnum() and len(path.name) == 64 for path in shared)
    again = run_clip(made.truth.parent, out, truth=made.truth, workers=2)  # what a cluster made is this machine's, too
    assert again["resumed_frames"] == result["frames"]


def test_dask_on_the_same_disk(scheduler: str, store: Path, tmp_path: Path) -> None:
    made = small_clip()
    run_clip(made.truth.parent, tmp_path / "out", truth=made.truth, workers=engine_of(f"dask:{scheduler}"))
    assert_same_bytes(tmp_path / "out")


def test_a_benchmark_with_a_store(scheduler: str, store: Path, tmp_path: Path) -> None:
    (tmp_path / "tiny.toml").write_text(TINY_TOML)
    methods = tuple(method_spec(name) for name in ("static", f"tiny={tmp_path / 'tiny.toml'}"))
    # two frames of one camera: two files with the same content would be one file in the store
    spec = SetSpec(set="bt-amass", size_px=64, seed=3, fill="even", frames=2)
    plan = BenchmarkPlan(spec=spec, count=2, methods=methods, start="simulated")
    run_benchmark(plan, tmp_path / "here", 2)
    engine = engine_of(f"dask:{scheduler}", (tmp_path / "shared").as_uri())
    run_benchmark(plan, tmp_path / "there", engine)
    assert rows(tmp_path / "there") == rows(tmp_path / "here")
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    away = {path.name for path in (tmp_path / "shared").rglob("*") if path.is_file()}
    motions = list((tmp_path / "there" / "methods").rglob("motion.npz"))
    assert len(motions) == 4
    assert {sha256_of(path) for path in motions} <= away, "they were not made by the cluster's workers"


def test_a_cluster_that_is_not_there(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hfb.tasks.workers import clusters

    monkeypatch.setattr(clusters, "_ANSWER_S", 1)
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        run_clip(small_clip().truth.parent, tmp_path / "out", workers=engine_of("dask:tcp://127.0.0.1:9"))
    assert not (tmp_path / "out").exists()
    assert mlflow_rows(store, "select status from runs") == []


def test_what_a_user_writes() -> None:
    assert engine_of("3") == engine_of(3) == Engine("processes", 3)
    assert engine_of("threads:2") == Engine("threads", 2)
    assert engine_of("dask:tcp://host:8786", "s3://b/p") == Engine("dask", 1, "tcp://host:8786", "s3://b/p")
    assert engine_of("ray:auto").address == "auto"
    for wrong in ("0", "two", "dask", "dask:", "threads:0", "spark:x", "-1", "1.5"):
        with pytest.raises(InputError, match=f"--workers {wrong}: give"):
            engine_of(wrong)
    with pytest.raises(InputError, match="--store is for workers elsewhere"):
        engine_of("4", "s3://b")


@pytest.mark.parametrize(
    ("url", "told"), [("nowhere://x", "give a place such as"), ("s3://key:secret@b/p", "keep the password out")]
)
def test_a_store_that_cannot_be_used(url: str, told: str) -> None:
    from hfb.tasks.workers.shared_store import SharedStore

    with pytest.raises(InputError, match=told) as refused:
        SharedStore(url)
    assert "secret" not in str(refused.value)
