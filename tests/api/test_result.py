"""A result in memory and in its folder."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hfb
from hfb.flows.export import export_result
from hfb.interop.writers.export_names import PLATE
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.photometry import srgb_to_linear
from tests.browser import assert_body_moves, browser, opened
from tests.orchestration import Problem


def test_arrays_and_figures(fitted: hfb.Result) -> None:
    rows = 2
    shapes = {
        "poses": (rows, 72), "trans": (rows, 3), "betas": (10,), "joints": (rows, 24, 3), "times_s": (rows,),
        "radii_mm": (rows, 24), "frame_index": (rows,), "mattes": (1, 96, 96), "texture_linear": (16, 16, 3),
    }  # fmt: skip
    assert {name: getattr(fitted, name).shape for name in shapes} == shapes
    assert fitted.alternatives is not None
    assert fitted.alternatives.probability.sum() == pytest.approx(1)
    assert (fitted.radii_mm[:, 1:] > 0).all()
    assert repr(fitted).startswith("Result(1 frames x 2 sub-frames, matte_iou 0.")
    assert all(isinstance(one, str) for one in fitted.warnings)


def test_saved_and_read(fitted: hfb.Result, tmp_path: Path) -> None:
    folder = fitted.save(tmp_path / "new" / "saved")
    again = hfb.load_result(folder)
    for name in ("poses", "trans", "betas", "joints", "times_s", "radii_mm", "mattes", "texture_linear"):
        assert np.array_equal(getattr(again, name), getattr(fitted, name)), name
    assert again.betas_space == fitted.betas_space == "hfb"
    assert again.warnings == fitted.warnings
    assert again.body.mesh.faces.shape == fitted.body.mesh.faces.shape
    assert json.loads((folder / "result.json").read_text())["mlflow_run_id"] is None
    again.save(folder)  # over itself
    assert np.array_equal(hfb.load_result(again.save(tmp_path / "copy")).poses, fitted.poses)


def test_the_home_folder_is_understood(fitted: hfb.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    assert fitted.save("~/saved") == tmp_path / "home" / "saved"
    assert np.array_equal(hfb.load_result("~/saved").poses, fitted.poses)
    assert not (tmp_path / "~").exists()


def test_a_refused_save_leaves_nothing(fitted: hfb.Result, tmp_path: Path) -> None:
    (tmp_path / "motion.npz").write_text("mine")
    with pytest.raises(hfb.InputError, match=r"motion\.npz"):
        fitted.save(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["motion.npz"]


def test_warnings_name_the_option_and_its_name_in_python(fitted: hfb.Result) -> None:
    said = "give --init FILE, --background PLATE, --camera.tilt-deg and --matting.weights, or --workers 2"
    told = replace(fitted, facts={"warnings": [{"message": said}]})
    assert told.warnings == (
        "give --init (init=...) FILE, --background (background=...) PLATE, --camera.tilt-deg (tilt_deg=...) and "
        "--matting.weights (matting={'weights': ...}), or --workers 2",
    )


def test_the_commands_read_it(fitted: hfb.Result, tmp_path: Path) -> None:
    folder = fitted.save(tmp_path / "saved")
    made = export_result(str(folder), None, ["glb", "bvh"], [])
    mine = fitted.export("glb", "bvh", folder=tmp_path / "mine")
    assert [path.name for path in mine] == ["motion.glb", "motion.bvh"]
    files = [*mine, tmp_path / "mine" / PLATE]
    assert {path.name: path.stat().st_size for path in files} == made["files"]
    assert hfb.load_result(folder).export("csv") == [folder / "export" / "joints.csv"]


def test_page_and_viewer(fitted: hfb.Result, tmp_path: Path) -> None:
    page = fitted.report(tmp_path)
    assert page == tmp_path / "report.html"
    text = page.read_text()
    assert "<video" in text
    assert text.count('class="viewer"') == 1
    assert '<iframe srcdoc="&lt;!doctype html&gt;' in fitted.show()._repr_html_()
    assert fitted.show().html.count('class="viewer"') == 1
    folder = fitted.save(tmp_path / "saved")
    assert hfb.load_result(folder).report() == folder / "report.html"
    assert (folder / "report.html").stat().st_size > 100_000


@pytest.mark.integration
def test_the_viewer_moves_in_a_notebook(fitted: hfb.Result, tmp_path: Path) -> None:
    """As Jupyter shows it: a frame within another page, from which nothing is loaded."""
    cell = tmp_path / "cell.html"
    cell.write_text(f"<!doctype html><html><body>{fitted.show()._repr_html_()}</body></html>")
    with browser() as chromium:
        page = opened(chromium, cell.as_uri(), 1000)
        page.tab.locator("iframe").wait_for()
        assert_body_moves(page.tab.frames[1])
        assert page.requests == []
        assert page.errors == []
        page.tab.screenshot(path=tmp_path / "cell.png")


def test_rendered_and_composed(fitted: hfb.Result, problem: Problem) -> None:
    """What is drawn over the plate is the fit's own blurred image: it is as near to the frame as the figures say."""
    drawn = hfb.render(fitted)
    assert drawn.shape == (2, 96, 96, 4)
    plate, frame = (read_picture_srgb(path) for path in (problem.background, problem.frame))
    blurred = hfb.compose(drawn.mean(0), srgb_to_linear(plate))
    assert blurred.shape == (96, 96, 3)
    assert np.abs(blurred - srgb_to_linear(frame)).mean() < np.abs(srgb_to_linear(plate) - srgb_to_linear(frame)).mean()
    assert np.array_equal(hfb.render(fitted, rows=slice(1, 2))[0], drawn[1])
    assert hfb.render(fitted, size=(48, 64)).shape == (2, 48, 64, 4)
    with pytest.raises(hfb.InputError, match="does not lie over a plate"):
        hfb.compose(drawn, plate[:64])


