"""`hfb.fit` gives the digits of `hfb fit`, from files, PIL images and arrays."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import hfb
from hfb.api.call_options import config_of
from hfb.flows.fit_image import fit_image
from hfb.io.media.images.image_io import read_picture_srgb, write_png
from hfb.motion.motion_file import load_motion
from hfb.photometry import srgb_to_linear
from tests.api.conftest import TINY
from tests.orchestration import Problem

ARRAYS = ("poses", "trans", "betas", "joints", "times_s", "frame_index", "K", "joint_radius_mm")


@pytest.mark.parametrize("frames", [1, 2])
def test_the_same_digits_as_the_flow(
    problem: Problem, fitted: hfb.Result, store: Path, tmp_path: Path, frames: int
) -> None:
    several = [problem.frame] * frames
    result = fitted if frames == 1 else hfb.fit(several, problem.background, **TINY)
    config = config_of(TINY)
    config = config.model_copy(update={"export": config.export.model_copy(update={"films": (), "report": False})})
    facts = fit_image(several, problem.background, tmp_path / "out", config)
    by_flow, space = load_motion(tmp_path / "out" / "motion.npz")
    assert space == result.betas_space
    for name in ARRAYS:
        assert np.array_equal(getattr(by_flow, name), getattr(result.motion, name)), name
    timed = {"fit_seconds", "fit_stage_seconds", "config", *facts.keys() - result.facts.keys()}
    changing = {"mlflow_run_id", "mlflow_link"}
    assert {"world", "foot_skate_mm"} <= result.facts.keys()
    assert {k: v for k, v in facts.items() if k not in timed | changing} == {
        k: v for k, v in result.facts.items() if k not in timed | changing
    }
    saved = result.save(tmp_path / "saved")
    for name in ("motion.npz", "alternatives.npz", "texture.png", "matte_0.png"):
        assert (saved / name).read_bytes() == (tmp_path / "out" / name).read_bytes(), name


def test_images_in_memory(problem: Problem, fitted: hfb.Result) -> None:
    plate = Image.open(problem.background)
    levels = np.asarray(Image.open(problem.frame))
    same = hfb.fit(levels, plate, **TINY)
    assert np.array_equal(same.joints, fitted.joints)
    light = srgb_to_linear(levels.astype(np.float64) / 255)
    near = hfb.fit(light[None], np.asarray(plate), **TINY)
    assert np.abs(near.joints - fitted.joints).max() < 1e-3


def test_a_photograph_that_lies_on_its_side(problem: Problem, tmp_path: Path) -> None:
    """PIL images keep their EXIF orientation."""
    turned = Image.open(problem.frame).rotate(90, expand=True)
    exif = Image.Exif()
    exif[274] = 6
    turned.save(tmp_path / "turned.png", exif=exif)
    with Image.open(tmp_path / "turned.png") as photograph:
        upright = hfb.matte(photograph, problem.background)
    assert np.array_equal(upright, hfb.matte(problem.frame, problem.background))


def test_steps_by_themselves(problem: Problem, fitted: hfb.Result) -> None:
    alpha = hfb.matte(problem.frame, problem.background)
    assert alpha.shape == (96, 96)
    assert 0.02 < alpha.mean() < 0.5
    first = hfb.first_body(problem.frame, problem.background, init="matte")
    assert first.source == "matte"
    assert first.pose.shape == (24, 3)
    assert np.abs(first.translation.numpy() - fitted.trans.mean(0)).max() < 1


def test_a_start_from_a_file(problem: Problem, fitted: hfb.Result, tmp_path: Path) -> None:
    """Another system's result, or hfb's own, as `--init FILE` takes it."""
    file = fitted.save(tmp_path / "saved") / "motion.npz"
    result = hfb.fit(problem.frame, problem.background, **TINY | {"init": file, "directions": {"search": False}})
    assert result.facts["config"]["init"]["method"] == "file"
    assert np.abs(result.joints - fitted.joints).max() < 0.2
    with pytest.raises(hfb.InputError, match=r"gone\.pkl does not exist"):
        hfb.fit(problem.frame, problem.background, **TINY | {"init": tmp_path / "gone.pkl"})


def test_options_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text('preset = "paper"\nseed = 3\n[fit]\nsubframes = 4\n')
    chosen = config_of({"height_m": 1.8, "focal_px": 900, "fit.degree": 2, "seed": 5}, tmp_path / "run.toml")
    assert (chosen.preset, chosen.seed, chosen.fit.subframes, chosen.fit.degree) == ("paper", 5, 4, 2)
    assert (chosen.fit.height_m, chosen.camera.focal_px) == (1.8, 900)
    assert config_of({"weights": {"joints": 0}}).fit.weights.joints == 0
    assert config_of({"weights": {"joints": 0}}).fit.weights.image == config_of({}).fit.weights.image
    given = config_of({"init": "result.pkl", "prior": "mixture", "matting": "known-background", "body": "smpl.npz"})
    assert (given.init.method, given.init.file) == ("file", Path("result.pkl"))
    assert (given.prior.kind, given.matting.method, given.body.model) == (
        "mixture",
        "known-background",
        Path("smpl.npz"),
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"heigth_m": 1.8}, "unknown option heigth_m; did you mean height_m"),
        ({"method": "matte"}, "the option method is one of init and matting"),
        ({"fit": {"subframe": 3}}, "unknown option fit.subframe; did you mean fit.subframes"),
        ({"height_m": 0.9}, "fit.height_m: Input should be greater than or equal to 1.4"),
        ({"matting": "bgmv3"}, "matting.method: Input should be"),
        ({"preset": "worst"}, "preset: Input should be"),
        ({"video": {"window": 3}}, "unknown option video"),
    ],
)
def test_wrong_options(options: dict[str, object], says: str) -> None:
    with pytest.raises(hfb.InputError, match=says):
        config_of(options)


SQUARE = np.zeros((96, 96, 3), np.uint8)


@pytest.mark.parametrize(
    ("frames", "background", "says"),
    [
        (SQUARE.astype(np.int64), SQUARE, "frame_0 is of type int64: give uint8"),
        ([SQUARE[..., 0]], SQUARE, r"frame_0 has the shape \(96, 96\)"),
        (SQUARE[..., :2], SQUARE, r"frame_0 has the shape \(96, 96, 2\)"),
        (np.full((96, 96, 3), np.nan), SQUARE, "frame_0 holds values that are not finite"),
        (np.full((96, 96, 3), 128.0), SQUARE, "from 128 to 128: floating point is linear light"),
        (SQUARE, SQUARE[:64], "frame_0.png is 96 x 96 px and the background background.png 96 x 64 px"),
        ([], SQUARE, "there are no frames"),
        ("none.png", SQUARE, "none.png does not exist"),
        (SQUARE, SQUARE, "the frame does not differ from the background plate"),
    ],
)
def test_wrong_images(frames: object, background: object, says: str) -> None:
    """One sentence, without the name of a private folder or of a flag."""
    with pytest.raises(hfb.InputError, match=says) as error:
        hfb.fit(frames, background, **TINY)  # type: ignore[arg-type]
    assert "/tmp" not in str(error.value)
    assert "--" not in str(error.value)


def test_arrays_have_their_own_light(tmp_path: Path) -> None:
    (tmp_path / "clip.toml").write_text('transfer = "linear"\n')
    with pytest.raises(hfb.InputError, match="arrays are no files"):
        hfb.fit(SQUARE, SQUARE, clip=tmp_path / "clip.toml", **TINY)


def test_16_bits_of_linear_light_are_kept(tmp_path: Path) -> None:
    from hfb.api.given_images import image_files

    light = np.linspace(0, 1, 3 * 64 * 64).reshape(64, 64, 3)
    (path,) = image_files(light, tmp_path)
    assert np.abs(srgb_to_linear(read_picture_srgb(path).astype(np.float64)) - light).max() < 2e-5
    write_png(tmp_path / "plate.png", SQUARE.astype(np.float32))
