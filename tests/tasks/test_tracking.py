"""MLflow: one run per problem, every value once, whatever was interrupted."""

import json
import time
from pathlib import Path

import pytest

import hfb
from hfb.errors import InputError
from hfb.tasks.core.environment import source_commit
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.ownership import owner
from hfb.tasks.tracking.recipe import COMMAND_TAG
from hfb.tasks.tracking.run_record import RunRecord, write_run
from hfb.tasks.tracking.store_place import pages_command
from tests.orchestration import mlflow_rows

PARAMS = {"fit": {"degree": 2, "stages": [{"size_px": 64}]}, "seed": 0, "long": "x" * 9000}


def record(histories: dict[str, list[float]], key: str = "k") -> str:
    with tracking.record_run("name", key, PARAMS, {"seed": "0"}) as run:
        if not run.complete:
            tracking.log_histories(run, histories)
        return run.run_id


def test_found_again_by_its_key(store: Path) -> None:
    first = record({"loss/total": [2.0, 1.0]})
    assert record({"loss/total": [2.0, 1.0]}) == first
    assert record({"loss/total": [2.0, 1.0]}, key="other") != first
    points = mlflow_rows(store, f"select step, value from metrics where run_uuid = '{first}' order by step")
    assert points == [(0, 2.0), (1, 1.0)]
    params = dict(mlflow_rows(store, f"select key, value from params where run_uuid = '{first}'"))
    assert params["fit.degree"] == "2"
    assert params["fit.stages"] == '[{"size_px": 64}]'
    assert params["long"].startswith("xxx")


@pytest.mark.parametrize(
    ("error", "status"), [(RuntimeError(), "FAILED"), (KeyboardInterrupt(), "KILLED"), (SystemExit(143), "KILLED")]
)
def test_an_interrupted_record_is_finished_by_the_next(store: Path, error: BaseException, status: str) -> None:
    def interrupted() -> None:
        with tracking.record_run("name", "k", PARAMS, {}) as run:
            tracking.log_histories(run, {"loss/total": [2.0, 1.0]})
            raise error

    with pytest.raises(type(error)):
        interrupted()
    [(first, found)] = mlflow_rows(store, "select run_uuid, status from runs")
    assert found == status
    assert record({"loss/total": [2.0, 1.0]}) == first
    assert mlflow_rows(store, "select status from runs") == [("FINISHED",)]
    assert mlflow_rows(store, "select count(*) from metrics") == [(2,)]


def test_a_killed_record_is_finished_by_the_next(store: Path) -> None:
    with tracking.record_run("name", "k", PARAMS, {}) as run:
        tracking.log_histories(run, {"loss/total": [2.0]})
    tracking.client_of(run.uri).update_run(run.run_id, status="RUNNING")  # what kill -9 leaves
    assert record({"loss/total": [2.0, 1.0]}) == run.run_id
    assert mlflow_rows(store, "select status from runs") == [("FINISHED",)]
    assert mlflow_rows(store, "select count(*) from metrics") == [(2,)]


def test_a_long_run_is_recorded_on_the_way(store: Path) -> None:
    run = tracking.begin_run("name", "k", PARAMS, {})
    tracking.log_points(run, {"fit/loss": {3: 0.5}, "frame/seen": {0: 1.0, 3: 1.0}})
    assert mlflow_rows(store, "select status from runs") == [("RUNNING",)]
    assert tracking.read_logged_steps(run, "frame/seen") == {0, 3}
    assert tracking.read_logged_steps(run, "none") == set()
    again = tracking.begin_run("name", "k", PARAMS, {})
    assert again == run
    tracking.log_points(again, {"fit/loss": {3: 0.5, 4: 0.25}})
    tracking.end_run(again, "FINISHED")
    points = mlflow_rows(store, "select step, value from metrics where key = 'fit/loss' order by step")
    assert points == [(3, 0.5), (4, 0.25)]
    assert tracking.begin_run("name", "k", PARAMS, {}).complete
    assert mlflow_rows(store, "select status from runs") == [("FINISHED",)]


