"""How camera, clock and light are settled."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from hfb.config import CameraConfig, ExposureConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.io.clip import Clip
from hfb.io.media.images.image_io import write_png
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.core.scene import load_camera, load_image
from hfb.tasks.image.prepare import prepare
from hfb.tasks.results.result_warnings import input_warnings
from tests.matting.silhouettes import composite, generated_plate


@pytest.fixture
def picture(tmp_path: Path) -> FileHandle:
    write_png(tmp_path / "a.png", np.full((40, 30, 3), 0.5, np.float32), bits=16)
    return FileHandle.of(tmp_path / "a.png")


def prepared(picture: FileHandle, clip: dict | None = None, focal_px: float | None = None, **exposure) -> ClipHandle:
    camera = CameraConfig(focal_px=focal_px)
    known = Clip.model_validate(clip or {})
    return prepare.fn(
        frames=(picture,), background=picture, clip=known, camera=camera, exposure=ExposureConfig(**exposure)
    )


def test_guesses(picture: FileHandle) -> None:
    clip = prepared(picture)
    assert (clip.height, clip.width) == (40, 30)
    assert clip.K == ((50, 0, 15), (0, 50, 20), (0, 0, 1))
    assert clip.exposure_s == clip.interval_s == pytest.approx(1 / 30)
    camera = load_camera(clip)
    assert (camera.fx, camera.cx, camera.height) == (50, 15, 40)


def test_option_over_clip_over_guess(picture: FileHandle) -> None:
    clip = {
        "camera": {"K": [[70, 0, 16], [0, 71, 19], [0, 0, 1]]},
        "exposure": {"fps": 50, "shutter_angle": 180},
    }
    told = prepared(picture, clip)
    assert told.K == ((70, 0, 16), (0, 71, 19), (0, 0, 1))
    assert (told.interval_s, told.exposure_s) == (pytest.approx(0.02), pytest.approx(0.01))
    chosen = prepared(picture, clip, focal_px=60, fps=25, seconds=0.005)
    assert chosen.K == ((60, 0, 15), (0, 60, 20), (0, 0, 1))
    assert (chosen.interval_s, chosen.exposure_s) == (pytest.approx(0.04), 0.005)


def test_a_rolling_shutter_is_told_by_options_or_the_clip(picture: FileHandle) -> None:
    assert load_camera(prepared(picture)).row_clock is None
    clip = {"exposure": {"fps": 50, "seconds": 0.01, "readout_s": 0.005, "readout_to": "right"}}
    told = load_camera(prepared(picture, clip))
    whole = PinholeCamera.from_focal(50, 40, 30)
    assert told == whole.with_readout(0.5, "right")
    assert load_camera(prepared(picture, clip, readout_s=0.01, readout_to="up")) == whole.with_readout(1.0, "up")
    assert load_camera(prepared(picture, clip, readout_s=0.0)).row_clock is None
    with pytest.raises(InputError, match="give readout_s, too"):
        prepared(picture, readout_to="left")


def test_a_photographs_own_exposure_where_it_is_asked_for(tmp_path: Path, picture: FileHandle) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x829A] = 0.008
    Image.new("RGB", (30, 40)).save(tmp_path / "f.jpg", exif=exif)
    photograph = FileHandle.of(tmp_path / "f.jpg")
    auto = {"exposure": {"fps": 50, "auto": True}}
    assert prepared(photograph, auto).exposure_s == pytest.approx(0.008)
    assert prepared(photograph, auto, seconds=0.005).exposure_s == 0.005
    assert prepared(photograph, {"exposure": {"fps": 50}}).exposure_s == pytest.approx(0.02)
    assert prepared(picture, auto).exposure_s == pytest.approx(0.02)  # it does not tell


@pytest.mark.parametrize(
    ("transfer", "light", "expected"),
    [
        ("srgb", "linear", lambda value: srgb_to_linear(value)),
        ("linear", "linear", lambda value: value),
        ("srgb", "srgb", lambda value: value),
        ("linear", "srgb", lambda value: linear_to_srgb(value)),
    ],
)
def test_light(picture: FileHandle, transfer: str, light: str, expected) -> None:
    clip = prepared(picture, {"transfer": transfer}, light=light)
    torch.testing.assert_close(load_image(picture, clip), expected(torch.full((40, 30, 3), 0.5)), atol=1e-4, rtol=0)


@pytest.mark.parametrize("light", ["srgb", "linear"])
@pytest.mark.parametrize("transfer", ["srgb", "linear"])
def test_a_frame_of_another_exposure_is_loaded_in_its_plates(tmp_path: Path, transfer: str, light: str) -> None:
    scene = composite(generated_plate("clouds"), 16, 3)
    pictures = {"as_is": scene.frame, "bright": np.clip(1.25 * scene.frame, 0, 1), "plate": scene.plate}
    for name, picture in pictures.items():
        write_png(tmp_path / f"{name}.png", linear_to_srgb(picture) if transfer == "srgb" else picture, bits=16)
    as_is, bright, plate = (FileHandle.of(tmp_path / f"{name}.png") for name in pictures)
    clip = prepare.fn(
        frames=(as_is, bright), background=plate, clip=Clip.model_validate({"transfer": transfer}),
        camera=CameraConfig(), exposure=ExposureConfig(light=light),
    )  # fmt: skip
    assert clip.remarks == ()
    assert clip.frames[0].gain == (1, 1, 1)
    assert clip.frames[1].gain == pytest.approx((1.25,) * 3, rel=0.003)
    assert ClipHandle.model_validate_json(clip.model_dump_json()) == clip
    first, second = (load_image(frame, clip) for frame in clip.frames)
    assert torch.equal(first, load_image(as_is, clip))
    assert (second - first).abs().mean() < 0.002 < (load_image(bright, clip) - first).abs().mean()
    assert torch.equal(second, load_image(clip.only(1).frames[0], clip.only(1)))


@pytest.mark.parametrize("transfer", ["srgb", "linear"])
def test_a_plate_beside_the_frame_or_in_another_exposure_is_told(tmp_path: Path, transfer: str) -> None:
    """By one sentence that names the fix; where frames differ the camera, or its crop, has moved."""
    scene = composite(generated_plate("clouds"), 16, 3)
    pictures = {
        "right": scene.frame,
        "plate": scene.plate,
        "beside": np.roll(scene.frame, (4, 3), (0, 1)),
        "bright": np.clip(1.6 * scene.frame, 0, 1),
    }
    for name, picture in pictures.items():
        write_png(tmp_path / f"{name}.png", linear_to_srgb(picture) if transfer == "srgb" else picture, bits=16)
    files = {name: FileHandle.of(tmp_path / f"{name}.png") for name in pictures}
    clip = Clip.model_validate({"transfer": transfer})

    def remarks(*names: str) -> tuple[str, ...]:
        frames = tuple(files[name] for name in names)
        made = prepare.fn(
            frames=frames, background=files["plate"], clip=clip, camera=CameraConfig(), exposure=ExposureConfig()
        )
        assert made.plate_remarks == made.remarks
        return made.remarks

    assert remarks("right") == ()
    (beside,), (bright,) = remarks("beside"), remarks("bright")
    assert "do not lie on each other (about 5 px apart)" in beside
    assert "register the plate to the frame, or give a plate of the same clip" in beside
    assert "differ in exposure (by a factor of about 1.6)" in bright
    assert "(--background)" in bright
    (moved,) = remarks("right", "beside")
    assert remarks("beside", "right") == (moved,)
    assert "the crop of its stabiliser, moves against the plate (by about 5 px)" in moved
    assert remarks("right", "right") == ()


def test_a_remark_on_a_file_is_no_remark_on_the_plate(tmp_path: Path) -> None:
    scene = composite(generated_plate("clouds"), 16, 3)
    for name, picture in {"frame": np.roll(scene.frame, (4, 3), (0, 1)), "plate": scene.plate}.items():
        write_png(tmp_path / f"{name}.png", linear_to_srgb(picture))
    frame, plate = (tmp_path / f"{name}.png" for name in ("frame", "plate"))
    with Image.open(frame) as opened:
        clear = opened.convert("RGBA")
    clear.putalpha(200)
    clear.save(frame)
    clip = prepare.fn(
        frames=(FileHandle.of(frame),), background=FileHandle.of(plate), clip=Clip(), camera=CameraConfig(),
        exposure=ExposureConfig(),
    )  # fmt: skip
    codes = {one.code: one.message for one in input_warnings(clip.remarks, clip.plate_remarks)}
    assert "is transparent" in codes["input"]
    assert "do not lie on each other" in codes["plate"]
