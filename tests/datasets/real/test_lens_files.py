"""Lenses out of the calibration files of many makers: the right model, or a sentence that names the wrong one."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.clip import ClipCamera
from hfb.io.media.lens.clip_lens import clip_lens
from hfb.io.media.lens.lens import Lens

K = [[300.0, 0, 320], [0, 310.0, 240], [0, 0, 1]]
FISHEYE = (-0.01, 0.03, -0.02, 0.004)
STANDARD = (-0.4, 0.22, 0.0003, 0.0004, -0.08)
_MATRICES = """camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 300., 0., 320., 0., 310., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ -0.01, 0.03, -0.02, 0.004 ]
"""
_ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [300., 0., 320., 0., 310., 240., 0., 0., 1.]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: {values}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
"""
_ROS2 = """header:
  frame_id: camera
height: 480
width: 640
distortion_model: {model}
d:
{values}
k:
- 300.0
- 0.0
- 320.0
- 0.0
- 310.0
- 240.0
- 0.0
- 0.0
- 1.0
roi:
  do_rectify: false
"""
_KALIBR = """cam0:
  T_cam_imu:
  - [0.0148, -0.9998, 0.0041, -0.0216]
  - [0.9995, 1.49e-02, 0.0257, -0.0646]
  cam_overlaps: [1]
  camera_model: {camera}
  distortion_coeffs: [{values}]
  distortion_model: {model}
  intrinsics: [{intrinsics}]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.0, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [500.0, 500.0, 320.0, 240.0]
  resolution: [640, 480]
"""
_TOML = """[cam_0]
size = [640, 480]
matrix = [[300.0, 0.0, 320.0], [0.0, 310.0, 240.0], [0.0, 0.0, 1.0]]
distortions = {values}
{more}
"""


def _ros(model: str, values: tuple[float, ...]) -> str:
    return _ROS.format(model=model, count=len(values), values=list(values))


def _ros2(model: str, values: tuple[float, ...]) -> str:
    return _ROS2.format(model=model, values="\n".join(f"- {value}" for value in values))


def _kalibr(camera: str, model: str, values: tuple[float, ...], intrinsics: str = "300.0, 310.0, 320.0, 240.0") -> str:
    listed = ", ".join(map(str, values))
    return _KALIBR.format(camera=camera, model=model, values=listed, intrinsics=intrinsics)


def read(folder: Path, name: str, text: str) -> Lens:
    (folder / name).write_text(text)
    lens = clip_lens(ClipCamera(calibration=folder / name), "cam0.mp4", 480, 640)
    assert lens is not None
    return lens


_ARE_FISHEYES = {
    "ros.yaml": _ros("equidistant", FISHEYE),
    "ros_fisheye.yaml": _ros("fisheye", FISHEYE),
    "t265.yaml": _ros("kannala_brandt4", (*FISHEYE, 0.0)),
    "ros2.yaml": _ros2("equidistant", FISHEYE),
    "kalibr.yaml": _kalibr("pinhole", "equidistant", FISHEYE),
    "kalibr_equi.yaml": _kalibr("pinhole", "equi", FISHEYE),
    "opencv_model.yaml": "%YAML:1.0\n---\nimage_width: 640\ndistortion_model: equidistant\n" + _MATRICES,
    "opencv_sample.yaml": "%YAML:1.0\n---\nfisheye_model: 1\n" + _MATRICES,
    "pose2sim.toml": _TOML.format(values=list(FISHEYE), more="fisheye = true"),
    "plain.json": json.dumps({"K": K, "D": list(FISHEYE), "is_fisheye": True}),
    "flat.json": json.dumps({"K": K, "D": [[one] for one in FISHEYE], "camera_model": "OPENCV_FISHEYE"}),
    "nested.json": json.dumps({"fisheye": {"camera_matrix": K, "dist_coeffs": list(FISHEYE)}}),
    "named.json": json.dumps(
        {"mtx": K, "dist": dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True)), "model": "Fisheye"}
    ),
}


@pytest.mark.parametrize("name", list(_ARE_FISHEYES))
def test_fisheyes(tmp_path: Path, name: str) -> None:
    assert read(tmp_path, name, _ARE_FISHEYES[name]) == Lens((300, 310, 320, 240), FISHEYE, fisheye=True)


_ARE_STANDARD = {
    "ros.yaml": _ros("plumb_bob", STANDARD),
    "rational.yaml": _ros("rational_polynomial", (*STANDARD, 0.1, 0.2, 0.3)),
    "ros2.yaml": _ros2("plumb_bob", STANDARD),
    "kalibr.yaml": _kalibr("pinhole", "radtan", STANDARD[:4]),
    "kalibr_none.yaml": _kalibr("pinhole", "none", ()),
    "euroc.yaml": "sensor_type: camera\nresolution: [640, 480]\ncamera_model: pinhole\n"
    "intrinsics: [300, 310, 320, 240] # fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.4, 2.2e-1, 0.0003, 4e-4]\n",
    "opencv_sample.yaml": "%YAML:1.0\n---\nfisheye_model: 0\n" + _MATRICES,
    "pose2sim.toml": _TOML.format(values=[[one] for one in STANDARD], more="fisheye = false"),
    "product.json": json.dumps({"K": K, "dist": list(STANDARD), "camera_model": "GoPro HERO9", "model": "iPhone 15"}),
    "realsense.json": json.dumps({"K": K, "dist": [0] * 5, "model": "distortion.inverse_brown_conrady"}),
    "named.json": json.dumps({"K": K, "dist": dict(zip(("k1", "k2", "p1", "p2", "k3"), STANDARD, strict=True))}),
}


