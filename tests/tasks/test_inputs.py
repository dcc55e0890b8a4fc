"""What a user hands over: a calibration file is taken by its numbers, and what was said in vain is told."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hfb.config import FitConfig, RunConfig
from hfb.errors import InputError
from hfb.io.clip import Clip, read_clip
from hfb.io.media.images.image_io import write_png
from hfb.tasks.inputs.inputs import assumptions, take_inputs, with_height
from hfb.tasks.inputs.video_inputs import take_video_inputs
from hfb.tasks.video.video_clip import load_footage, load_timing, look_at_clip, reading
from tests.small_clips import FRAMES, small_clip


def calibrated(folder: Path, distortion: list[float]) -> tuple[Path, Path]:
    """(picture, clip.toml) of a camera with this lens."""
    write_png(folder / "f.png", np.zeros((48, 64, 3), np.float32))
    matrix = [[80.0, 0, 31.5], [0, 80, 23.5], [0, 0, 1]]
    (folder / "calib.json").write_text(json.dumps({"camera_matrix": matrix, "dist_coeffs": distortion}))
    (folder / "clip.toml").write_text('[camera]\ncalibration = "calib.json"\n')
    return folder / "f.png", folder / "clip.toml"


def test_a_calibration_file_becomes_numbers(tmp_path: Path) -> None:
    picture, clip = calibrated(tmp_path, [0.0] * 5)
    taken = take_inputs([picture], picture, RunConfig(), clip)
    assert taken.clip.camera.K == ((80, 0, 32), (0, 80, 24), (0, 0, 1))
    assert taken.clip.camera.calibration is None


def test_single_pictures_are_not_undistorted(tmp_path: Path) -> None:
    picture, clip = calibrated(tmp_path, [-0.3, 0.1, 0.0, 0.0])
    with pytest.raises(InputError, match=r"this lens distorts; undistort .* or use `hfb video`"):
        take_inputs([picture], picture, RunConfig(), clip)


def photographed(folder: Path, exposure_s: float | None, clip: str) -> list[str]:
    """What `hfb fit` remarks on a picture with this record and this clip.toml."""
    exif = Image.Exif()
    if exposure_s is not None:
        exif.get_ifd(0x8769)[0x829A] = exposure_s
    Image.new("RGB", (30, 20)).save(folder / "f.jpg", exif=exif)
    (folder / "clip.toml").write_text("[camera]\nfocal_px = 40\n" + clip)
    return assumptions(
        take_inputs([folder / "f.jpg"], folder / "f.jpg", RunConfig(), folder / "clip.toml"), RunConfig()
    )


@pytest.mark.parametrize(
    ("exposure_s", "clip", "said"),
    [
        (None, "", "no exposure given: assuming"),
        (0.02, "", "no exposure given: assuming"),  # a record counts where it is asked for
        (0.02, "[exposure]\nfps = 25", "no exposure given: assuming"),
        (0.02, "[exposure]\nposition = 'start'", "no exposure given: assuming"),
        (None, "[exposure]\nauto = true", "no exposure given, and the first picture does not tell it: assuming"),
        (0.02, "[exposure]\nauto = true", None),
        (None, "[exposure]\nseconds = 0.01", None),
        (None, "[exposure]\nshutter_angle = 180", None),
    ],
)
def test_an_exposure_is_assumed_only_where_none_is_known(
    tmp_path: Path, exposure_s: float | None, clip: str, said: str | None
) -> None:
    remarks = photographed(tmp_path, exposure_s, clip)
    assert len(remarks) == (said is not None)
    assert said is None or remarks[0].startswith(said)


def test_a_height_is_used_and_an_option_wins(tmp_path: Path) -> None:
    assert photographed(tmp_path, None, "[exposure]\nseconds = 0.01\n[person]\nheight_m = 1.6") == []
    clip = read_clip(tmp_path / "clip.toml")
    silent, said = RunConfig(), RunConfig(fit=FitConfig(height_m=1.9))
    assert with_height(silent, clip).fit.height_m == 1.6
    assert with_height(said, clip) == said
    assert with_height(silent, Clip()) == silent


def test_what_a_fit_does_not_use_is_said(tmp_path: Path) -> None:
    told = "[exposure]\nseconds = 0.01\nposition = 'end'\n[person]\nbox = [1, 1, 5, 5]\nheight_m = 1.8\n"
    (tmp_path / "clip.toml").write_text(
        "video = 'nowhere.mp4'\nstart = 7\nstop_s = 2.5\nbackground = 'median'\n" + told
    )
    write_png(tmp_path / "f.png", np.zeros((48, 64, 3), np.float32))
    taken = take_inputs([tmp_path / "f.png"], tmp_path / "f.png", RunConfig(), tmp_path / "clip.toml")
    assert assumptions(taken, RunConfig())[1:] == [
        "`hfb fit` does not use what clip.toml says of video, start, stop_s, background, person, exposure.position: "
        "that is for `hfb video`"
    ]


def test_a_clip_is_described_once_per_process(tmp_path: Path) -> None:
    """A folder of 20,000 images took a fifth of a second to describe, for every sixteen of them."""
    config = RunConfig()
    inputs = take_video_inputs(small_clip().source, config, None, str(small_clip().background))
    clip = look_at_clip.fn(
        inputs=inputs, average=1, camera=config.camera, exposure=config.exposure, folder=tmp_path.resolve()
    )
    with reading(clip, 0, 3) as first, reading(clip, 3, 6) as second:
        assert first is second is load_footage(clip)
        assert len(list(second.frames(3, 6))) == 3
    assert load_timing(clip) is load_timing(clip)
    assert first.count == len(load_timing(clip).openings_s) == FRAMES
