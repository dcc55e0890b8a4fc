"""RTMPose's, RTMW's and ViTPose's interfaces: places in the picture, and the body that is laid onto them."""

from pathlib import Path

import numpy as np
import pytest
import torch
from onnx import NodeProto, helper
from torch import nn

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.config import InitConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.initializer import Initializer, make_initializer
from hfb.initialization.joint_layouts import COCO_17
from hfb.initialization.keypoint_network import KeypointNetwork
from hfb.initialization.silhouette_fit import silhouette
from hfb.motion.static_pose import FirstBody
from hfb.photometry import srgb_to_linear
from hfb.rendering.backends import make_rasterizer
from tests.initialization.keypoint_networks import (
    colour_network,
    constant_network,
    heatmaps_of,
    paint,
    save_network,
    simcc_of,
)
from tests.scenes import standing_pose

BODY = load_default_body()
CAMERA = PinholeCamera.from_focal(600.0, 400, 520)
KNOWN = tuple(name for name in COCO_17 if name in JOINT_NAMES)


def someone() -> FirstBody:
    pose = standing_pose()
    pose[18, 1], pose[17, 2], pose[4, 0], pose[1, 2] = -0.9, 0.7, 0.5, 0.25
    return FirstBody(pose, torch.tensor([0.4, 0.15, 4.0]), torch.zeros(10), "truth")


def joints_of(first: FirstBody) -> torch.Tensor:
    turns, place = axis_angle_to_matrix(first.pose)[None], first.translation[None]
    return BODY.shape(first.betas).joints_of(turns, place)[0]


def seen(first: FirstBody) -> dict[str, np.ndarray]:
    """Where COCO's joints are seen [px]."""
    pixels = CAMERA.project(joints_of(first)).numpy()
    return {name: pixels[JOINT_NAMES.index(name)] for name in KNOWN}


def matte_of(first: FirstBody) -> np.ndarray:
    return silhouette(first, CAMERA, BODY, make_rasterizer()).numpy()


def apart_px(points: np.ndarray, true: dict[str, np.ndarray]) -> np.ndarray:
    return np.array([np.hypot(*(points[COCO_17.index(name), :2] - at)) for name, at in true.items()])


def drawn(first: FirstBody, fade: float = 0.0) -> np.ndarray:
    """The person as discs before gray."""
    return paint(np.full((400, 520, 3), 0.5, np.float32), seen(first), 5.0, fade)


def found_by(
    network: KeypointNetwork, frame_srgb: np.ndarray, matte: np.ndarray, plate_srgb: np.ndarray | float = 0.5
) -> np.ndarray:
    """What the network finds in a picture before a plate, both as files hold them."""
    plate = np.broadcast_to(np.float32(plate_srgb), frame_srgb.shape)
    return network.find(*(srgb_to_linear(one).astype(np.float32) for one in (frame_srgb, plate)), matte)


@pytest.mark.parametrize("kind", ["simcc", "heatmaps"])
@pytest.mark.parametrize(("height", "width"), [(256, 192), (384, 288)])
@pytest.mark.parametrize("layout", [17, 26, 133])
def test_a_drawn_figure_is_found_to_a_pixel(tmp_path: Path, kind: str, height: int, width: int, layout: int) -> None:
    true = someone()
    network = KeypointNetwork(colour_network(tmp_path / "network.onnx", kind, height, width, layout))
    points = found_by(network, drawn(true), matte_of(true))
    assert points.shape == (layout, 3)
    away = apart_px(points, seen(true))
    assert away.max() < 1.5, away
    assert away.mean() < 0.7, away


def test_what_stands_in_the_plate_does_not_mislead(tmp_path: Path) -> None:
    """Brighter discs beside the person, within the crop: they win where they count as the person's, else are gone."""
    true, network = someone(), KeypointNetwork(colour_network(tmp_path / "network.onnx", "simcc"))
    matte, at = matte_of(true), seen(true)
    rows, columns = (np.flatnonzero((matte > 0.1).any(axis)) for axis in (1, 0))
    edge = columns[-1] + 12.0
    beside = {name: np.array([edge, y]) for name, y in zip(at, np.linspace(rows[0], rows[-1], len(at)), strict=True)}
    frame = paint(drawn(true, fade=0.1), beside, 5.0)
    plate = paint(np.full_like(frame, 0.5), beside, 5.0)
    assert apart_px(found_by(network, frame, np.ones_like(matte), plate), at).max() > 20
    assert apart_px(found_by(network, frame, matte, plate), at).max() < 2


def test_a_limb_that_the_matte_lacks_is_seen(tmp_path: Path) -> None:
    """The plate is subtracted, so that what differs from it stays."""
    true, network = someone(), KeypointNetwork(colour_network(tmp_path / "network.onnx", "simcc"))
    matte, at = matte_of(true), seen(true)
    x, y = (round(float(value)) for value in at["left_knee"])
    lacking = matte.copy()
    lacking[y - 9 : y + 9, x - 9 : x + 9] = 0
    assert apart_px(found_by(network, drawn(true), lacking), at).max() < 2


