"""The log as JSON lines: which run, task and frames a line is about, from worker processes too."""

import json
import logging
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hfb.flows.runtime.server import LOG_VARIABLE, keep_log, log_path
from tests.small_clips import run_clip, small_clip


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The log of `hfb` in a home of its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv(LOG_VARIABLE, "json")
    root = logging.getLogger()
    before, level = root.handlers, root.level
    root.handlers = []  # of a log that other tests keep
    keep_log()
    yield log_path()
    for handler in root.handlers:
        handler.close()
    root.handlers = before
    root.setLevel(level)
    logging.captureWarnings(False)


def test_a_clip(log: Path, store: Path, tmp_path: Path) -> None:
    made = small_clip(leaves=(4, 8))
    run_clip(made.truth.parent, tmp_path / "out")
    logging.getLogger("somebody").warning("login at http://me:secret@host/ failed")
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    mattes = [line for line in lines if line.get("task") == "find_matte" and "frames" in line]
    assert {frame for line in mattes for frame in line["frames"]} == {
        0,
        1,
        2,
        3,
        9,
        10,
        11,
    }  # nobody is there in the others
    assert len({line["flow_run"] for line in mattes}) == 1
    assert all(line["time"].endswith("+00:00") for line in lines)
    assert lines[-1]["message"] == "login at http://me:***@host/ failed"
    assert "flow_run" not in lines[-1]


def test_workers_know_what_they_work_for(log: Path) -> None:
    from hfb.tasks.telemetry.structured_log import about
    from hfb.tasks.workers.workers import run_local, workers

    with workers(1, apart=True), about({"flow_run": "f", "task": "t", "frames": [3]}):
        run_local(_log_in_worker)
        deadline = time.monotonic() + 20
        while "from a worker" not in log.read_text():  # it comes through a queue
            assert time.monotonic() < deadline
            time.sleep(0.05)
    (line,) = [line for line in map(json.loads, log.read_text().splitlines()) if line["message"] == "from a worker"]
    assert (line["flow_run"], line["task"], line["frames"]) == ("f", "t", [3])


def _log_in_worker() -> None:
    logging.getLogger("hfb").warning("from a worker")