@pytest.mark.parametrize("name", list(_ARE_STANDARD))
def test_standard_lenses(tmp_path: Path, name: str) -> None:
    lens = read(tmp_path, name, _ARE_STANDARD[name])
    assert lens.K == (300, 310, 320, 240)
    assert not lens.fisheye
    expected = {
        "rational.yaml": (*STANDARD, 0.1, 0.2, 0.3),
        "kalibr.yaml": STANDARD[:4],
        "euroc.yaml": STANDARD[:4],
        "kalibr_none.yaml": (0, 0, 0, 0),
        "opencv_sample.yaml": FISHEYE,
        "realsense.json": (0,) * 5,
    }
    assert lens.distortion == expected.get(name, STANDARD)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("fov.yaml", _kalibr("pinhole", "fov", (0.9,)), "fov"),
        ("omni.yaml", _kalibr("omni", "radtan", STANDARD[:4], "1.5, 300, 310, 320, 240"), "omni"),
        ("ds.yaml", _kalibr("ds", "none", (), "-0.2, 0.6, 300, 310, 320, 240"), "ds"),
        ("division.json", json.dumps({"K": K, "D": [-0.3, 0, 0, 0], "distortion_model": "division"}), "division"),
        ("mei.yaml", "%YAML:1.0\n---\nmodel_type: MEI\n" + _MATRICES, "MEI"),
        ("xi.yaml", "%YAML:1.0\n---\nxi: 1.2\n" + _MATRICES, "omnidirectional"),
        ("new.yaml", _ros("woodscape_cubic", FISHEYE), "woodscape_cubic"),
        ("few.yaml", _ros("equidistant", FISHEYE[:3]), "fisheye lens has 4"),
        ("six.toml", _TOML.format(values=[0.1] * 6, more=""), "4, 5, 8, 12 or 14"),
        ("nan.yaml", _ros("plumb_bob", (float("nan"), 0, 0, 0)), "not finite|not numbers"),
        ("skew.json", json.dumps({"K": [[300, 5, 320], *K[1:]], "D": list(STANDARD)}), "skew"),
        ("k5.json", json.dumps({"K": K, "fisheye": True, "D": {"k1": 0.1, "p1": 0.2}}), "p1"),
        ("alias.yaml", "a: &a [1, 2]\nK: [*a, *a]\n", "aliases"),
        ("keys.yaml", "1: {2: 3}\nK: [[1, 2], [3]]\n4: [5]\n", "not numbers"),
        ("list.yaml", "- 1\n- 2\n", "no camera_matrix"),
        ("keys_of_lens.yaml", "K: [300, 310, 320, 240]\nD: {1: 0.5}\n7: x\n", "which is none of k1"),
        ("section.toml", "[metadata]\nerror = 1.0\n", "no camera_matrix"),
    ],
)
def test_other_models_are_refused_by_name(tmp_path: Path, name: str, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read(tmp_path, name, text)


@pytest.mark.parametrize("rotation", [[[1.7], [1.05], [-0.4]], np.eye(3).tolist(), None, "unknown"])
def test_a_lens_needs_no_place(tmp_path: Path, rotation: object) -> None:
    more = "" if rotation is None else f"rotation = {json.dumps(rotation)}\ntranslation = [[0.3], [0.9], [2.9]]"
    lens = read(tmp_path, "Calib.toml", _TOML.format(values=list(STANDARD), more=more + "\nfisheye = false"))
    assert lens == Lens((300, 310, 320, 240), STANDARD)


def test_a_camera_of_several_is_chosen_by_the_video(tmp_path: Path) -> None:
    path = tmp_path / "chain.yaml"
    path.write_text(_kalibr("pinhole", "equidistant", FISHEYE))
    assert clip_lens(ClipCamera(calibration=path), "cam1_walk.mp4", 480, 640).K[0] == 500
    assert clip_lens(ClipCamera(calibration=path, name="cam0"), "x.mp4", 480, 640).fisheye
    with pytest.raises(InputError, match=r"which of its cameras took x\.mp4"):
        clip_lens(ClipCamera(calibration=path), "x.mp4", 480, 640)
    with pytest.raises(InputError, match="640 x 480 pixels"):
        clip_lens(ClipCamera(calibration=path), "cam1_walk.mp4", 240, 320)


def test_a_fisheye_picture_is_made_straight() -> None:
    """Straight lines of the world are straight again, at the pinhole's pixels."""
    lens = Lens((300.0, 300.0, 319.5, 239.5), FISHEYE, fisheye=True)
    matrix = np.array([[300.0, 0, 319.5], [0, 300, 239.5], [0, 0, 1]])
    places = np.array([[-0.5, -0.4], [0.6, -0.2], [0.3, 0.5], [-0.4, 0.3], [0.05, 0.02]])
    seen = cv2.fisheye.distortPoints(places[None], matrix, np.array(FISHEYE))[0]
    picture = np.zeros((480, 640, 3), np.float32)
    rows, columns = np.mgrid[:480, :640]
    for x, y in seen:
        picture += np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18)[..., None].astype(np.float32)
    straight = lens.undistorted(picture)[..., 0]
    assert lens.bends(480, 640)
    for x, y in places * 300 + [319.5, 239.5]:
        near = straight[round(y) - 12 : round(y) + 13, round(x) - 12 : round(x) + 13]
        down, right = np.mgrid[round(y) - 12 : round(y) + 13, round(x) - 12 : round(x) + 13]
        assert abs((near * right).sum() / near.sum() - x) < 0.5
        assert abs((near * down).sum() / near.sum() - y) < 0.5
    assert Lens(lens.K, (0.0,) * 4, fisheye=True).bends(480, 640)
    assert not Lens(lens.K, (0.0,) * 4).bends(480, 640)
