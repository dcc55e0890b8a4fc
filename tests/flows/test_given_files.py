"""A user's own networks and other systems' results, through the whole chain."""

import json
import os
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

from hfb.config import ExportConfig, FitConfig, InitConfig, MattingConfig, RunConfig, Stage
from hfb.errors import InputError
from hfb.flows.cli.options import add_config_flags, run_config
from hfb.flows.fit_image import fit_image
from hfb.interop.readers.pose_track import load_track, save_track
from hfb.interop.readers.sniff import read_tracks
from hfb.motion.static_pose import load_first_body
from hfb.tasks.video.external_poses import ResultHandle
from tests.matting.networks import DifferenceMatting, save_scripted
from tests.orchestration import Problem, mlflow_rows
from tests.small_clips import FRAMES, finished, run_clip, small_clip

FIT = FitConfig(subframes=2, texture_px=16, stages=(Stage(size_px=32, iterations=3),))


def wham_result(problem: Problem, path: Path, frames: int = 3, bystander: bool = False) -> Path:
    """The example's true middle pose as WHAM would write it, in every frame; a bystander is seen longer."""
    true = load_first_body(problem.first_body)
    one = {
        "pose": np.tile(true.pose.numpy().reshape(1, 72), (frames, 1)),
        "betas": np.zeros((frames, 10)),
        "trans": np.tile(true.translation.numpy(), (frames, 1)),
        "frame_ids": np.arange(frames),
    }
    beside = {name: np.repeat(array, 2, 0) for name, array in one.items()}
    beside |= {"trans": beside["trans"] + [1.5, 0, 0], "frame_ids": np.arange(2 * frames)}
    joblib.dump({0: beside, 7: one} if bystander else {7: one}, path)
    return path


def config(path: Path, frame: int | None = 1, **parts: Any) -> RunConfig:
    init = InitConfig(method="file", file=path, frame=frame)
    return RunConfig(fit=FIT, init=init, export=ExportConfig(films=(), report=False), **parts)


def test_a_result_and_a_matting_network_of_ones_own(problem: Problem, store: Path, tmp_path: Path) -> None:
    path = wham_result(problem, tmp_path / "wham_output.pkl", bystander=True)
    network = save_scripted(DifferenceMatting(), tmp_path / "bgm.pth")
    given = config(path, matting=MattingConfig(method="bgmv2", weights=network))
    out = tmp_path / "out"
    result = fit_image([problem.frame], problem.background, out, given)
    assert result["first_bodies"] == ["WHAM"]
    assert load_track(out / "intermediate" / "init_result.npz").person == "7"  # whom the matte shows
    assert {"init_file_0", "matting", "frame_0"} <= result["inputs"].keys()
    assert json.loads((out / "result.json").read_text()) == result
    params = dict(mlflow_rows(store, "select key, value from params"))
    assert params["input.init_file_0"] == result["inputs"]["init_file_0"]

    # another result under the same name is another start
    before = (out / "motion.npz").read_bytes()
    content = joblib.load(path)
    content[7]["pose"][:, 3:] = 0
    joblib.dump(content, path)
    again = fit_image([problem.frame], problem.background, out, given)
    assert again["inputs"]["init_file_0"] != result["inputs"]["init_file_0"]
    assert (out / "motion.npz").read_bytes() != before


def test_what_cannot_be_meant_is_said_before_anything_is_made(problem: Problem, store: Path, tmp_path: Path) -> None:
    path = wham_result(problem, tmp_path / "wham_output.pkl")
    with pytest.raises(InputError, match=r"has 3 frames and 1 are fitted: say with --init\.frame"):
        fit_image([problem.frame], problem.background, tmp_path / "out", config(path, frame=None))
    with pytest.raises(InputError, match="has nobody in frame 7"):
        fit_image([problem.frame], problem.background, tmp_path / "out", config(path, frame=7))
    with pytest.raises(InputError, match="does not exist"):
        fit_image([problem.frame], problem.background, tmp_path / "out", config(tmp_path / "missing.pkl"))

    content = joblib.load(path)
    content[7]["trans"] = content[7]["trans"] + [1.5, 0, 0]
    joblib.dump(content, path)
    with pytest.raises(InputError, match=r"where the picture shows nobody: another frame \(--init\.frame\)"):
        fit_image([problem.frame], problem.background, tmp_path / "out", config(path))

    class Attack:
        def __reduce__(self) -> Any:
            return os.system, (f"touch {tmp_path / 'attacked'}",)

    joblib.dump(Attack(), path)
    with pytest.raises(InputError, match=r"wham_output\.pkl cannot be used: its pickle asks for posix\.system"):
        fit_image([problem.frame], problem.background, tmp_path / "out", config(path))
    assert not (tmp_path / "attacked").exists()
    assert not (tmp_path / "out" / "result.json").exists()


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"init": InitConfig(method="metro")}, "--init-weights FILE"),
        ({"init": InitConfig(method="keypoints")}, "--init keypoints needs the network's file"),
        ({"init": InitConfig(method="matte", weights=Path("x"))}, "takes no --init-weights: say metro or keypoints"),
        ({"init": InitConfig(method="file")}, "with --init FILE"),
        ({"init": InitConfig(file=Path("x"))}, "does not go with init.method auto"),
        ({"matting": MattingConfig(method="bgmv2")}, "--matting-weights FILE"),
        ({"matting": MattingConfig(weights=Path("x"))}, "takes no --matting-weights"),
    ],
)
def test_halves_of_an_option(problem: Problem, parts: dict[str, Any], says: str) -> None:
    from hfb.tasks.inputs.inputs import take_inputs

    with pytest.raises(InputError, match=says):
        take_inputs([problem.frame], problem.background, RunConfig(**parts))