def test_figures_of_the_machine(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def watched(key: str = "k") -> str:
        run = tracking.begin_run("name", key, PARAMS, {})
        unwatch = tracking.watch_machine(run)
        time.sleep(1.5)
        unwatch()
        return run.run_id

    watched("other")
    assert mlflow_rows(store, "select count(*) from metrics") == [(0,)], "nobody has asked for them"
    monkeypatch.setenv("MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING", "true")
    monkeypatch.setenv("MLFLOW_SYSTEM_METRICS_SAMPLING_INTERVAL", "0.2")
    watched()
    before = mlflow_rows(store, "select step, count(*) from metrics where key like 'system/cpu%' group by step")
    assert len(before) >= 2
    watched()  # the same command again: it goes on
    steps = mlflow_rows(store, "select step, count(*) from metrics where key like 'system/cpu%' group by step")
    assert steps[: len(before)] == before
    assert len(steps) > len(before)
    assert {count for _, count in steps} == {1}


def test_runs_of_dead_processes_are_ended(store: Path) -> None:
    mine, dead, unknown = (tracking.begin_run(name, name, PARAMS, {}) for name in ("mine", "dead", "unknown"))
    host, process, _ = owner().split("/")
    client = tracking.client()
    client.set_tag(dead.run_id, "hfb.owner", f"{host}/{process}/another-start")
    client.set_tag(unknown.run_id, "hfb.owner", f"elsewhere/{process}/1")
    assert tracking.end_abandoned_runs() == 1
    statuses = dict(mlflow_rows(store, "select run_uuid, status from runs"))
    assert statuses == {mine.run_id: "RUNNING", dead.run_id: "KILLED", unknown.run_id: "RUNNING"}


def test_more_values_than_one_batch_takes(store: Path) -> None:
    record({f"loss/{name}": [float(step) for step in range(300)] for name in "abcdefg"})
    assert mlflow_rows(store, "select count(*) from metrics") == [(2100,)]


def test_a_store_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/file/mlflow.db")
    with pytest.raises(tracking.StoreLost), tracking.record_run("name", "k", PARAMS, {}):
        pass


def test_links(monkeypatch: pytest.MonkeyPatch) -> None:
    run = tracking.Run("sqlite:////home/me/mlflow.db", "1", "abc", 0, False)
    assert tracking.link(run) == "http://127.0.0.1:5000/#/experiments/1/runs/abc?workflowType=machine_learning"
    served = tracking.Run("https://mlflow.example/", "1", "abc", 0, False)
    assert tracking.link(served).startswith("https://mlflow.example/#/experiments/1/runs/abc?")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", served.uri)
    with pytest.raises(InputError, match="pages of its own"):
        pages_command()


def test_a_run_lasts_as_long_as_the_work(store: Path) -> None:
    """Recorded at the end or later, it begins and ends when the work did, and names its inputs and its source."""
    began_ms, ended_ms = 1_700_000_000_000, 1_700_000_090_000
    kept = RunRecord(
        name="jump",
        key="k",
        params={"input": {"frame_0": "a" * 64, "background": "b" * 64}},
        tags={COMMAND_TAG: "fit"},
        points={"loss/total": {0: 2.0, 1: 1.0}},
        files={},
        contents={},
        description="`hfb fit`: IoU 0.9.",
        began_ms=began_ms,
        ended_ms=ended_ms,
    )
    run_id = write_run(kept, {}).run_id
    assert mlflow_rows(store, "select start_time, end_time, status from runs") == [(began_ms, ended_ms, "FINISHED")]
    assert mlflow_rows(store, "select min(timestamp) from metrics") == [(began_ms,)]
    datasets = mlflow_rows(store, "select name, digest, dataset_source from datasets order by name")
    assert datasets == [
        ("background", "b" * 36, json.dumps({"sha256": "b" * 64})),
        ("frame_0", "a" * 36, json.dumps({"sha256": "a" * 64})),
    ]
    tags = dict(mlflow_rows(store, f"select key, value from tags where run_uuid = '{run_id}'"))
    assert tags["mlflow.note.content"] == "`hfb fit`: IoU 0.9."
    assert tags["mlflow.source.name"] == "hfb fit"
    assert tags.get("mlflow.source.git.commit") == source_commit()
    assert write_run(kept, {}).run_id == run_id
    assert mlflow_rows(store, "select count(*) from inputs") == [(2,)]


def test_the_commit_of_a_checkout_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a branch, loose or packed, detached, in a worktree; a wheel has none."""
    commit, git = "c0ffee" * 6 + "c0fe", tmp_path / ".git"
    monkeypatch.setattr(hfb, "__file__", str(tmp_path / "hfb" / "__init__.py"))
    read = source_commit.__wrapped__
    assert read() is None
    (git / "refs" / "heads").mkdir(parents=True)
    (git / "HEAD").write_text("ref: refs/heads/main\n")
    assert read() is None  # nothing was committed yet
    (git / "packed-refs").write_text(f"# pack-refs with: peeled\n{commit} refs/heads/main\n")
    assert read() == commit
    (git / "refs" / "heads" / "main").write_text("a" * 40)
    assert read() == "a" * 40
    (git / "HEAD").write_text(f"{commit}\n")
    assert read() == commit
    worktree = git / "worktrees" / "mine"
    worktree.mkdir(parents=True)
    (worktree / "HEAD").write_text("ref: refs/heads/main\n")
    (worktree / "commondir").write_text("../..\n")
    (git / "refs" / "heads" / "main").write_text(f"{commit}\n")
    (tmp_path / "tree").mkdir()
    (tmp_path / "tree" / ".git").write_text(f"gitdir: {worktree}\n")
    monkeypatch.setattr(hfb, "__file__", str(tmp_path / "tree" / "hfb" / "__init__.py"))
    assert read() == commit
