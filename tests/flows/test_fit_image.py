"""The whole chain on a real server and a real store."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.config import CameraConfig, DirectionsConfig, ExportConfig, FitConfig, InitConfig, RunConfig, Stage
from hfb.datasets.real.markers import read_trc
from hfb.errors import InputError
from hfb.evaluation.metrics import soft_iou
from hfb.evaluation.protocol import reblur
from hfb.fitting.alternatives import LIMB_NAMES, load_alternatives
from hfb.flows.fit_image import fit_image
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.fronts import mirrored_in_depth
from hfb.io.media.images.image_io import read_matte, read_picture_srgb, write_png
from hfb.motion.motion_file import load_motion
from hfb.motion.static_pose import load_first_body, save_first_body
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.observation import Observation
from tests.orchestration import Problem, example, mlflow_rows

TINY = RunConfig(
    init=InitConfig(method="matte"),
    fit=FitConfig(subframes=2, texture_px=16, stages=(Stage(size_px=32, iterations=3),)),
    export=ExportConfig(films=(), report=False),  # most of the time otherwise
)
ARTIFACTS = ("matte_0.png", "motion.npz", "texture.npz", "scores.json", "strip.png")


def run(problem: Problem, out: Path, config: RunConfig = TINY, frame: Path | None = None) -> dict[str, Any]:
    """The chain from the given first body: looking for one takes longer than all the rest."""
    return fit_image([frame or problem.frame], problem.background, out, config, first_bodies=[problem.first_body])


def stamps(folder: Path) -> dict[str, int]:
    """When each intermediate file was written."""
    return {name: (folder / "intermediate" / name).stat().st_mtime_ns for name in ARTIFACTS}


def test_a_calibration_and_a_direction_reach_the_exports(problem: Problem, store: Path, tmp_path: Path) -> None:
    clip = tmp_path / "clip.toml"
    pose = "rotation = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]\ntranslation = [0.0, 1.5, 0.0]\n"
    clip.write_text(f"[camera]\nfocal_px = 700.0\n{pose}")
    formats = TINY.model_copy(update={"export": ExportConfig(formats=("trc",), films=(), report=False)})
    given = [problem.first_body]
    result = fit_image([problem.frame], problem.background, tmp_path / "out", formats, clip=clip, first_bodies=given)
    assert (result["world"]["source"], result["world"]["up"]) == ("calibration", "z")
    motion, _ = load_motion(tmp_path / "out" / "motion.npz")
    assert motion.world is not None
    read = read_trc(tmp_path / "out" / "joints.trc").turned().xyz_m[0, 0]
    x, y, z = motion.joints[0, 0]
    np.testing.assert_allclose(read, [x, z, 1.5 - y], atol=1e-3)
    tilted = formats.model_copy(update={"camera": CameraConfig(tilt_deg=17)})
    result = fit_image([problem.frame], problem.background, tmp_path / "out", tilted, clip=clip, first_bodies=given)
    assert (result["world"]["source"], result["world"]["tilt_deg"]) == ("options", 17)


def test_a_floor_reaches_fit_exports_and_warnings(problem: Problem, store: Path, tmp_path: Path) -> None:
    """A floor at the height of the camera: the soles are below it, which counts in the fit, and is said."""
    config = TINY.model_copy(update={"camera": CameraConfig.model_validate({"floor": "0,2,0,0"})})
    formats = config.model_copy(update={"export": ExportConfig(formats=("trc", "csv"), films=(), report=False)})
    result = run(problem, tmp_path / "out", formats)
    assert (result["world"]["source"], result["world"]["floor"]) == ("level", "plane")
    assert [one["code"] for one in result["warnings"]].count("floor") == 1
    assert json.loads((tmp_path / "out" / "curves.json").read_text())["losses"]["sunk_soles"][0] > 0
    motion, _ = load_motion(tmp_path / "out" / "motion.npz")
    read = read_trc(tmp_path / "out" / "joints.trc").xyz_m[0]
    np.testing.assert_allclose(read[:, 1], -motion.joints[0, :, 1], atol=1e-3)
    rows = list(csv.DictReader((tmp_path / "out" / "joints.csv").open()))
    assert [float(rows[0][f"{side}_foot_sole_m"]) < -0.3 for side in ("left", "right")] == [True, True]
    assert [rows[0][f"{side}_foot_stands"] for side in ("left", "right")] == ["0", "0"]


def test_results_and_record(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    result = fit_image([problem.frame], problem.background, out, TINY)

    assert {"matte_iou", "psnr_db", "fit_seconds", "out", "strip", "mlflow_run_id"} <= result.keys()
    assert json.loads((out / "result.json").read_text()) == result
    assert result["world"]["source"] == "level"
    assert "--camera.tilt-deg" in result["world"]["says"]
    with np.load(out / "motion.npz", allow_pickle=False) as motion:
        shapes = {name: motion[name].shape for name in motion.files}
    assert shapes["poses"] == (2, 72)
    assert shapes["trans"] == (2, 3)
    assert shapes["betas"] == (10,)
    assert shapes["joints"] == (2, 24, 3)
    assert shapes["times_s"] == shapes["frame_index"] == (2,)
    assert shapes["K"] == (3, 3)
    assert read_picture_srgb(Path(result["strip"])).shape[0] > 50
    assert 0.02 < read_matte(out / "matte_0.png").mean() < 0.5

    runs = mlflow_rows(store, "select run_uuid, status, name from runs")
    assert runs == [(result["mlflow_run_id"], "FINISHED", "out")]
    steps = mlflow_rows(store, "select step from metrics where key = 'loss/total' order by step")
    assert steps == [(0,), (1,), (2,)]
    names = {name for (name,) in mlflow_rows(store, "select distinct key from metrics")}
    assert {"loss/image", "loss/matte", "eval/matte_iou", "eval/psnr_db", "time/fit_s"} <= names
    params = dict(mlflow_rows(store, "select key, value from params"))
    assert params["fit.subframes"] == "2"
    assert params["seed"] == "0"
    assert params["input.frame_0"] == result["inputs"]["frame_0"]
    artifacts = {path.name for path in (tmp_path / "mlflow-artifacts").rglob("*") if path.is_file()}
    assert {"strip.png", "motion.npz", "result.json", "config.json", "matte_0.png"} <= artifacts


def test_the_published_matte_is_the_one_the_fit_used_last(problem: Problem, store: Path, tmp_path: Path) -> None:
    """In the folder, in the record and in the figures; warnings compare with the matte of before the fit."""
    out, stage = tmp_path / "out", Stage(size_px=32, iterations=2)
    fit = TINY.fit.model_copy(update={"stages": (stage, stage), "matte_again": True})
    result = run(problem, out, TINY.model_copy(update={"fit": fit}))
    initial, published = read_matte(out / "intermediate" / "matte_0.png"), read_matte(out / "matte_0.png")
    assert not np.array_equal(published, initial)
    observation = load_observation_of(problem, published)
    motion, body = load_motion(out / "motion.npz")[0], load_default_body()
    blurred = reblur(motion, torch.full((16, 16, 3), 0.5), observation, body, make_rasterizer())
    assert result["matte_iou"] == pytest.approx(soft_iou(blurred[0, ..., 3].numpy(), published), abs=1e-5)
    recorded = list((tmp_path / "mlflow-artifacts").rglob("matte_0.png"))
    assert [np.array_equal(read_matte(path), published) for path in recorded] == [True]

    stages = ["evidence", "stage_1", "refine_2", "stage_2", "directions"]
    assert list(result["fit_stage_seconds"]) == stages
    assert sum(result["fit_stage_seconds"].values()) <= result["fit_seconds"] + 0.01
    names = {name for (name,) in mlflow_rows(store, "select distinct key from metrics")}
    assert {f"time/fit_{stage}_s" for stage in stages} <= names


def test_a_brighter_frame_is_seen_in_its_plates_exposure(problem: Problem, store: Path, tmp_path: Path) -> None:
    """By a third of a stop and with clipped highlights: the same matte and the same motion, and no warning."""
    bright = tmp_path / "bright.png"
    write_png(bright, linear_to_srgb(np.clip(1.25 * srgb_to_linear(read_picture_srgb(problem.frame)), 0, 1)))
    results = {name: run(problem, tmp_path / name, frame=one) for name, one in (("as_is", None), ("bright", bright))}
    assert results["as_is"]["exposure_gain"] == [[1.0, 1.0, 1.0]]
    assert results["bright"]["exposure_gain"] == [pytest.approx([1.25] * 3, rel=0.003)]
    codes, expected = ({one["code"] for one in results[name]["warnings"]} for name in ("bright", "as_is"))
    assert codes <= expected
    mattes = [read_matte(tmp_path / name / "matte_0.png") for name in results]
    assert soft_iou(*mattes) > 0.97
    joints = [load_motion(tmp_path / name / "motion.npz")[0].joints for name in results]
    assert 1000 * np.linalg.norm(joints[0] - joints[1], axis=-1).mean() < 10


def load_observation_of(problem: Problem, matte: np.ndarray) -> Observation:
    frame, plate = (
        srgb_to_linear(torch.from_numpy(read_picture_srgb(path))) for path in (problem.frame, problem.background)
    )
    height, width = matte.shape
    focal_px = math.hypot(height, width)
    camera = PinholeCamera(focal_px, focal_px, width / 2, height / 2, height, width)
    return Observation(frame[None], plate, torch.from_numpy(matte)[None], camera, 1 / 30, 1 / 30)


def test_a_plate_that_still_shows_the_person_is_doubted(
    problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each time, also where nothing is computed again; a single frame may be misread, so the fit goes on."""
    said: list[str] = []
    monkeypatch.setattr("hfb.tasks.telemetry.progress.say", said.append)
    frame, plate = read_picture_srgb(problem.frame), read_picture_srgb(problem.background)
    person = np.abs(frame - plate).max(-1) > 0.06
    plate[:, :-50][person[:, 50:]] = frame[:, 50:][person[:, 50:]]
    write_png(tmp_path / "plate.png", plate)
    for background, doubts in [(problem.background, 0), (tmp_path / "plate.png", 1), (tmp_path / "plate.png", 2)]:
        result = run(replace(problem, background=background), tmp_path / background.stem)
        assert sum("seems that the background still holds the person: somebody" in line for line in said) == doubts
        assert ("plate" in [one["code"] for one in result["warnings"]]) == bool(doubts)
    assert mlflow_rows(store, "select count(*) from metrics where key = 'warning/plate'") == [(1,)]