def test_a_result_with_a_row_per_picture_needs_no_number() -> None:
    handle = ResultHandle(path=Path("x"), sha256="0", system="WHAM", frames=(4, 5, 9))
    assert handle.numbers_of(3, None) == (4, 5, 9)
    assert handle.numbers_of(2, 5) == (5, 6)


def test_one_of_several_people_is_named() -> None:
    alone = ResultHandle(path=Path("x"), sha256="0", system="WHAM", frames=(0,))
    assert alone.remark() is None
    one = alone.model_copy(update={"person": "7", "others": ("0", "3")})
    assert one.remark() == "the WHAM result has 3 people; taken is 7, another one by --init.person (0, 3)"


def test_which_frame_of_a_result_a_clips_frame_is(tmp_path: Path) -> None:
    path = tmp_path / "result"
    path.write_bytes(b"x")
    theirs, ours = (ResultHandle.of(path, system=system, frames=tuple(range(40))) for system in ("WHAM", "hfb"))
    assert theirs.number_in_clip(2, None, began=10, average=3) == 17  # the middle one of 16 to 18
    assert theirs.number_in_clip(2, 5, began=10, average=3) == 12
    assert ours.number_in_clip(2, None, began=10, average=3) == 2  # its frames are the clip's
    assert ours.number_in_clip(2, 5, began=10, average=3) == 7


def test_short_flags() -> None:
    import argparse

    def parsed(*words: str) -> RunConfig:
        parser = argparse.ArgumentParser(allow_abbrev=False)
        parser.add_argument("--config", type=Path)
        add_config_flags(parser)
        return run_config(parser.parse_args(words))

    assert parsed("--init", "matte").init == InitConfig(method="matte")
    assert parsed("--init", "out/wham_output.pkl").init == InitConfig(method="file", file=Path("out/wham_output.pkl"))
    metro = parsed("--init", "metro", "--init-weights", "metro.pt")
    assert metro.init == InitConfig(method="metro", weights=Path("metro.pt"))
    matting = parsed("--matting", "bgmv2", "--matting-weights", "b.pth", "--matting.backbone-scale", "0.25").matting
    assert matting == MattingConfig(method="bgmv2", weights=Path("b.pth"), backbone_scale=0.25)
    assert parsed("--init.frame", "3", "--init.person", "7").init == InitConfig(frame=3, person="7")
    assert parsed("--matting", "bgmv2", "--weights", "b.pth").matting == MattingConfig(
        method="bgmv2", weights=Path("b.pth")
    )
    assert parsed("--init", "metro", "--weights", "m.pt").init == InitConfig(method="metro", weights=Path("m.pt"))
    keypoints = InitConfig(method="keypoints", weights=Path("k.onnx"))
    assert parsed("--init", "keypoints", "--init-weights", "k.onnx").init == keypoints
    assert parsed("--init", "keypoints", "--weights", "k.onnx").init == keypoints
    for words in (["--init", "matte"], ["--matting", "rvm", "--init", "metro"]):
        with pytest.raises(InputError, match="use --matting-weights and --init-weights"):
            parsed(*words, "--weights", "x.pt")


def test_a_result_of_a_whole_clip(store: Path, tmp_path: Path) -> None:
    """Frame by frame where the system saw somebody; a frame in which it saw nobody is filled by its neighbours."""
    made = small_clip()
    (truth,) = read_tracks([made.truth], 96, 128)
    seen = truth.rows(np.array([frame for frame in range(len(truth)) if frame != 5]))
    save_track(tmp_path / "track.npz", seen)
    result = run_clip(made.truth.parent, tmp_path / "out", "--init", str(tmp_path / "track.npz"), truth=made.truth)
    assert result["frames"] == FRAMES
    assert result["filled"] == [5]
    assert result["gaps"] == []
    assert {"init_file_0", "video"} <= result["inputs"].keys()
    assert result["mpjpe_mm"] < 0.8 * finished()[2]["mpjpe_mm"]  # whose start knew the matte alone
