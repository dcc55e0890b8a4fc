"""The lens that clip.toml names."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.clip import ClipCamera
from hfb.io.media.lens.clip_lens import check_pinhole, clip_lens

MATRIX = np.array([[800.0, 0, 319.5], [0, 810, 239.5], [0, 0, 1]])
DISTORTION = np.array([[-0.1, 0.02, 0.001, -0.002, 0.0]])
POSE2SIM = """
[cam01]
name = "cam01"
size = [640.0, 480.0]
matrix = [[800.0, 0.0, 319.5], [0.0, 810.0, 239.5], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.02, 0.001, -0.002]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 1.0]
fisheye = false

[cam02]
name = "cam02"
size = [640.0, 480.0]
matrix = [[900.0, 0.0, 319.5], [0.0, 900.0, 239.5], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 1.0]
fisheye = false

[metadata]
adjusted = false
"""


def write_opencv(path: Path) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", DISTORTION)
    storage.release()
    return path


@pytest.mark.parametrize("name", ["calib.yaml", "calib.xml", "calib.json", "plain.json"])
def test_as_opencv_writes_it(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "plain.json":
        path.write_text(json.dumps({"K": MATRIX.tolist(), "dist": DISTORTION.ravel().tolist()}))
    else:
        write_opencv(path)
    lens = clip_lens(ClipCamera(calibration=path), "a.mp4", 480, 640)
    assert lens is not None
    assert lens.K == (800, 810, 319.5, 239.5)
    assert lens.distortion == tuple(DISTORTION.ravel())
    assert lens.pinhole()[0] == (800, 0, 320)
    if name != "plain.json":
        with pytest.raises(InputError, match=r"640 x 480 pixels and the footage has 1280 x 720"):
            clip_lens(ClipCamera(calibration=path), "a.mp4", 720, 1280)


def test_pose2sim(tmp_path: Path) -> None:
    path = tmp_path / "Calib_scene.toml"
    path.write_text(POSE2SIM)
    assert clip_lens(ClipCamera(calibration=path), "cam01.mp4", 480, 640).K[0] == 800
    assert clip_lens(ClipCamera(calibration=path, name="cam02"), "x.mp4", 480, 640).K[0] == 900
    with pytest.raises(InputError, match=r"which of its cameras took x.mp4\? Set camera.name to one of cam01, cam02"):
        clip_lens(ClipCamera(calibration=path), "x.mp4", 480, 640)
    with pytest.raises(InputError, match=r"has no camera cam03. Set camera.name to one of cam01, cam02"):
        clip_lens(ClipCamera(calibration=path, name="cam03"), "cam01.mp4", 480, 640)


def test_none_and_mistakes(tmp_path: Path) -> None:
    assert clip_lens(ClipCamera(focal_px=3), "a.mp4", 480, 640) is None
    for name, text in [("a.yaml", "%YAML:1.0\n---\nother: 3\n"), ("b.json", "[]"), ("c.json", "{"), ("d.yaml", "\x00")]:
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError):
            clip_lens(ClipCamera(calibration=tmp_path / name), "a.mp4", 480, 640)
    with pytest.raises(InputError, match="no such file"):
        clip_lens(ClipCamera(calibration=tmp_path / "missing.yaml"), "a.mp4", 480, 640)


def _pinhole(f: float, cx: float, cy: float) -> tuple[tuple[float, float, float], ...]:
    return (f, 0.0, cx), (0.0, f, cy), (0.0, 0.0, 1.0)


def test_a_focal_length_in_millimetres_and_a_calibration_of_another_size() -> None:
    with pytest.raises(InputError, match="24 px shows 177 degrees in 1920 x 1080 pixels: give pixels"):
        check_pinhole(_pinhole(24, 960, 540), 1080, 1920)
    for scale in (0.5, 2 / 3, 2):
        (told,) = check_pinhole(_pinhole(1500, 960 * scale + 9, 540 * scale - 7), 1080, 1920)
        assert "K seems to be of another size" in told
    for cx, cy in ((960, 540), (1010, 500), (1900, 300), (-400, 540), (0, 0)):  # the last three: parts of a picture
        assert check_pinhole(_pinhole(1500, cx, cy), 1080, 1920) == ()