def test_reuses_what_did_not_change(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(problem, out)
    before = stamps(out)

    assert run(problem, out) == first
    assert stamps(out) == before
    assert len(mlflow_rows(store, "select * from runs")) == 1

    # a changed option redoes the fit and what follows, and nothing before it
    other = TINY.model_copy(update={"fit": TINY.fit.model_copy(update={"subframes": 3})})
    run(problem, out, other)
    changed = {name for name, stamp in stamps(out).items() if stamp != before[name]}
    assert changed == {"motion.npz", "texture.npz", "scores.json", "strip.png"}
    assert len(mlflow_rows(store, "select * from runs")) == 2


def test_a_height_from_the_clip_is_held_and_recorded(problem: Problem, store: Path, tmp_path: Path) -> None:
    out, clip = tmp_path / "out", tmp_path / "clip.toml"
    clip.write_text("[person]\nheight_m = 1.85\n")
    result = fit_image([problem.frame], problem.background, out, TINY, clip=clip, first_bodies=[problem.first_body])
    motion, _ = load_motion(out / "motion.npz")
    assert float(height_m(load_default_body(), torch.from_numpy(motion.betas))) == pytest.approx(1.85, abs=1e-4)
    assert result["config"]["fit"]["height_m"] == 1.85
    assert ("fit.height_m", "1.85") in mlflow_rows(store, "select key, value from params")


def test_a_fit_of_no_iterations_leaves_its_start(problem: Problem, store: Path, tmp_path: Path) -> None:
    none = TINY.fit.model_copy(update={"stages": (Stage(size_px=32, iterations=0),)})
    out = tmp_path / "out"
    run(problem, out, TINY.model_copy(update={"fit": none}))
    with np.load(out / "motion.npz") as motion:
        assert np.allclose(motion["joints"], motion["joints"][:1], atol=0.01)  # at rest, but for the first velocity
    assert (out / "strip.png").is_file()


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"damaged")], ids=["gone", "damaged"])
def test_notices_a_lost_file(problem: Problem, store: Path, tmp_path: Path, damage) -> None:
    out = tmp_path / "out"
    run(problem, out)
    before = stamps(out)
    matte = out / "intermediate" / "matte_0.png"
    good = matte.read_bytes()
    damage(matte)

    run(problem, out)
    assert matte.read_bytes() == good
    assert stamps(out)["motion.npz"] == before["motion.npz"]  # the same matte again: nothing else changes


