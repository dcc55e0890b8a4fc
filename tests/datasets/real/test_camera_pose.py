"""The camera's place in the world: what calibrations, clip.toml and options say of it, and what is refused."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.config import CameraConfig, preset
from hfb.errors import InputError
from hfb.geometry.placement import angles_of_world, in_world, z_up
from hfb.geometry.world import LEVEL, World
from hfb.io.clip import ClipCamera, read_clip
from hfb.io.media.images.image_io import write_png
from hfb.io.media.lens.camera_pose import clip_world, pose_remarks
from hfb.tasks.inputs.inputs import take_inputs
from tests.datasets.real.videos import calibration_toml, cameras_json

_VECTOR, _T = np.array([1.7, -0.9, 0.6]), np.array([0.1, 0.2, 3.0])
_R = cv2.Rodrigues(_VECTOR)[0]


def pose2sim(rotation: object = _VECTOR.tolist(), translation: object = _T.tolist()) -> str:
    text = calibration_toml().replace("rotation = [0.0, 0.0, 0.0]", f"rotation = {rotation}")
    return text.replace("translation = [0.0, 0.0, 0.0]", f"translation = {translation}")


_NOTHING = CameraConfig()


def read(folder: Path, text: str, name: str = "Calib.toml", options: CameraConfig = _NOTHING) -> World | None:
    (folder / name).write_text(text)
    return clip_world(options, ClipCamera(calibration=folder / name), "cam01_walk.mp4")


def opencv(path: Path, **entries: np.ndarray) -> str:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in {"camera_matrix": np.diag([800.0, 800.0, 1.0]), **entries}.items():
        file.write(key, value)
    file.release()
    return path.read_text()


def assert_same(world: World | None) -> None:
    """The pose is inverted: the camera's centre is where R X + t = 0."""
    assert world is not None
    assert (world.source, world.up) == ("calibration", "z")
    np.testing.assert_allclose(in_world(world).points(np.zeros((1, 3)))[0], np.linalg.solve(_R, -_T), atol=1e-9)
    np.testing.assert_allclose(in_world(world).R, _R.T, atol=1e-9)


def test_poses_as_several_programs_write_them(tmp_path: Path) -> None:
    for rotation in (_VECTOR.tolist(), _VECTOR[:, None].tolist(), _R.tolist()):
        assert_same(read(tmp_path, pose2sim(rotation)))
    content = json.loads(cameras_json())
    content["cameras"]["cam01"] |= {"R_world_to_cam": _R.tolist(), "t_world_to_cam": _T.tolist()}
    assert_same(read(tmp_path, json.dumps(content), "cameras.json"))
    path = tmp_path / "camera.yml"
    assert_same(read(tmp_path, opencv(path, rvec=_VECTOR, tvec=_T), path.name))
    assert_same(read(tmp_path, opencv(path, R=_R, T=_T), path.name))


def test_what_is_no_pose_is_taken_as_none(tmp_path: Path) -> None:
    assert read(tmp_path, calibration_toml()) is None  # zeros, as files without a pose have them
    path = tmp_path / "camera.yml"
    assert read(tmp_path, opencv(path), path.name) is None
    assert read(tmp_path, opencv(path, R=np.eye(3)), path.name) is None  # a rectification
    assert clip_world(CameraConfig(), ClipCamera(focal_px=900), "a.mp4") is None


