"""A whole clip on a real server and a real store: every frame once, whatever had been done before."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.media.images.image_io import read_picture_srgb, write_matte, write_png
from hfb.motion.motion_file import load_motion
from hfb.motion.static_pose import load_first_body, save_first_body
from hfb.photometry import linear_to_srgb
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FrameHandle
from hfb.tasks.core.video_handles import WindowHandle
from hfb.tasks.video.front_votes import weigh_segments
from hfb.tasks.video.video_windows import MirrorCall, mirror_body
from tests.cli.conftest import _own_logging  # noqa: F401  (a command runs in this process)
from tests.faults.stores import artifacts_of, assert_recorded_later, lost
from tests.orchestration import mlflow_rows
from tests.scenes import moving_scene
from tests.small_clips import (
    FRAMES,
    LONGER,
    assert_every_frame_once,
    begun,
    finished,
    run_clip,
    small_clip,
    stamps,
)

_WARNINGS = "select key from metrics where key like 'warning/%'"


def test_results_and_record() -> None:
    out, store, result = finished()
    assert json.loads((out / "result.json").read_text()) == result
    assert (result["frames"], result["sub_frames"], result["gaps"], result["resumed_frames"]) == (12, 36, [], 0)
    motion, space = load_motion(out / "motion.npz")
    assert motion.poses.shape == (3 * FRAMES, 72)
    assert space == "hfb"
    assert motion.frame_index.tolist() == sorted(3 * list(range(FRAMES)))
    assert (np.diff(motion.times_s) > 0).all()
    assert result["exposure_gain"] == [[1.0, 1.0, 1.0]] * FRAMES
    assert result["worst_jump_mm"] < 2
    assert result["world"]["source"] == "level"
    assert result["foot_skate_mm"] is None or 0 <= result["foot_skate_mm"] < 50
    assert result["worst_velocity_share"] < 0.02
    assert 0.4 < result["matte_iou"] < 1
    assert 10 < result["mpjpe_mm"] < 400
    assert 0 < result["workers_busy"] < 1
    assert all(one["segment"] == 0 and 0.5 <= one["probability"] <= 1 for one in result["fronts"])
    assert read_picture_srgb(Path(result["strip"])).shape[0] > 200

    assert_every_frame_once(store)
    codes = {one["code"] for one in result["warnings"]}
    assert codes == {key.split("/")[1] for (key,) in mlflow_rows(store, _WARNINGS)}
    values = mlflow_rows(store, "select value from metrics where key = 'eval/matte_iou'")
    assert ("matte_iou" in codes) == any(value < 0.7 for (value,) in values)
    params = dict(mlflow_rows(store, "select key, value from params"))
    assert params["video.key_every"] == "12"
    assert params["input.video"] == result["inputs"]["video"]
    tags = dict(mlflow_rows(store, "select key, value from tags"))
    assert tags["hfb.command"] == "video"
    artifacts = {path.name for path in (store.parent / "mlflow-artifacts").rglob("*") if path.is_file()}
    assert {"motion.npz", "edges.json", "strip.png", "result.json", "config.json", "recipe.json"} <= artifacts


def test_a_median_that_holds_the_person_is_told(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody who never leaves: before the fit on the terminal, in result.json and in the record."""
    said: list[str] = []
    monkeypatch.setattr("hfb.tasks.telemetry.progress.say", said.append)
    result = run_clip(small_clip().source, tmp_path / "out", background="median")
    assert "plate_holds_person" in [one["code"] for one in result["warnings"]]
    assert ("warning/plate_holds_person",) in mlflow_rows(store, _WARNINGS)
    assert any(line.startswith("hfb: warning: the background is the median of a clip") for line in said)


def test_a_height_is_held_through_the_clip(store: Path, tmp_path: Path) -> None:
    """And the clip need not be seen again for it: mattes and first bodies are those of before."""
    out = begun(tmp_path / "out")
    before = stamps(out, "*.png")
    run_clip(small_clip().source, out, "--fit.height-m", "1.55")
    motion, _ = load_motion(out / "motion.npz")
    assert float(height_m(load_default_body(), torch.from_numpy(motion.betas))) == pytest.approx(1.55, abs=1e-4)
    mattes = [name for name in before if "matte" in name]
    assert len(mattes) == FRAMES
    after = stamps(out, "*.png")
    assert [after[name] for name in mattes] == [before[name] for name in mattes]