def test_an_edited_picture_is_another_problem(problem: Problem, store: Path, tmp_path: Path) -> None:
    frame, out = tmp_path / "frame.png", tmp_path / "out"
    frame.write_bytes(problem.frame.read_bytes())
    first = run(problem, out, frame=frame)
    write_png(frame, 0.98 * read_picture_srgb(frame))
    second = run(problem, out, frame=frame)
    assert second["inputs"]["frame_0"] != first["inputs"]["frame_0"]
    assert second["mlflow_run_id"] != first["mlflow_run_id"]


def test_directions_are_searched_said_and_kept(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    searching = TINY.fit.model_copy(update={"directions": DirectionsConfig(search=True, iterations=1, polish=1)})
    result = run(problem, out, TINY.model_copy(update={"fit": searching}))
    (frame,) = result["directions"]
    assert set(frame["right"]) == {"body", *LIMB_NAMES}
    assert result["unknown"].endswith(".")
    assert "counted on other people" in result["confidence"]["directions"]["holds_for"]
    found, features = load_alternatives(out / "alternatives.npz")
    assert found.probability.sum() == pytest.approx(1)
    motion, _ = load_motion(out / "motion.npz")
    assert motion.joint_radius_mm is not None
    assert motion.joint_radius_mm.shape == features["reach"].shape == (2, 24)
    np.testing.assert_allclose(found.joints[found.chosen], motion.joints, atol=1e-5)
    assert "alternatives.npz" in {path.name for path in (tmp_path / "mlflow-artifacts").rglob("*")}

    without = run(problem, out)  # an option less: what the earlier result knew more is gone
    assert without["unknown"] is None
    assert "directions" not in without["confidence"]
    assert not (out / "alternatives.npz").exists()
    assert load_motion(out / "motion.npz")[0].joint_radius_mm is None


def test_the_earlier_result_survives_a_failure(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(problem, out)
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    with pytest.raises(InputError, match="no person"):
        run(problem, out, frame=problem.background)
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before


def test_a_lost_store_does_not_lose_the_result(
    problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/file/mlflow.db")
    result = run(problem, tmp_path / "out")
    assert result["mlflow_run_id"] is None
    assert (tmp_path / "out" / "result.json").exists()


def test_errors_against_the_truth(problem: Problem, store: Path, tmp_path: Path) -> None:
    result = fit_image(
        [example() / "frame_0.png"],
        example() / "background.png",
        tmp_path / "out",
        TINY,
        truth=example() / "truth.npz",
        first_bodies=[problem.first_body],
    )
    assert result["first_bodies"] == ["truth"]
    assert 0 < result["initial_mpjpe_mm"] < 60  # the true middle pose, held still
    assert result["initial_iou"] > 0.5
    assert {"mpjpe_mm", "pa_mpjpe_mm", "iou"} <= result.keys()


def test_two_frames_agree_on_the_front(
    problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Networks mistake front for back in one of two exposures: the person would turn around between them."""
    other = tmp_path / "other.png"
    write_png(other, read_picture_srgb(problem.frame) * 0.999)
    found = load_first_body(problem.first_body)
    answers = iter([found, mirrored_in_depth(found)])
    monkeypatch.setattr("hfb.tasks.image.first_body.make_initializer", lambda config: lambda *scene: next(answers))
    fit_image([problem.frame, other], problem.background, tmp_path / "out", TINY)
    motion, _ = load_motion(tmp_path / "out" / "motion.npz")
    roots = axis_angle_to_matrix(torch.from_numpy(motion.poses[:, :3]))
    cosine = ((roots[0].T @ roots[-1]).trace() - 1) / 2
    assert torch.rad2deg(torch.arccos(cosine)) < 20


def test_a_doubtful_front_is_told(problem: Problem, store: Path, tmp_path: Path) -> None:
    """Both fronts are fitted, result.json says which one was kept, and the other one stands in alternatives.npz."""
    both = TINY.fit.model_copy(update={"both_fronts": True, "directions": DirectionsConfig(search=True, refits=0)})
    save_first_body(tmp_path / "turned.npz", mirrored_in_depth(load_first_body(problem.first_body)))
    config = TINY.model_copy(update={"fit": both})
    out = tmp_path / "out"
    result = fit_image([problem.frame], problem.background, out, config, first_bodies=[tmp_path / "turned.npz"])
    assert 0.5 <= result["front"]["probability"] <= 1
    alternatives, _ = load_alternatives(out / "alternatives.npz")
    assert alternatives.other_front is not None
    assert alternatives.other_front.probability == pytest.approx(1 - result["front"]["probability"], abs=1e-4)
    kept, other = alternatives.joints[alternatives.chosen], alternatives.other_front.joints
    assert np.linalg.norm(kept - other, axis=-1).mean() > 0.05
    told = [one["code"] for one in result["warnings"]]
    assert ("front" in told) == (result["front"]["probability"] < 0.8)
    assert result["fit_stage_seconds"]["other_front"] > 0
    alone = run(problem, tmp_path / "alone", TINY)
    assert alone["front"] is None
