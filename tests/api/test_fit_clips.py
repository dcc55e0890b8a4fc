"""`hfb.fit_clip` gives the digits of `hfb video`, from files and arrays; what it saves is repeated by `hfb rerun`."""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import hfb
from hfb.api.call_options import config_of
from hfb.api.given_images import image_files
from hfb.config import InitConfig, MattingConfig
from hfb.errors import InputError
from hfb.flows.record import record_folder
from hfb.flows.rerun import plan_rerun, repeat
from hfb.initialization.initializer import make_initializer
from hfb.matting.methods import make_matting
from hfb.motion.motion_file import load_motion
from hfb.priors.load import load_pose_prior
from hfb.tasks.chains.clip_chain import fit_clip
from hfb.tasks.inputs.video_inputs import take_video_inputs
from hfb.tasks.task import without_prefect
from tests.api.conftest import TINY
from tests.api.test_fit_images import ARRAYS
from tests.orchestration import Problem
from tests.small_clips import FRAMES, finished, small_clip, small_config

SMALL: dict[str, Any] = {
    "init": "matte",
    "matting": "known-background",
    "subframes": 3,
    "texture_px": 16,
    "stages": [{"size_px": 32, "iterations": 3}],
    "settle": 0,
    "weights": {"joints": 0},
    "matte_scales": 1,
    "image_scales": 1,
    "key_every": FRAMES,
    "video": {"window": 2, "person_windows": 1, "stages": [{"size_px": 32, "iterations": 3}], "longest_fill": 1},
}
"""`tests.small_clips.SMALL_OPTIONS` as keyword arguments."""


@pytest.fixture(scope="module")
def motion() -> hfb.Result:
    return hfb.fit_clip(small_clip().truth.parent, **SMALL)


@pytest.mark.integration
def test_the_same_digits_as_the_command(motion: hfb.Result, tmp_path: Path) -> None:
    out, _, facts = finished()
    assert config_of(SMALL, clip=True).model_dump(exclude={"export"}) == small_config().model_dump(exclude={"export"})
    by_command, space = load_motion(out / "motion.npz")
    assert space == motion.betas_space
    for name in ARRAYS:
        assert np.array_equal(getattr(by_command, name), getattr(motion.motion, name), equal_nan=True), name
    saved = motion.save(tmp_path / "saved")
    for name in ("motion.npz", "edges.json", "texture.png", "strip.png"):
        assert (saved / name).read_bytes() == (out / name).read_bytes(), name
    other = {"seconds", "workers_busy", "config", "mlflow_run_id", "mlflow_link", "inputs", "mpjpe_mm"}
    mine = json.loads(json.dumps(dict(motion.facts)))
    assert {name: value for name, value in mine.items() if name not in other} == {
        name: value for name, value in facts.items() if name in mine.keys() - other
    }
    assert hfb.load_result(saved).facts["windows"] == motion.facts["windows"]


def test_a_pair_of_frames_settles_the_person_whatever_the_windows(tmp_path: Path) -> None:
    config = small_config()
    config = config.model_copy(update={"video": config.video.model_copy(update={"window": 4})})
    with without_prefect():
        fit_clip(take_video_inputs(small_clip(5).truth.parent, config), config, tmp_path)
    lengths = {path.stem: len(np.load(path)["frames"]) for path in tmp_path.glob("*window_*.npz")}
    (person,) = lengths.keys() - {"window_000000", "window_000003"}
    assert lengths == {"window_000000": 4, "window_000003": 2, person: 2}


def test_a_saved_clip_is_made_again(motion: hfb.Result, store: Path, tmp_path: Path) -> None:
    """Moved meanwhile, read and saved once more: its record goes with it, and into MLflow before it is repeated."""
    saved = hfb.load_result(motion.save(tmp_path / "first")).save(tmp_path / "saved")
    plan = plan_rerun(str(saved), None, tmp_path / "again", workers=2)
    assert not (saved / "record.json").exists()
    assert plan.run.name == "saved"
    assert plan.run.metrics["eval/matte_iou"] > 0
    verdict = repeat(plan)
    assert verdict["bit_equal"]
    assert verdict["files_that_differ"] == []
    assert verdict["changed"] == []


def test_frames_in_memory_and_gaps(store: Path, tmp_path: Path) -> None:
    made = small_clip(7, leaves=(3, 5))
    frames = [np.asarray(Image.open(path)) for path in sorted(made.source.iterdir())]
    told: list[str] = []
    result = hfb.fit_clip(
        frames, made.background, clip=made.clip, on_progress=lambda label, *_: told.append(label), **SMALL
    )
    assert result.gaps == ((3, 5),)
    assert sorted(result.missed) == [3, 4, 5]
    assert all(result.missed.values())
    assert not set(result.frame_index.tolist()) & {3, 4, 5}
    assert {"frames", "mattes", "windows", "join"} <= set(told)
    saved = result.save(tmp_path / "saved")
    assert hfb.load_result(saved).missed == result.missed
    with pytest.raises(InputError, match="saved cannot be repeated by a command, since its images were given in mem"):
        plan_rerun(str(saved))
    (one,) = record_folder(saved)["runs"]
    with pytest.raises(InputError, match="cannot be repeated by a command, since its images were given in memory"):
        plan_rerun(one["mlflow_run_id"])


