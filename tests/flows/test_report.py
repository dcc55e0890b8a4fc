"""report.html of real runs: in the result's folder, in MLflow's own artifact view, and made again later."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import pytest

from hfb.config import ExportConfig, FitConfig, InitConfig, RunConfig, Stage
from hfb.errors import InputError, TemporaryError
from hfb.flows.fit_image import fit_image
from hfb.flows.report import make_report
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.results.result_report import shows_another_motion
from hfb.tasks.tracking.store_place import SMALL_SERVER, pages_command
from tests.browser import CHROMIUM, assert_body_moves, assert_film_plays, browser, opened
from tests.faults.servers import free_port
from tests.orchestration import Problem, mlflow_rows
from tests.small_clips import FRAMES, begun, run_clip, small_clip

FIT = FitConfig(subframes=3, texture_px=16, stages=(Stage(size_px=32, iterations=2),))
NASTY = "<script>alert(1)</script> \"quoted\" & 'so on'"


def run(problem: Problem, out: Path, report: bool = True) -> dict[str, Any]:
    config = RunConfig(init=InitConfig(method="matte"), fit=FIT, export=ExportConfig(formats=(), report=report))
    return fit_image([problem.frame], problem.background, out, config, first_bodies=[problem.first_body])


def artifacts(folder: Path, name: str = "report.html") -> list[Path]:
    return sorted((folder / "mlflow-artifacts").rglob(name))


def test_a_fit_leaves_its_page(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / NASTY.replace("/", "_")
    result = run(problem, out)
    page = (out / "report.html").read_text()
    assert result["report"] == str(out / "report.html")
    assert f"hfb rerun {result['mlflow_run_id']}" in page
    assert "data:video/mp4;base64," in page
    assert "<script>alert" not in page
    assert "Human from Blur: &lt;script&gt;" in page
    for sha256 in result["inputs"].values():
        assert sha256 in page
    assert [one.read_text() for one in artifacts(tmp_path)] == [page]
    assert set(json.loads((out / "curves.json").read_text())["losses"]) >= {"total", "matte"}

    artifacts(tmp_path)[0].unlink()  # as if the command had been stopped before the page was recorded
    again = run(problem, out)
    assert again["mlflow_run_id"] == result["mlflow_run_id"]
    assert len(artifacts(tmp_path)) == 1
    assert len(mlflow_rows(store, "select * from runs")) == 1

    without = run(problem, out, report=False)
    assert without["report"] is None
    assert not (out / "report.html").exists()

    make_report(str(out), None)
    assert (out / "report.html").exists()
    run(problem, out, report=False)
    assert not (out / "report.html").exists()  # it would show another fit


def reported_clip(out: Path) -> dict[str, Any]:
    """The small clip, fitted before, with its page."""
    made = small_clip()
    return run_clip(made.truth.parent, begun(out), "--export.report", "true", truth=made.truth)


def test_a_clip_leaves_its_page(store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = reported_clip(out)
    assert result["resumed_frames"] == FRAMES  # nothing was fitted again for it
    page = (out / "report.html").read_text()
    for words in ("IoU with the matte, frame by frame", "windows of the clip", "data:video/mp4;base64,", "smeared"):
        assert words in page, words
    assert f"hfb rerun {result['mlflow_run_id']}" in page
    assert [one.read_text() for one in artifacts(tmp_path)] == [page]
    curves = json.loads((out / "curves.json").read_text())
    assert [frame for frame, _ in curves["frames"]["matte_iou"]] == list(range(FRAMES))
    assert len(curves["windows"]) == result["windows"]


def test_the_page_is_made_again_from_what_is_left(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(problem, out)
    made = make_report(str(out), tmp_path / "again")
    assert made["film"]
    assert made["surface"]
    page = (tmp_path / "again" / "report.html").read_text()
    assert "How the fit went" in page
    assert f"hfb rerun {result['mlflow_run_id']}" in page
    assert "version.torch" in page

    film = out / "intermediate" / "page_film.mp4"
    assert not shows_another_motion(film, sha256_of(out / "motion.npz"))
    assert shows_another_motion(film, sha256_of(out / "strip.png"))

    fetched = make_report(str(result["mlflow_run_id"])[:8], tmp_path / "fetched")  # draws the film from the inputs
    assert fetched["film"]
    assert "data:video/mp4;base64," in (tmp_path / "fetched" / "report.html").read_text()

    for name in ("curves.json", "strip.png", "texture.png", "result.json", "slowmotion.mp4"):
        (out / name).unlink()
    (out / "intermediate" / "page_film.mp4").unlink()
    (out / "intermediate" / "history.json").unlink()
    with pytest.raises(TemporaryError, match=r"holds report.html, which is not as hfb wrote it"):
        make_report(str(out), None)  # with result.json the record of who wrote the page is gone
    (out / "report.html").unlink()
    bare = make_report(str(out), None)
    assert not bare["film"]
    assert "hfb export RESULT --films slowmotion" in (out / "report.html").read_text()


def test_what_is_no_result_is_said(store: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no motion file"):
        make_report(str(tmp_path), None)
    (tmp_path / "result.json").write_text("[1]")
    with pytest.raises(InputError, match="not a result of hfb"):
        make_report(str(tmp_path), None)
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(InputError, match="is damaged"):
        make_report(str(tmp_path), None)
    with pytest.raises(InputError, match=r"there is no .*nowhere"):
        make_report("some/nowhere", None)
    assert not (tmp_path / "report.html").exists()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_page_lives_in_mlflows_artifact_view(store: Path, tmp_path: Path) -> None:
    result = reported_clip(tmp_path / "out")
    (experiment,) = mlflow_rows(store, "select experiment_id from experiments where name = 'hfb'")[0]
    port = free_port()
    place = f"http://127.0.0.1:{port}/#/experiments/{experiment}/runs/{result['mlflow_run_id']}/artifacts/report.html"
    with mlflow_pages(port), browser() as chromium:
        for width in (600, 1400):
            shown = opened(chromium, f"{place}?workflowType=machine_learning", width)
            frame = shown.tab.frame_locator("iframe")
            frame.locator(".viewer canvas").wait_for()
            assert_body_moves(frame)
            assert_film_plays(frame)
            assert shown.hosts() == {"127.0.0.1"}
            ours = [text for place, text in shown.errors if "/ajax-api/" not in place]  # MLflow asks who is logged in
            assert ours == []
            shown.tab.close()


@contextmanager
def mlflow_pages(port: int) -> Iterator[None]:
    """MLflow's pages over the test's store, as `hfb runs` starts them."""
    quiet = {"DO_NOT_TRACK": "true", "MLFLOW_DISABLE_TELEMETRY": "true"}
    server = subprocess.Popen(
        pages_command(port),
        env={**os.environ, **SMALL_SERVER, **quiet},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 180
        while True:
            try:
                with urlopen(f"http://127.0.0.1:{port}/health", timeout=5):
                    break
            except (URLError, OSError):
                assert server.poll() is None, "MLflow's pages ended"
                assert time.monotonic() < deadline, "MLflow's pages do not answer"
                time.sleep(0.2)
        yield
    finally:
        os.killpg(server.pid, signal.SIGTERM)
        server.wait(30)
