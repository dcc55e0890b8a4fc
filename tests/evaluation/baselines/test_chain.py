"""Deblur-then-estimate chains on small exported networks, folders of pictures and folders of poses."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.errors import InputError
from hfb.evaluation.baselines.build import make_method
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.evaluation.metrics import soft_iou
from hfb.evaluation.prediction import Prediction
from hfb.geometry.camera import PinholeCamera
from hfb.io.media.images.image_io import write_png
from hfb.photometry import srgb_to_linear
from hfb.rendering.observation import Observation
from tests.evaluation.baselines.cases import bare_case
from tests.evaluation.baselines.networks import (
    DEVIATION,
    MEAN,
    Linear,
    ShiftedCopies,
    TwoInTwoOut,
    moments,
    save_identity_onnx,
    save_linear_onnx,
    save_torchscript,
)
from tests.scenes import moving_scene

_NET_PX = 32
_BOX = slice(8, 40), slice(20, 52)  # rows and columns of the "person", 32 px square
_RED = 0.6


def red_square(frames: int = 1) -> Observation:
    """A square of red 0.6 (sRGB) on black, with its exact matte; the 64 x 80 picture's crop at margin 2 is 64 px."""
    picture = torch.zeros(64, 80, 3)
    picture[(*_BOX, 0)] = float(srgb_to_linear(torch.tensor([_RED])))
    matte = torch.zeros(64, 80)
    matte[_BOX] = 1
    pictures, mattes = picture.expand(frames, 64, 80, 3), matte.expand(frames, 64, 80)
    camera = PinholeCamera.from_focal(90, 64, 80)
    return Observation(pictures.clone(), torch.zeros(64, 80, 3), mattes.clone(), camera, 0.02, 0.04)


def run(folder: Path, chain: dict[str, Any], seen: Observation) -> Prediction:
    """The chain's answer to case 1."""
    lines = ["[chain]", *(f"{key} = {toml(value)}" for key, value in chain.items())]
    (folder / "chains.toml").write_text("\n".join(lines))
    body, frames = load_default_body(), len(seen.mattes)
    starts = moving_scene(body, 16, frames=frames, instants=3).middle
    method = make_method(method_spec("chain", folder / "chains.toml"), body)
    return method(bare_case(folder, frames), seen, starts)


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + "}"
    return json.dumps(value)


def square_moments(prediction: Prediction) -> np.ndarray:
    """Return x and y of joint 1 at every row: the red square's position times its share of red light."""
    assert prediction.motion is None
    assert prediction.joints is not None
    return prediction.joints[:, 1, :2]


_LAYOUT = {"size_px": _NET_PX, "margin": 2.0, "joints": 1, "camera": 0}


@pytest.mark.parametrize("network", ["net.pt", "net.onnx"])
def test_the_estimator_sees_the_person_in_the_middle_of_its_crop(tmp_path: Path, network: str) -> None:
    """The network reads position and amount of red: a wrong crop, channel or normalisation would show."""
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    save_linear_onnx(moments(_NET_PX), _NET_PX, tmp_path / "net.onnx")
    layout = _LAYOUT | ({"joints": "limbs", "camera": "camera"} if network.endswith("onnx") else {})
    # The mean of normalised red must be positive for the camera to be one: add the mean that normalisation took off.
    layout |= {"normalisation": "unit"}
    prediction = run(tmp_path, {"estimator": network, "estimator_layout": layout}, red_square())
    assert prediction.joints is not None
    assert prediction.joints.shape == (8, 24, 3)
    assert np.abs(square_moments(prediction)).max() < 1e-4
    moved = red_square()
    moved = replace(moved, mattes=torch.roll(moved.mattes, 8, 2))  # the crop 8 px to the right of the square
    x, y = square_moments(run(tmp_path, {"estimator": network, "estimator_layout": layout}, moved))[0]
    assert x == pytest.approx(-8 / 32 * _RED * DEVIATION[0] / 4, rel=1e-3)
    assert y == pytest.approx(0, abs=1e-6)


def test_normalisation_and_channels_reach_the_network(tmp_path: Path) -> None:
    """With blue and red exchanged, or another normalisation, the very numbers change as they must."""
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    shifted = red_square()
    shifted = replace(shifted, mattes=torch.roll(shifted.mattes, 8, 2))

    def x_of(**layout: object) -> float:
        whole = {key: value for key, value in _LAYOUT.items() if key != "camera"} | layout
        prediction = run(tmp_path, {"estimator": "net.pt", "estimator_layout": whole}, shifted)
        return float(square_moments(prediction)[0, 0])

    unit = x_of(normalisation="unit")
    assert x_of(normalisation="signed") == pytest.approx(2 * unit, rel=1e-3)
    assert x_of(normalisation="imagenet") == pytest.approx(unit / DEVIATION[0], rel=1e-3)
    assert x_of(normalisation="unit", channels="bgr") == pytest.approx(0, abs=1e-6)  # the square has no blue
    assert x_of(normalisation="unit", margin=4.0) == pytest.approx(unit / 8, rel=1e-2)  # a quarter of it, half as far
    assert len(MEAN) == 3


