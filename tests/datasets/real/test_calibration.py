"""Calibrations: round trips, the half pixel, undistortion, and files that are refused."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from hfb.errors import InputError
from hfb.io.media.lens.camera_files import camera_of, read_calibration
from tests.datasets.real.videos import HEIGHT, WIDTH, calibration_toml, cameras_json


def test_both_files_tell_the_same_camera(tmp_path: Path) -> None:
    (tmp_path / "Calib_x.toml").write_text(calibration_toml())
    (tmp_path / "cameras.json").write_text(cameras_json())
    (one,), (other,) = read_calibration(tmp_path / "Calib_x.toml"), read_calibration(tmp_path / "cameras.json")
    assert (one.width, one.height) == (other.width, other.height) == (WIDTH, HEIGHT)
    np.testing.assert_array_equal(one.K, other.K)
    np.testing.assert_allclose(one.R_camera_world, other.R_camera_world)
    assert other.video == "cam01_walk.mp4"


def test_the_pinhole_of_a_distorted_camera(tmp_path: Path) -> None:
    """A point's light lies where OpenCV projects it; undistorted, it is where the pinhole does, half a pixel off."""
    distortion = (-0.2, 0.05, 0.002, -0.001)
    text = calibration_toml(distortion).replace("rotation = [0.0, 0.0, 0.0]", "rotation = [0.1, -0.2, 0.3]")
    (tmp_path / "Calib.toml").write_text(text.replace("translation = [0.0, 0.0, 0.0]", "translation = [0.1, 0.2, 3.0]"))
    (camera,) = read_calibration(tmp_path / "Calib.toml")
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (20, 3))
    R, _ = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))
    np.testing.assert_allclose(camera.to_camera(points), points @ R.T + (0.1, 0.2, 3.0), atol=1e-12)
    stored = camera.to_stored_pixels(points)
    straight = cv2.undistortPoints(stored[:, None], camera.K, np.array(distortion), P=camera.K)[:, 0]
    ours = camera.pinhole().project(torch.from_numpy(camera.to_camera(points))).numpy()
    np.testing.assert_allclose(ours, straight + 0.5, atol=0.01)
    left, top = 7, 11
    source = camera.undistortion(left, top, WIDTH - left, HEIGHT - top)
    for pixel, light in zip(straight, stored, strict=True):
        at = cv2.remap(np.moveaxis(source, 0, -1), *(np.float32([[v]]) for v in pixel - (left, top)), cv2.INTER_LINEAR)
        np.testing.assert_allclose(at[0, 0], light, atol=0.05)
    behind = camera.to_stored_pixels(np.array([[0.0, 0, -9], [np.nan, 0, 0]]))
    assert np.isnan(behind).all()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("matrix", "metrix", "matrix"),
        ("[0.0, 0.0, 1.0]]", "[0.0, 0.0, 2.0]]", "matrix"),
        ("rotation = [0.0, 0.0, 0.0]", "rotation = [0.0, 0.0]", "rotation"),
        ("translation = [0.0, 0.0, 0.0]", 'translation = ["a", 0.0, 0.0]', "translation"),
        ("translation = [0.0, 0.0, 0.0]", "translation = [nan, 0.0, 0.0]", "translation"),
        ("fisheye = false", "distortion_model = 'omni'", "omni"),
        ("distortions = [0.0,", "distortions = [", "distortions"),
        ("size = [160.0", "size = [-160.0", "size"),
        ("[cam01]", "[cam01", "TOML"),
        ("[cam01]", "cam02 = 3\n[cam01]", "cam02"),
    ],
)
def test_a_damaged_toml_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    text = calibration_toml()
    assert old in text
    (tmp_path / "Calib.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=says):
        read_calibration(tmp_path / "Calib.toml")


def test_a_fisheye_camera(tmp_path: Path) -> None:
    """Points lie where OpenCV's fisheye model has them, and the undistorted picture is the pinhole's."""
    k = (-0.01, 0.03, -0.02, 0.004)
    text = calibration_toml(k).replace("fisheye = false", "fisheye = true")
    (tmp_path / "Calib.toml").write_text(text)
    (camera,) = read_calibration(tmp_path / "Calib.toml")
    assert camera.fisheye
    assert camera.bends
    points = np.random.default_rng(0).uniform([-0.6, -0.6, 1], [0.6, 0.6, 2], (20, 3))
    stored = camera.to_stored_pixels(points)
    r = np.hypot(points[:, 0], points[:, 1])
    angle = np.arctan2(r, points[:, 2])
    bent = angle * (1 + sum(one * angle ** (2 * power) for power, one in enumerate(k, 1)))
    K = camera.K
    expected = bent[:, None] * points[:, :2] / r[:, None] * [K[0, 0], K[1, 1]] + K[:2, 2]
    np.testing.assert_allclose(stored, expected, atol=1e-6)
    source = camera.undistortion(0, 0, WIDTH, HEIGHT)
    straight = points[:, :2] / points[:, 2:] * [K[0, 0], K[1, 1]] + K[:2, 2]
    inside = ((straight > 1) & (straight < [WIDTH - 2, HEIGHT - 2])).all(1)
    assert inside.sum() > 10
    for pixel, light in zip(straight[inside], stored[inside], strict=True):
        at = cv2.remap(np.moveaxis(source, 0, -1), *(np.float32([[v]]) for v in pixel), cv2.INTER_LINEAR)
        np.testing.assert_allclose(at[0, 0], light, atol=0.05)
    (tmp_path / "Calib.toml").write_text(text.replace("[-0.01, 0.03, -0.02, 0.004]", "[0.0, 0.0, 0.0, 0.0]"))
    (straightest,) = read_calibration(tmp_path / "Calib.toml")
    assert straightest.bends  # a fisheye without coefficients is equidistant, no pinhole
    (tmp_path / "Calib.toml").write_text(text.replace("[-0.01, 0.03, -0.02, 0.004]", "[0.1, 0.0, 0.0, 0.0, 0.2]"))
    with pytest.raises(InputError, match="fisheye lens has 4"):
        read_calibration(tmp_path / "Calib.toml")


def test_rotations_as_older_pose2sim_and_caliscope_write_them(tmp_path: Path) -> None:
    vector = np.array([0.1, -0.2, 0.3])
    R, _ = cv2.Rodrigues(vector)
    for rotation in (vector.tolist(), vector[:, None].tolist(), R.tolist()):
        text = calibration_toml().replace("rotation = [0.0, 0.0, 0.0]", f"rotation = {rotation}")
        text = text.replace("translation = [0.0, 0.0, 0.0]", "translation = [[0.32], [0.94], [2.98]]")
        (tmp_path / "Calib.toml").write_text(text)
        (camera,) = read_calibration(tmp_path / "Calib.toml")
        np.testing.assert_allclose(camera.R_camera_world, R, atol=1e-9)
        np.testing.assert_allclose(camera.t_m, [0.32, 0.94, 2.98])
    (tmp_path / "Calib.toml").write_text(text.replace(str(R.tolist()), str((2 * R).tolist())))
    with pytest.raises(InputError, match="no rotation"):
        read_calibration(tmp_path / "Calib.toml")


def test_damaged_json_is_refused(tmp_path: Path) -> None:
    path, good = tmp_path / "cameras.json", json.loads(cameras_json())
    for content in ("", "[]", "{", '{"cameras": 3}', '{"cameras": {}}', "[" * 100000, '{"cameras": {"a": 1}}'):
        path.write_text(content)
        with pytest.raises(InputError, match=r"cameras\.json"):
            read_calibration(path)
    for key, value in {
        "K": None,
        "width": "wide",
        "R_world_to_cam": np.ones((3, 3)).tolist(),
        "first_frame": -1,
        "t_world_to_cam": [0, 0],
        "video": 3,
        "height": 1e400,
    }.items():
        broken = json.loads(cameras_json())
        broken["cameras"]["cam01"] = good["cameras"]["cam01"] | {key: value}
        path.write_text(json.dumps(broken))
        with pytest.raises(InputError, match="camera cam01"):
            read_calibration(path)


def test_which_camera_took_a_video(tmp_path: Path) -> None:
    one = calibration_toml().split("[metadata]")[0]
    ten = one.replace("cam01", "cam_010")
    other = one.replace("cam01", "int_cam02_img")
    (tmp_path / "Calib.toml").write_text("\n".join([one, ten, other]))
    cameras = read_calibration(tmp_path / "Calib.toml")

    def taker(video: str) -> str | None:
        camera = camera_of(cameras, video)
        return camera.name if camera else None

    assert taker("cam01_f000-059.mp4") == "cam01"
    assert taker("cam010.mp4") == "cam_010"
    assert taker("cam02.mp4") == "int_cam02_img"
    assert taker("phone.mp4") is None