def test_known_peaks(tmp_path: Path) -> None:
    """Half pixels of SimCC, and a Gaussian's peak between a heatmap's pixels, in the middle of a square matte."""
    matte = np.zeros((100, 120), np.float32)
    matte[20:84, 30:78] = 1  # 64 x 48 px, so that a pixel of the input is 1.25 * 64 / 256 of the picture's
    points = np.stack([np.linspace(20.5, 170, 17).round(), np.linspace(30, 220.5, 17).round(1)], 1)
    points = np.round(2 * points) / 2
    expected = (points + 0.5 - (96, 128)) * 1.25 * 64 / 256 + (54, 52)
    frame = np.full((100, 120, 3), 0.5, np.float32)
    found = found_by(KeypointNetwork(constant_network(tmp_path / "a.onnx", *simcc_of(points))), frame, matte)
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-5)
    np.testing.assert_allclose(found[:, 2], 1, atol=1e-5)
    swapped = constant_network(tmp_path / "b.onnx", *simcc_of(points)[::-1])
    np.testing.assert_allclose(found_by(KeypointNetwork(swapped), frame, matte), found, atol=1e-9)
    small = points * (47 / 191, 63 / 255)
    maps = constant_network(tmp_path / "c.onnx", heatmaps_of(small), shape=("batch", 3, "height", "width"))
    np.testing.assert_allclose(found_by(KeypointNetwork(maps), frame, matte)[:, :2], expected, atol=0.05)


def test_heatmaps_without_a_peak(tmp_path: Path) -> None:
    """What is flat, negative or at the edge gives numbers all the same; its confidence says what they are worth."""
    flat, negative, corner = np.zeros((64, 48)), np.full((64, 48), -1.0), np.zeros((64, 48))
    corner[63, 47] = 1
    maps = np.concatenate([np.stack([flat, negative, corner]), np.zeros((14, 64, 48))])[None]
    network = KeypointNetwork(constant_network(tmp_path / "a.onnx", maps))
    frame = np.full((60, 60, 3), 0.5, np.float32)
    matte = np.zeros((60, 60), np.float32)
    matte[10:50, 20:40] = 1
    found = found_by(network, frame, matte)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:3, 2], [0, -1, 1])
    initializer = make_initializer(InitConfig(method="keypoints", weights=tmp_path / "a.onnx"))
    with pytest.raises(InputError, match="fewer than 6 keypoints"):
        initializer(frame, frame, matte, PinholeCamera.from_focal(60.0, 60, 60), BODY)


@pytest.mark.parametrize("kind", ["simcc", "heatmaps"])
def test_the_body_of_the_network(tmp_path: Path, kind: str) -> None:
    true = someone()
    path = colour_network(tmp_path / "network.onnx", kind)
    frame = srgb_to_linear(drawn(true)).astype(np.float32)
    found = []
    for _ in range(2):
        initializer = make_initializer(InitConfig(method="keypoints", weights=path))
        assert isinstance(initializer, Initializer)
        found.append(initializer(frame, srgb_to_linear(np.full_like(frame, 0.5)), matte_of(true), CAMERA, BODY))
    assert found[0].source == "keypoints"
    assert all(torch.equal(getattr(found[0], name), getattr(found[1], name)) for name in ("pose", "translation"))
    joints = [joints_of(one) for one in (true, found[0])]
    known = [JOINT_NAMES.index(name) for name in KNOWN]
    pixels = (CAMERA.project(joints[0]) - CAMERA.project(joints[1])).norm(dim=-1)[known]
    assert float(pixels.mean()) < 2
    relative = 1000 * ((joints[0] - joints[0][0]) - (joints[1] - joints[1][0])).norm(dim=-1)
    assert float(relative.mean()) < 40
    assert float((joints[0][0] - joints[1][0]).norm()) < 0.05


def test_one_picture_does_not_change_the_next(tmp_path: Path) -> None:
    network = KeypointNetwork(colour_network(tmp_path / "network.onnx", "simcc"))
    frames, matte = (drawn(someone()), drawn(someone(), fade=0.2)), matte_of(someone())
    first = [found_by(network, frame, matte) for frame in frames]
    other = [found_by(network, frame, matte) for frame in frames[::-1]][::-1]
    for one, two in zip(first, other, strict=True):
        assert np.array_equal(one, two)


def test_a_wrong_file_is_refused_by_what_it_holds(tmp_path: Path) -> None:
    x, y = simcc_of(np.full((17, 2), 50.0))
    wrong = {
        r"gives \(1, 300, 6\) for an input of 256 x 192": constant_network(tmp_path / "a.onnx", np.zeros((1, 300, 6))),
        r"gives \(1, 21, 384\) and \(1, 21, 512\)": constant_network(
            tmp_path / "b.onnx", *simcc_of(np.full((21, 2), 50.0))
        ),
        r"gives \(1, 17, 384\) and \(1, 17, 500\)": constant_network(tmp_path / "c.onnx", x, y[..., :500]),
        r"gives \(1, 17, 48, 48\)": constant_network(tmp_path / "d.onnx", np.zeros((1, 17, 48, 48))),
        r"gives \(1, 17, 384\) and \(1, 17, 512\) and \(1, 17, 384\)": constant_network(tmp_path / "e.onnx", x, y, x),
        r"takes \(1, 3, any\)": save_network(tmp_path / "f.onnx", [_copy()], ["copy"], {}, (1, 3, "length")),
        r"takes \(1, 3, 100000, 100000\)": constant_network(tmp_path / "g.onnx", x, y, shape=(1, 3, 100000, 100000)),
        r"takes \(1, 4, 256, 192\)": constant_network(tmp_path / "h.onnx", x, y, shape=(1, 4, 256, 192)),
    }
    for says, path in wrong.items():
        with pytest.raises(InputError, match=says) as refused:
            make_initializer(InitConfig(method="keypoints", weights=path))
        assert "\n" not in str(refused.value)
    scripted = tmp_path / "scripted.pt"
    torch.jit.trace(nn.Identity(), torch.zeros(1, 3, 256, 192)).save(str(scripted))
    with pytest.raises(InputError, match="takes an ONNX file"):
        make_initializer(InitConfig(method="keypoints", weights=scripted))
    with pytest.raises(InputError, match="--init keypoints needs the network's file"):
        make_initializer(InitConfig(method="keypoints"))


def _copy() -> NodeProto:
    return helper.make_node("Identity", ["picture"], ["copy"])