def test_deblurred_sub_frames_are_estimated_in_time(tmp_path: Path) -> None:
    """The "deblurrer" moves the square from 4 px left to 4 px right; the estimates follow, and so do the rows."""
    save_torchscript(ShiftedCopies(4), tmp_path / "deblur.pt")
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    layout = {"size_px": _NET_PX, "margin": 2.0, "joints": 1, "normalisation": "unit"}
    chain = {"deblurrer": "deblur.pt", "estimator": "net.pt", "estimator_layout": layout}
    x = square_moments(run(tmp_path, chain, red_square()))[:, 0]
    full = 4 / 32 * _RED * DEVIATION[0] / 4
    assert x == pytest.approx(np.linspace(-full, full, 8), abs=1e-5)
    # Told that its sub-frames lie in the exposure's first half only, the last is held through the rest.
    chain["deblurrer_layout"] = {"times": [0.0, 0.25, 0.5]}
    x = square_moments(run(tmp_path, chain, red_square()))[:, 0]
    assert x == pytest.approx(np.clip(np.linspace(-full, 3 * full, 8), -full, full), abs=1e-5)


def test_a_deblurrer_of_several_frames(tmp_path: Path) -> None:
    save_torchscript(TwoInTwoOut(), tmp_path / "deblur.pt")
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    seen = red_square(2)
    seen = replace(seen, mattes=torch.roll(seen.mattes, 8, 2))
    layout = {"size_px": _NET_PX, "margin": 2.0, "joints": 1, "normalisation": "unit"}
    chain = {
        "deblurrer": "deblur.pt",
        "deblurrer_layout": {"frames": "list", "normalisation": "unit"},
        "estimator": "net.pt",
        "estimator_layout": layout,
    }
    x = square_moments(run(tmp_path, chain, seen))[:, 0]
    full = -8 / 32 * _RED * DEVIATION[0] / 4
    assert x == pytest.approx(np.tile(np.linspace(full, full / 2, 8), 2), abs=1e-5)
    chain["deblurrer_layout"] = {"frames": "stacked"}
    with pytest.raises(InputError, match=r"deblur\.pt failed on inputs of \(1, 6, 64, 80\)"):
        run(tmp_path, chain, seen)


def test_one_estimate_per_frame_is_interpolated_between_the_frames(tmp_path: Path) -> None:
    save_identity_onnx(tmp_path / "deblur.onnx")
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    seen = red_square(2)
    seen.frames_linear[1] = torch.roll(seen.frames_linear[1], 4, 1)
    layout = {"size_px": _NET_PX, "margin": 2.0, "joints": 1, "normalisation": "unit"}
    chain = {"deblurrer": "deblur.onnx", "estimator": "net.pt", "estimator_layout": layout}
    x = square_moments(run(tmp_path, chain, seen))[:, 0] / (4 / 32 * _RED * DEVIATION[0] / 4)
    assert x[:4] == pytest.approx(0, abs=1e-4)  # held before the first middle
    assert x[7] == pytest.approx(0.25, abs=1e-3)  # 10 of 40 ms after it
    assert x[8] == pytest.approx(0.75, abs=1e-3)
    assert x[12:] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("kind", ["axis-angle", "matrices", "6D"])
