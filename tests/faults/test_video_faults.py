"""A clip that is killed, filled up or cut off half-way: nothing lost, nothing twice, and the same bytes in the end."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import pytest

from tests.orchestration import mlflow_rows, prefect_tables
from tests.small_clips import (
    LONGER,
    assert_every_frame_once,
    begun,
    children,
    computing,
    new_windows,
    run_clip,
    shown,
    small_clip,
    stamps,
    started,
    until,
)


@pytest.fixture
def out(tmp_path: Path, store: Path) -> Path:
    """Everything but the windows is done; the server and the store are the test's."""
    return begun(tmp_path / "out")


def finish(out: Path) -> dict:
    """The same command again, in this process."""
    return run_clip(small_clip().truth.parent, out, *LONGER, truth=small_clip().truth)


def test_killed_flow_and_killed_worker(out: Path, store: Path, tmp_path: Path) -> None:
    undisturbed = begun(tmp_path / "undisturbed")
    finish(undisturbed)
    store.write_bytes(b"")  # the undisturbed run is recorded elsewhere
    store.unlink()
    from tests.orchestration import migrated_store

    store.write_bytes(migrated_store().read_bytes())

    before = stamps(out, "window_*.npz")
    victim = started(out, *LONGER)
    until(lambda: new_windows(out, before) >= 3, victim, out)
    victim.kill()
    victim.wait()
    time.sleep(0.5)  # its workers end with it
    done = {name: stamp for name, stamp in stamps(out, "window_*.npz").items() if stamp != before[name]}
    assert mlflow_rows(store, "select status from runs") == [("RUNNING",)]
    assert unfinished_flow_runs()

    victim = started(out, *LONGER)
    until(lambda: new_windows(out, before | done) >= 2, victim, out)
    os.kill(computing(victim.pid)[0], signal.SIGKILL)
    told, _ = victim.communicate(timeout=240)
    assert victim.returncode == 0, shown(out).read_text()
    result = json.loads(told.splitlines()[-1])
    kept = [name for name, stamp in done.items() if stamps(out, name)[name] == stamp]
    # The two in the workers' hands left no file; in flight are also those whose record was still on its way.
    assert len(kept) >= len(done) - 2
    assert result["resumed_frames"] >= len(kept)
    for name in ("motion.npz", "strip.png", "texture.png", "edges.json"):
        assert (out / name).read_bytes() == (undisturbed / name).read_bytes()
    assert_every_frame_once(store)
    assert not unfinished_flow_runs()


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "TERM"])
def test_interrupted(sent: int, code: int, out: Path, store: Path) -> None:
    before = stamps(out, "window_*.npz")
    victim = started(out, *LONGER, "--fit.subframes", "3")
    until(lambda: new_windows(out, before) >= 2, victim, out)
    workers = computing(victim.pid)
    victim.send_signal(sent)
    assert victim.wait(timeout=60) == code, shown(out).read_text()
    assert "Traceback" not in shown(out).read_text()
    assert mlflow_rows(store, "select status from runs") == [("KILLED",)]
    assert not unfinished_flow_runs()
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{one}").exists() for one in workers):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_full_disk(out: Path, store: Path) -> None:
    before = stamps(out, "window_*.npz")
    victim = started(out, *LONGER)
    until(lambda: new_windows(out, before) >= 2, victim, out)
    for worker in computing(victim.pid):  # what they write from here on does not fit
        resource.prlimit(worker, resource.RLIMIT_FSIZE, (1000, 1000))
    told, _ = victim.communicate(timeout=240)
    assert victim.returncode == 1, shown(out).read_text()
    error = json.loads(told.splitlines()[-1])["error"]
    assert "the disk is full" in error
    assert "free some space" in error
    assert "the same command goes on from there" in error
    assert mlflow_rows(store, "select status from runs") == [("FAILED",)]
    assert not list(out.rglob("*.part"))
    result = finish(out)
    assert result["resumed_frames"] >= 2
    assert_every_frame_once(store)


def test_mlflow_goes_away_and_comes_back(
    out: Path, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = 5000 + os.getpid() % 20000
    uri = f"http://127.0.0.1:{port}"
    server = tracking_server(store, port)
    before = stamps(out, "window_*.npz")
    victim = started(out, *LONGER, MLFLOW_TRACKING_URI=uri)
    try:
        until(lambda: new_windows(out, before) >= 2, victim, out)
    finally:
        end(server)
    told, _ = victim.communicate(timeout=240)
    assert victim.returncode == 0, shown(out).read_text()
    result = json.loads(told.splitlines()[-1])
    assert result["mlflow_run_id"] is None
    assert result["frames"] == 12
    assert "once MLflow is back, the same command completes the record" in shown(out).read_text()
    server = tracking_server(store, port)
    try:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        again = finish(out)
    finally:
        end(server)
    assert again["resumed_frames"] == 12
    assert again["mlflow_run_id"] is not None
    assert_every_frame_once(store)


def test_prefects_server_goes_away(out: Path, store: Path, tmp_path: Path) -> None:
    before = stamps(out, "window_*.npz")
    environment = {"PREFECT_HOME": str(tmp_path / "prefect"), "PREFECT_API_URL": ""}
    (tmp_path / "prefect" / "hfb").mkdir(parents=True)
    shutil.copy(prefect_tables(), tmp_path / "prefect" / "hfb")
    victim = started(out, *LONGER, **environment)
    until(lambda: new_windows(out, before) >= 2, victim, out)
    (server,) = [one for one in children(victim.pid) if b"uvicorn" in Path(f"/proc/{one}/cmdline").read_bytes()]
    os.kill(server, signal.SIGKILL)
    told, _ = victim.communicate(timeout=240)
    assert victim.returncode == 1, shown(out).read_text()
    assert "no longer answers" in json.loads(told.splitlines()[-1])["error"]
    assert not computing(victim.pid)
    assert mlflow_rows(store, "select status from runs") == [("FAILED",)]
    result = finish(out)
    assert result["resumed_frames"] >= 2
    assert_every_frame_once(store)


def unfinished_flow_runs() -> list[str]:
    """Names of flow runs that Prefect takes for running."""
    from prefect import get_client
    from prefect.client.schemas.filters import FlowRunFilter

    running = FlowRunFilter.model_validate({"state": {"type": {"any_": ["RUNNING", "PENDING", "CANCELLING"]}}})
    with get_client(sync_client=True) as client:
        return [run.name for run in client.read_flow_runs(flow_run_filter=running)]


def tracking_server(store: Path, port: int) -> subprocess.Popen[bytes]:
    """A real MLflow server on the test's database."""
    artifacts = store.parent / "mlflow-artifacts"
    server = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "mlflow",
            "server",
            "--backend-store-uri",
            f"sqlite:///{store}",
            "--port",
            str(port),
            "--host",
            "127.0.0.1",
            "--workers",
            "1",
            "--artifacts-destination",
            artifacts.as_uri(),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"},
    )
    deadline = time.monotonic() + 120
    while True:
        try:
            with urlopen(f"http://127.0.0.1:{port}/health", timeout=2):
                return server
        except OSError:
            assert server.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.2)


def end(server: subprocess.Popen[bytes]) -> None:
    """The server and its worker."""
    os.killpg(server.pid, signal.SIGKILL)
    server.wait()