@pytest.mark.parametrize("named", [("rvec",), ("tvec",), ("rvecs", "tvecs"), ("extrinsic_parameters",)])
def test_half_a_pose_and_one_by_other_names_is_told(
    named: tuple[str, ...], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "camera.yml"
    assert read(tmp_path, opencv(path, **dict.fromkeys(named, _T)), path.name) is None
    (remark,) = pose_remarks(ClipCamera(calibration=path), "a.mp4")
    assert f"{' and '.join(named)} {'is' if len(named) == 1 else 'are'} not taken as the camera's pose" in remark
    for key in ("R_world_to_cam", "rvec", "t_world_to_cam", "tvec"):
        assert key in remark
    (tmp_path / "clip.toml").write_text(f'[camera]\ncalibration = "{path.name}"')
    picture = tmp_path / "a.png"
    write_png(picture, np.zeros((8, 8, 3), np.float32))
    take_inputs([picture], picture, preset("best"), tmp_path / "clip.toml")
    assert caplog.messages == [remark]


def test_a_pose_and_a_rectification_are_not_told(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    for entries in ({"rvec": _VECTOR, "tvec": _T}, {"R": np.eye(3)}, {}):
        opencv(path, **entries)
        assert pose_remarks(ClipCamera(calibration=path), "a.mp4") == ()
    assert pose_remarks(ClipCamera(focal_px=900), "a.mp4") == ()


@pytest.mark.parametrize(
    ("rotation", "translation", "says"),
    [
        ((np.diag([1, 1, -1]) @ _R).tolist(), _T.tolist(), "mirror"),
        ((1.01 * _R).tolist(), _T.tolist(), "orthonormal"),
        ((_R + [[0, 0, 0.02], [0, 0, 0], [0, 0, 0]]).tolist(), _T.tolist(), "orthonormal"),
        (_R.tolist()[:2], _T.tolist(), "3 or 9"),
        (_VECTOR.tolist(), [0.1, 3.0], "translation 3"),
        (_VECTOR.tolist(), ["a", 0.1, 3.0], "not numbers"),
        ("[nan, 0.0, 0.0]", _T.tolist(), "finite"),
    ],
)
def test_poses_that_are_refused(tmp_path: Path, rotation: object, translation: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read(tmp_path, pose2sim(rotation, translation))


def test_of_a_translation_in_millimetres_the_rotation_counts(tmp_path: Path) -> None:
    world, true = read(tmp_path, pose2sim(_VECTOR.tolist(), (1000 * _T).tolist())), read(tmp_path, pose2sim())
    assert world is not None
    assert true is not None
    assert (world.source, world.up, world.translation) == ("rotation", "z", (0, 0, 0))
    assert np.allclose(world.rotation, true.rotation)


def test_options_win_over_the_clip_and_the_clip_over_its_calibration(tmp_path: Path) -> None:
    text = pose2sim()
    world = read(tmp_path, text, options=CameraConfig(world_up="y"))
    assert world is not None
    assert world.up == "y"
    stated = read(tmp_path, text, options=CameraConfig(tilt_deg=20, roll_deg=-7))
    assert stated is not None
    assert stated.source == "options"
    assert angles_of_world(stated) == pytest.approx((20, -7))
    (tmp_path / "clip.toml").write_text('[camera]\ncalibration = "Calib.toml"\nroll_deg = 4.0\n')
    told = clip_world(CameraConfig(), read_clip(tmp_path / "clip.toml").camera, "cam01_walk.mp4")
    assert told is not None
    assert angles_of_world(told) == pytest.approx((0, 4))
    rows = f"rotation = {_R.tolist()}\ntranslation = {_T.tolist()}\n"
    (tmp_path / "clip.toml").write_text(f"[camera]\nfocal_px = 900.0\n{rows}")
    assert_same(clip_world(CameraConfig(), read_clip(tmp_path / "clip.toml").camera, "x.mp4"))


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        (f"rotation = {_R.tolist()}", "rotation and translation"),
        (f"rotation = {(-_R).tolist()}\ntranslation = [0, 0, 3]", "mirror"),
        (f"rotation = {_R.tolist()}\ntranslation = [0, 0, 3]\ntilt_deg = 3", "not both"),
        ("tilt_deg = 90", "between -89 and 89"),
        ('world_up = "x"', "world_up"),
    ],
)
def test_clip_files_that_are_refused(tmp_path: Path, entries: str, says: str) -> None:
    (tmp_path / "clip.toml").write_text(f"[camera]\nfocal_px = 900.0\n{entries}\n")
    with pytest.raises(InputError, match=says):
        read_clip(tmp_path / "clip.toml")


def test_angles_are_of_the_picture() -> None:
    """Looking down, the point straight ahead lies lower; rolled, what is upright leans to the right."""
    world = clip_world(CameraConfig(tilt_deg=10, roll_deg=25), ClipCamera(), "a.mp4")
    assert world is not None
    up = z_up(world).R[2]  # in camera coordinates: x right, y down
    assert up[2] < 0
    assert up[0] > 0
    assert np.degrees(np.arctan2(up[0], -up[1])) == pytest.approx(25)
    assert angles_of_world(LEVEL) == pytest.approx((0, 0))