def test_poses_of_a_network(tmp_path: Path, kind: str) -> None:
    """A network whose bias says it all: its pose arrives, its camera places the body where the crop was."""
    from hfb.geometry.rotations import axis_angle_to_matrix

    pose = torch.randn(24, 3, generator=torch.Generator().manual_seed(0)) * 0.4
    matrices = axis_angle_to_matrix(pose)
    numbers = {"axis-angle": pose, "matrices": matrices, "6D": matrices[..., :2].transpose(1, 2)}[kind].flatten()

    class Constant(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.register_buffer("camera", torch.tensor([[0.8, 0.0, 0.2]]))
            self.register_buffer("limbs", numbers[None])

        def forward(self, crop: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            return self.camera, self.limbs + 0 * crop.mean()

    example = torch.zeros(1, 3, _NET_PX, _NET_PX)
    torch.jit.trace(Constant(), example).save(str(tmp_path / "net.pt"))
    layout = {"size_px": _NET_PX, "margin": 2.0, "pose": 1, "camera": 0}
    motion = run(tmp_path, {"estimator": "net.pt", "estimator_layout": layout}, red_square()).motion
    assert motion is not None
    assert np.allclose(motion.poses, pose.flatten().numpy(), atol=1e-4)
    # The crop's centre is the box's, (36, 24); y is 0.2 of scale 0.8 of half the crop's 64 px further down.
    seen_at = red_square().camera.project(torch.from_numpy(motion.trans).float())[0]
    assert seen_at.tolist() == pytest.approx([36, 24 + 0.8 * 0.2 * 32], abs=1e-3)


def test_a_folder_of_sub_frames(tmp_path: Path) -> None:
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    folder = tmp_path / "jin" / "case_0001" / "frame_0"
    folder.mkdir(parents=True)
    for index, shift in enumerate((-4, 0, 4)):
        picture = np.zeros((64, 80, 3), np.float32)
        picture[(*_BOX, 0)] = _RED
        write_png(folder / f"{index:02d}.png", np.roll(picture, shift, 1))
    layout = {"size_px": _NET_PX, "margin": 2.0, "joints": 1, "normalisation": "unit"}
    chain = {"pictures": "jin", "estimator": "net.pt", "estimator_layout": layout}
    x = square_moments(run(tmp_path, chain, red_square()))[:, 0]
    full = 4 / 32 * _RED * DEVIATION[0] / 4
    assert x == pytest.approx(np.linspace(-full, full, 8), abs=1e-5)
    write_png(folder / "03.png", np.zeros((32, 32, 3), np.float32))
    with pytest.raises(InputError, match="32 x 32 px, the frame has 80 x 64 px"):
        run(tmp_path, chain, red_square())


def test_a_video_of_sub_frames(tmp_path: Path) -> None:
    save_torchscript(Linear(moments(_NET_PX)), tmp_path / "net.pt")
    folder = tmp_path / "afb" / "case_0001"
    folder.mkdir(parents=True)
    with av.open(str(folder / "frame_0.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 80, 64, "yuv444p"
        stream.options = {"crf": "1"}
        for shift in (-4, 0, 4):
            picture = np.zeros((64, 80, 3), np.uint8)
            picture[(*_BOX, 0)] = round(255 * _RED)
            frame = av.VideoFrame.from_ndarray(np.roll(picture, shift, 1), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    layout = {"size_px": _NET_PX, "margin": 2.0, "joints": 1, "normalisation": "unit"}
    chain = {"pictures": "afb", "estimator": "net.pt", "estimator_layout": layout}
    x = square_moments(run(tmp_path, chain, red_square()))[:, 0]
    full = 4 / 32 * _RED * DEVIATION[0] / 4
    assert x == pytest.approx(np.linspace(-full, full, 8), abs=0.1 * full)


def test_sub_frames_that_are_not_there(tmp_path: Path) -> None:
    (tmp_path / "jin").mkdir()
    with pytest.raises(InputError, match=r"no sub-frames at .*case_0001.*frame_0"):
        run(tmp_path, {"pictures": "jin", "estimator": "matte"}, red_square())


def test_a_folder_of_poses(tmp_path: Path) -> None:
    (tmp_path / "hybrik").mkdir()
    poses = np.zeros((4, 72))
    poses[:, 0] = np.pi
    poses[:, 55] = [0.0, 0.3, 0.5, 0.7]
    np.savez(tmp_path / "hybrik" / "case_0001.npz", poses=poses)
    motion = run(tmp_path, {"poses": "hybrik"}, red_square(2)).motion
    assert motion is not None
    assert motion.poses[[0, 7, 8, 15], 55] == pytest.approx([0.0, 0.3, 0.5, 0.7], abs=1e-6)
    assert np.isfinite(motion.joints).all()


def test_our_own_estimator_sees_the_deblurred_pictures_own_matte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The blurred frame's matte would show where the person was at other times."""
    body = load_default_body()
    scene = moving_scene(body, 96)
    plate = 0.2 + 0.02 * torch.rand(96, 96, 3, generator=torch.Generator().manual_seed(0))
    seen = replace(scene.observation, plate_linear=plate)
    folder = tmp_path / "sharp" / "case_0001" / "frame_0"
    folder.mkdir(parents=True)
    rows = (0, 14)
    for number, row in enumerate(rows):
        sharp = plate.clone()
        sharp[torch.from_numpy(scene.truth.silhouettes[row])] = torch.tensor([0.8, 0.1, 0.1])
        write_png(folder / f"{number:02d}.png", seen.to_srgb(sharp).numpy())
    mattes = []

    def initializer(frame_linear, plate_linear, matte, camera, model):  # type: ignore[no-untyped-def]
        assert abs(float(frame_linear.max()) - 0.8) < 0.01  # linear light, whatever the file holds
        mattes.append(np.asarray(matte))
        return scene.middle[0]

    monkeypatch.setattr("hfb.evaluation.baselines.chain.make_initializer", lambda config: initializer)
    run(tmp_path, {"pictures": "sharp", "estimator": "matte"}, seen)
    for matte, row in zip(mattes, rows, strict=True):
        own, other = (scene.truth.silhouettes[one].astype(np.float32) for one in (row, 14 - row))
        assert soft_iou(matte, own) > 0.75  # at 96 px an edge is a large share
        assert soft_iou(matte, own) > soft_iou(matte, other) + 0.1
    mattes.clear()
    red = seen.plate_linear.clone()
    red[40:50, 40:50] = torch.tensor([0.8, 0.1, 0.1])
    run(tmp_path, {"estimator": "matte"}, replace(seen, frames_linear=red[None]))  # nothing deblurred: the given matte
    assert np.array_equal(mattes[0], seen.mattes[0].numpy())
