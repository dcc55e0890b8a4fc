"""What `hfb fit` leaves for other programs: in its folder, in MLflow, and gone again when it is no longer asked for."""

import json
import shutil
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from hfb.config import ExportConfig, FitConfig, InitConfig, RunConfig, Stage
from hfb.errors import InputError
from hfb.flows.export import export_result
from hfb.flows.fit_image import fit_image
from hfb.interop.writers.export_names import EXPORTED_NAMES, FILE_NAMES, PLATE
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.motion.motion_file import load_motion
from tests.orchestration import Problem, mlflow_rows
from tests.small_clips import FRAMES, begun, finished, run_clip, small_clip, stamps

FIT = FitConfig(subframes=3, texture_px=16, stages=(Stage(size_px=32, iterations=2),))


def run(problem: Problem, out: Path, export: ExportConfig) -> dict[str, Any]:
    config = RunConfig(init=InitConfig(method="matte"), fit=FIT, export=export)
    return fit_image([problem.frame], problem.background, out, config, first_bodies=[problem.first_body])


def shown_at(film: Path) -> list[float]:
    """When each picture of a film is shown [s]."""
    with av.open(str(film)) as container:
        return [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]


def exported(folder: Path) -> set[str]:
    return {name for name in EXPORTED_NAMES if (folder / name).exists()}


def test_motion_files_are_published_recorded_and_taken_away(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(problem, out, ExportConfig())
    names = {FILE_NAMES[form] for form in ExportConfig().formats}
    names |= {PLATE, "slowmotion.mp4", "overlay.mp4"}
    assert exported(out) == names
    artifacts = {path.name for path in (tmp_path / "mlflow-artifacts").rglob("*") if path.is_file()}
    assert names <= artifacts
    motion, _ = load_motion(out / "motion.npz")
    with np.load(out / "amass.npz") as amass:
        assert amass["poses"].shape == (5, 156)  # 1/30 s at 120 per second
        np.testing.assert_allclose(amass["hfb_betas"], motion.betas)
    glb = (out / "motion.glb").read_bytes()
    document = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    assert document["asset"]["extras"]["sub_frames"] == 3
    plate = read_picture_srgb(problem.background)
    assert motion.size == (plate.shape[1], plate.shape[0])
    assert document["cameras"][0]["extras"]["size_px"] == list(motion.size)
    assert document["cameras"][0]["extras"]["background"] == PLATE
    np.testing.assert_allclose(read_picture_srgb(out / PLATE), plate, atol=0.003)
    assert (out / "texture.png").read_bytes() in glb

    told = export_result(str(result["mlflow_run_id"])[:8], tmp_path / "fetched", ("glb",), ())
    assert told["files"] == {"motion.glb": len(glb), PLATE: (out / PLATE).stat().st_size}
    for name in told["files"]:
        assert (tmp_path / "fetched" / name).read_bytes() == (out / name).read_bytes()

    before = (out / "intermediate" / "motion.npz").stat().st_mtime_ns
    fewer = run(problem, out, ExportConfig(formats=("csv",), films=()))
    assert exported(out) == {"joints.csv"}
    assert (out / "intermediate" / "motion.npz").stat().st_mtime_ns == before  # nothing was fitted again
    assert fewer["mlflow_run_id"] != result["mlflow_run_id"]
    assert len(mlflow_rows(store, "select * from runs")) == 2


def test_films_on_request(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(problem, out, ExportConfig(formats=(), films=("exact", "overlay")))
    assert exported(out) == {"exact_time.mp4", "overlay.mp4"}
    motion, _ = load_motion(out / "motion.npz")
    np.testing.assert_allclose(shown_at(out / "exact_time.mp4"), motion.times_s, atol=6e-7)
    with av.open(str(out / "overlay.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 61
    artifacts = {path.name for path in (tmp_path / "mlflow-artifacts").rglob("*") if path.is_file()}
    assert {"exact_time.mp4", "overlay.mp4"} <= artifacts


def test_films_of_an_earlier_result(store: Path, problem: Problem, tmp_path: Path) -> None:
    """Drawn from the record alone, also where the pictures were moved; without them, one sentence and no file."""
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    moved = Problem(
        *(Path(shutil.copy(path, pictures)) for path in (problem.frame, problem.background, problem.first_body))
    )
    out = tmp_path / "out"
    result = run(moved, out, ExportConfig(formats=(), report=False))
    told = export_result(str(out), None, (), (), films=("exact", "overlay"))
    assert told["files"].keys() == {"exact_time.mp4", "overlay.mp4"}
    assert shown_at(out / "export" / "exact_time.mp4") == pytest.approx(
        load_motion(out / "motion.npz")[0].times_s, abs=6e-7
    )

    pictures.rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="--inputs DIR"):
        export_result(result["mlflow_run_id"], tmp_path / "none", (), (), films=("exact",))
    assert not (tmp_path / "none").exists()
    again = tmp_path / "again"
    export_result(result["mlflow_run_id"], again, (), (), films=("exact",), inputs=tmp_path / "elsewhere")
    assert (again / "exact_time.mp4").read_bytes() == (out / "export" / "exact_time.mp4").read_bytes()


def test_films_of_an_earlier_clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, database, result = finished()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{database}")
    told = export_result(result["mlflow_run_id"], tmp_path / "films", (), (), films=("exact",))
    assert told["sub_frames"] == 3 * FRAMES
    motion, _ = load_motion(finished()[0] / "motion.npz")
    assert shown_at(tmp_path / "films" / "exact_time.mp4") == pytest.approx(
        np.unique(motion.times_s.round(6)), abs=2e-6
    )


def test_a_library_that_is_missing_is_said_before_anything_is_computed(
    problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hfb.interop.writers.export_names.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"\.\[c3d\]"):
        run(problem, tmp_path / "out", ExportConfig(formats=("c3d",)))
    assert not (tmp_path / "out").exists()


def test_a_clips_films_are_drawn_without_fitting_it_again(store: Path, tmp_path: Path) -> None:
    made, out = small_clip(), begun(tmp_path / "out")
    names = {PLATE, *(FILE_NAMES[form] for form in ExportConfig().formats)}
    assert exported(out) == names
    before = stamps(out, "window*")
    result = run_clip(made.truth.parent, out, "--export.films", "slowmotion,exact", truth=made.truth)
    assert exported(out) == names | {"slowmotion.mp4", "exact_time.mp4"}
    assert result["resumed_frames"] == FRAMES
    assert stamps(out, "window*") == before != {}
    motion, _ = load_motion(out / "motion.npz")
    assert shown_at(out / "exact_time.mp4") == pytest.approx(np.unique(motion.times_s.round(6)), abs=2e-6)