def test_a_second_start_does_nothing_again(store: Path, tmp_path: Path) -> None:
    first, out = finished()[0], begun(tmp_path / "out")
    before = stamps(out, "*.*")
    result = run_clip(small_clip().truth.parent, out, truth=small_clip().truth)
    assert result["resumed_frames"] == FRAMES
    assert (out / "motion.npz").read_bytes() == (first / "motion.npz").read_bytes()
    assert stamps(out, "*.png") | stamps(out, "*.npz") == {
        n: s for n, s in before.items() if n.endswith(("png", "npz"))
    }
    assert_every_frame_once(store)  # the record was not there: it is made whole


def test_a_clip_is_recorded_later(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = begun(tmp_path / "out")
    lost(tmp_path, monkeypatch)
    result = run_clip(small_clip().truth.parent, out, truth=small_clip().truth)
    assert result["mlflow_run_id"] is None
    assert result["resumed_frames"] == 12
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{store}")
    found = assert_recorded_later(out, f"sqlite:///{store}", capsys)
    again = run_clip(small_clip().truth.parent, out, truth=small_clip().truth)
    assert again["mlflow_run_id"] == found["mlflow_run_id"]
    steps = mlflow_rows(store, "select step, count(*) from metrics where key = 'frame/seen' group by step")
    assert steps == [(step, 1) for step in range(12)]
    assert {"motion.npz", "edges.json", "recipe.json"} <= artifacts_of(store, found["mlflow_run_id"])


def test_a_changed_option_redoes_what_depends_on_it(store: Path, tmp_path: Path) -> None:
    out = begun(tmp_path / "out")
    before = stamps(out, "*.*")
    damaged = finished()[0] / "intermediate" / "matte_000004.png"
    good = damaged.read_bytes()
    damaged.write_bytes(b"damaged meanwhile")
    try:
        result = run_clip(small_clip().truth.parent, out, *LONGER, truth=small_clip().truth)
    finally:
        damaged.write_bytes(good)
    assert result["resumed_frames"] == 0
    changed = {name.split("_0")[0] for name, stamp in stamps(out, "*.*").items() if stamp != before.get(name)}
    assert {"window", "motion.npz", "edges.json", "strip.png", "matte"} <= changed
    assert not changed & {"frame", "plate.png", "key_body", "agreed_body", "first_body", "person_window", "person.npz"}
    assert stamps(out, "matte_*")["matte_000003.png"] == before["matte_000003.png"]


def test_the_number_of_workers_changes_no_byte(store: Path, tmp_path: Path) -> None:
    out = begun(tmp_path / "out")
    shutil.rmtree(out / "intermediate")
    result = run_clip(small_clip().truth.parent, out, truth=small_clip().truth, workers=1)
    assert result["resumed_frames"] == 0
    assert (out / "motion.npz").read_bytes() == (finished()[0] / "motion.npz").read_bytes()


def test_a_person_who_leaves_is_a_gap(store: Path, tmp_path: Path) -> None:
    made = small_clip(7, leaves=(3, 5))
    result = run_clip(made.truth.parent, tmp_path / "out", truth=made.truth)
    assert result["gaps"] == [[3, 5]]
    assert result["frames"] == 7
    assert result["sub_frames"] == 3 * 4
    motion, _ = load_motion(tmp_path / "out" / "motion.npz")
    assert sorted(set(motion.frame_index.tolist())) == [0, 1, 2, 6]
    seen = dict(mlflow_rows(store, "select step, value from metrics where key = 'frame/seen'"))
    assert seen == {0: 1, 1: 1, 2: 1, 3: 0, 4: 0, 5: 0, 6: 1}


def test_a_clip_of_one_frame(store: Path, tmp_path: Path) -> None:
    made = small_clip(1)
    result = run_clip(made.truth.parent, tmp_path / "out")
    assert (result["frames"], result["sub_frames"], result["worst_jump_mm"]) == (1, 3, None)
    assert_every_frame_once(store, [0])


def test_unusable_clips_are_told_and_leave_nothing(store: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    video = small_clip(4, video=True)
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(video.source.read_bytes()[: video.source.stat().st_size // 3])
    (tmp_path / "text.mp4").write_text("no video")
    other = make_other_plate(tmp_path)
    plate = str(video.background)
    for source, background, says in (
        (cut, plate, r"cut\.mp4"),
        (tmp_path / "text.mp4", plate, r"text\.mp4"),
        (video.source, str(other), "camera|background|plate"),
        (video.source, str(tmp_path / "none.png"), "does not exist"),
    ):
        with pytest.raises(InputError, match=says):
            run_clip(source, out, background=background)
        assert not out.parent.exists()


def make_other_plate(folder: Path) -> Path:
    """The view of another camera."""
    picture = read_picture_srgb(small_clip(4, video=True).background)
    from hfb.io.media.images.image_io import write_png

    write_png(folder / "other.png", np.ascontiguousarray(picture[::-1, ::-1]))
    return folder / "other.png"


def test_windows_go_together_on_a_device(store: Path, tmp_path: Path) -> None:
    """By the kernels for GPUs, here on the processor: two windows are one problem, and none is lost or done twice."""
    pytest.importorskip("warp", reason="the Warp kernels need warp-lang (pip install '.[cuda]')")
    out = begun(tmp_path / "out")
    gentle = "--video.stages", '[{"size_px": 32, "iterations": 3, "learning_rate": 0.002}]'
    options = "--fit.rasterizer", "warp", "--fit.batch-size", "2", *gentle
    result = run_clip(small_clip().truth.parent, out, *options, truth=small_clip().truth)
    assert (result["frames"], result["sub_frames"], result["resumed_frames"]) == (12, 36, 0)
    assert result["worst_jump_mm"] < 2
    by_warp, by_kernels = load_motion(out / "motion.npz")[0], load_motion(finished()[0] / "motion.npz")[0]
    off = np.linalg.norm(by_warp.joints - by_kernels.joints, axis=-1).mean()
    assert 0 < off < 0.03
    again = run_clip(small_clip().truth.parent, out, *options, truth=small_clip().truth)
    assert again["resumed_frames"] == FRAMES


def test_windows_vote_on_the_front_of_their_segment() -> None:
    def fit(segment: int, odds: float, turn_deg: float = 170.0) -> WindowHandle:
        nowhere = FileHandle(path=Path("window.npz"), sha256="0" * 64)
        return WindowHandle(
            **nowhere.model_dump(),
            frames=(0, 1),
            segment=segment,
            loss=1.0,
            mirrored=odds < 0,
            front_log_odds=odds,
            front_turn_deg=turn_deg,
        )

    voted = weigh_segments([fit(0, -0.5), fit(0, 2.0, 20.0), fit(2, -1.0), fit(3, 0.0, 0.0)])
    assert {segment: front.mirrored for segment, front in voted.items()} == {0: False, 2: True}
    assert voted[0].probability == pytest.approx(1 / (1 + np.exp(-1.5)), abs=1e-4)
    assert voted[0].turn_deg == 170


def test_a_body_is_mirrored_onto_its_frame(tmp_path: Path) -> None:
    """The task that turns every body of a segment whose other front is likelier."""
    scene = moving_scene(load_default_body(), size_px=64)
    for name, values in (("frame", scene.observation.frames_linear[0]), ("plate", scene.observation.plate_linear)):
        write_png(tmp_path / f"{name}.png", linear_to_srgb(values.numpy().clip(0, 1)))
    write_matte(tmp_path / "matte.png", scene.observation.mattes[0].numpy())
    save_first_body(tmp_path / "first.npz", scene.middle[0])
    files = {name: FileHandle.of(tmp_path / name) for name in ("frame.png", "plate.png", "matte.png")}
    rows = scene.observation.camera.matrix().tolist()
    still = ClipHandle(
        frames=(FrameHandle.of(tmp_path / "frame.png"),),
        background=files["plate.png"],
        height=64,
        width=64,
        K=tuple(tuple(row) for row in rows),
        exposure_s=0.03,
        interval_s=0.03,
        transfer="srgb",
        light="linear",
    )
    call = MirrorCall(
        number=0,
        still=still,
        matte=files["matte.png"],
        body=None,
        folder=tmp_path,
        first=FirstBodyHandle.of(tmp_path / "first.npz", source="matte"),
    )
    turned = load_first_body(mirror_body.fn(call).path)
    across = axis_angle_to_matrix(scene.middle[0].pose[0])[:, 2] @ axis_angle_to_matrix(turned.pose[0])[:, 2]
    assert across < -0.5