@pytest.mark.integration
def test_functions_take_the_place_of_options(motion: hfb.Result, store: Path, tmp_path: Path) -> None:
    """Those that do what the options would do give the same digits; a term of the caller's own moves the body."""
    asked: dict[str, int] = {"matting": 0, "init": 0, "prior": 0, "low": 0}

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            asked[name] += 1
            return function(*given)

        return call

    own: dict[str, Any] = {
        "matting": counted("matting", make_matting(MattingConfig(method="known-background"))),
        "init": counted("init", make_initializer(InitConfig(method="matte"))),
        "prior": counted("prior", load_pose_prior(None, "anatomy")),
    }
    source = small_clip().truth.parent
    same = hfb.fit_clip(source, **SMALL | own)
    for name in ARRAYS:
        assert np.array_equal(getattr(same.motion, name), getattr(motion.motion, name), equal_nan=True), name
    assert same.facts["own_parts"] == ["matting", "init", "prior"]
    low = {"low": (counted("low", lambda seen: seen.joints[..., 1].mean()), 100.0)}
    moved = hfb.fit_clip(source, extra_terms=low, **SMALL)
    assert moved.joints[..., 1].mean() < motion.joints[..., 1].mean() - 0.01
    assert all(count > 0 for count in asked.values())
    with pytest.raises(InputError, match="since low x 100 is a function of the caller's: repeat its call"):
        plan_rerun(str(moved.save(tmp_path / "moved")))
    ids = set()
    for name, result in (("plain", motion), ("same", same), ("moved", moved)):
        folder = tmp_path / name if name == "moved" else result.save(tmp_path / name)
        ids.add(record_folder(folder)["runs"][0]["mlflow_run_id"])
    assert len(ids) == 3


def test_a_crop_that_moves_is_told(motion: hfb.Result) -> None:
    made = small_clip(7, leaves=(3, 5))
    frames = [np.array(Image.open(path)) for path in sorted(made.source.iterdir())]
    for frame in frames[4:]:
        frame[:] = np.roll(frame, 7, axis=1)
    found = hfb.fit_clip(frames, made.background, clip=made.clip, **SMALL).warnings
    (told,) = [one for one in found if "crop of its stabiliser" in one]
    assert "moves against the plate (by about 7 px)" in told
    assert not any("stabiliser" in one for one in motion.warnings)


@pytest.mark.parametrize("own", [False, True])
def test_a_saved_fit_is_made_again(
    problem: Problem, fitted: hfb.Result, store: Path, tmp_path: Path, own: bool
) -> None:
    """A function of the caller's is no file: it has a run of its own, and is not repeated."""
    saved = fitted.save(tmp_path / "plain")
    assert json.loads((saved / "record.json").read_text())["tags"]["hfb.command"] == "fit"
    if not own:
        assert repeat(plan_rerun(str(saved), None, tmp_path / "again"))["bit_equal"]
        return
    options = TINY | {"directions": {"search": False}}
    mine = hfb.fit(problem.frame, problem.background, extra_terms={"low": lambda seen: seen.joints.mean()}, **options)
    with pytest.raises(InputError, match="since low x 1 is a function of the caller's: repeat its call"):
        plan_rerun(str(mine.save(tmp_path / "mine")))
    ids = {record_folder(tmp_path / name)["runs"][0]["mlflow_run_id"] for name in ("plain", "mine")}
    assert len(ids) == 2


def test_nothing_is_no_clip(tmp_path: Path) -> None:
    for nothing in (None, 3):
        with pytest.raises(InputError, match=rf"frames is a {type(nothing).__name__}: give a path, a PIL image or"):
            image_files(nothing, tmp_path)


SQUARE = np.zeros((96, 96, 3), np.uint8)


@pytest.mark.parametrize(
    ("video", "options", "says"),
    [
        ([SQUARE, SQUARE.astype(np.int64)], {}, "frame_1 is of type int64: give uint8"),
        ([SQUARE, np.full((96, 96, 3), np.nan)], {}, "frame_1 holds values that are not finite"),
        ([SQUARE, SQUARE[..., 0]], {}, r"frame_1 has the shape \(96, 96\)"),
        ([SQUARE, SQUARE[:64]], {}, "frame_1.png"),
        ([SQUARE, SQUARE], {"background": SQUARE[:64]}, "and the background plate 96 x 64"),
        ([SQUARE, SQUARE], {"background": "none.png"}, "none.png does not exist; give a picture, median or still"),
        ([SQUARE, SQUARE], {}, "nobody"),
        ([], {}, "there are no frames"),
        (SQUARE, {}, "one image is no clip"),
        ([SQUARE], {"background": SQUARE}, "nobody"),
        ("none.mp4", {}, "none.mp4 does not exist"),
        ("empty", {}, "empty holds neither a video nor pictures"),
        ([SQUARE, SQUARE], {"extra_terms": {"loss": lambda _: 0}}, "the extra term 'loss' has the name of a term"),
        ([SQUARE, SQUARE], {"windw": 3}, "unknown option windw; did you mean window"),
        ([SQUARE, SQUARE], {"window": 9}, "video.window: Input should be less than or equal to 5"),
        ([SQUARE, SQUARE], {"clip": "clip.toml"}, "clip.toml means everyone"),
    ],
)
def test_what_is_refused(
    video: Any, options: dict[str, Any], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One sentence without the name of a private folder or of a flag; nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "clip.toml").write_text('[person]\nwhich = "everyone"\n')
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    with pytest.raises(InputError, match=says) as error:
        hfb.fit_clip(video, **options)
    assert "temporary" not in str(error.value)
    assert "--" not in str(error.value)
    assert list((tmp_path / "temporary").iterdir()) == []