def test_compared_with_the_truth(fitted: hfb.Result, tmp_path: Path) -> None:
    assert hfb.evaluate(fitted, fitted)["mpjpe_mm"] == pytest.approx(0, abs=1e-6)
    moved = fitted.joints + 0.1 * np.eye(24, 3)
    assert hfb.evaluate(fitted, moved)["mpjpe_mm"] > 1
    folder = fitted.save(tmp_path / "saved")
    assert hfb.evaluate(fitted, folder / "motion.npz")["pa_mpjpe_mm"] == pytest.approx(0, abs=1e-3)
    with pytest.raises(hfb.InputError, match="the true joints are"):
        hfb.evaluate(fitted, moved[:1])


def test_what_is_refused(fitted: hfb.Result, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(hfb.InputError, match="file is a file: choose another folder"):
        fitted.save(tmp_path / "file")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "motion.npz").write_text("mine")
    with pytest.raises(hfb.InputError, match=r"holds motion\.npz"):
        fitted.save(tmp_path / "mine")
    assert (tmp_path / "mine" / "motion.npz").read_text() == "mine"
    (tmp_path / "glb").mkdir()
    (tmp_path / "glb" / "motion.glb").write_text("mine")
    with pytest.raises(hfb.InputError, match=r"motion\.glb"):
        fitted.export("glb", folder=tmp_path / "glb")
    with pytest.raises(hfb.InputError, match="unknown format gbl; did you mean glb"):
        fitted.export("gbl")
    with pytest.raises(hfb.InputError, match="there is no folder"):
        hfb.load_result(tmp_path / "none")
    with pytest.raises(hfb.InputError, match=r"result\.json"):
        hfb.load_result(tmp_path / "mine")
    folder = fitted.save(tmp_path / "saved")
    (folder / "motion.npz").write_bytes(b"damaged")
    with pytest.raises(hfb.InputError, match="is not a motion file"):
        hfb.load_result(folder)


def test_a_folder_that_cannot_be_written(fitted: hfb.Result, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)  # tests may run as root
    for leave in (fitted.save, fitted.report, lambda folder: fitted.export("glb", folder=folder)):
        with pytest.raises(hfb.InputError, match="is not yours to write: choose another folder"):
            leave(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_private_files_go_with_the_result(problem: Problem) -> None:
    from tests.api.conftest import TINY

    result = hfb.fit(problem.frame, problem.background, **TINY | {"directions": {"search": False}})
    place = result._files["motion.npz"].parent
    assert place.is_dir()
    del result
    assert not place.exists()
