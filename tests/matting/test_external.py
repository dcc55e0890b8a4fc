"""A user's matting networks: the same alpha as the network itself gives, whatever the frame's size."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hfb.config import MattingConfig
from hfb.errors import InputError
from hfb.matting.bgmv2_network import MattingNetwork
from hfb.matting.external import BackgroundMattingV2, RobustVideoMatting
from hfb.matting.matting import Matting, make_matting
from hfb.photometry import linear_to_srgb
from tests.matting.networks import DifferenceMatting, RememberingMatting, save_scripted


def scene(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """A bright box before a darker plate; linear light."""
    random = np.random.default_rng(0)
    plate = (0.05 + 0.1 * random.random((height, width, 3))).astype(np.float32)
    frame = plate.copy()
    frame[height // 4 : height // 2, width // 3 : width // 2] = 0.8
    return frame, plate


@pytest.mark.parametrize("size", [(64, 96), (63, 97), (241, 322)])
def test_the_networks_own_alpha(tmp_path: Path, size: tuple[int, int]) -> None:
    """Padding to fours and small frames, on which the released number of refined pixels would fail, change nothing."""
    network = DifferenceMatting()
    path = save_scripted(network, tmp_path / "bgm.pth")
    matting = make_matting(MattingConfig(method="bgmv2", weights=path))
    assert isinstance(matting, Matting)
    frame, plate = scene(*size)
    found = matting(frame, plate)
    assert found.shape == size
    expected = np.clip(4 * np.abs(linear_to_srgb(frame) - linear_to_srgb(plate)).max(-1), 0, 1)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    tensors = matting(torch.from_numpy(frame), torch.from_numpy(plate))
    np.testing.assert_array_equal(tensors, found)


@pytest.mark.parametrize("size", [(300, 700), (512, 257)])
def test_tiles_of_a_large_frame_fade_into_each_other(tmp_path: Path, size: tuple[int, int]) -> None:
    """The network looks at one pixel at a time: in tiles it must say the same, and never see more than a tile."""

    class Measuring(DifferenceMatting):
        def forward(self, src: Tensor, bgr: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
            full = ((src - bgr).abs().amax(1, keepdim=True) * self.gain).clamp(0.0, 1.0)
            if src.size(2) > 256 or src.size(3) > 256:
                full = full * 0 + 0.5
            return full, src, full, full, full, full

    path = save_scripted(Measuring(), tmp_path / "bgm.pth")
    frame, plate = scene(*size)
    found = make_matting(MattingConfig(method="bgmv2", weights=path, tile_px=256))(frame, plate)
    expected = np.clip(4 * np.abs(linear_to_srgb(frame) - linear_to_srgb(plate)).max(-1), 0, 1)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    whole = make_matting(MattingConfig(method="bgmv2", weights=path))(frame, plate)
    assert (whole == 0.5).all()


def test_options_reach_the_network(tmp_path: Path) -> None:
    path = save_scripted(DifferenceMatting(), tmp_path / "bgm.pth")
    matting = BackgroundMattingV2(path, backbone_scale=0.5, refine_mode="full", refine_pixels=160)
    matting(*scene(64, 64))
    ((settings, network),) = matting._networks.items()
    assert settings == (0.5, 160)
    assert network._module.backbone_scale == 0.5  # type: ignore[attr-defined]
    assert network._module.refine_mode == "full"  # type: ignore[attr-defined]
    small = BackgroundMattingV2(path)
    small(*scene(64, 64))
    assert list(small._networks) == [(0.5, 64 * 64)]


def test_half_precision_files_and_onnx(tmp_path: Path) -> None:
    """Released files come in 16 bits too; processors compute in 32."""
    frame, plate = scene(64, 96)
    whole = BackgroundMattingV2(save_scripted(DifferenceMatting(), tmp_path / "a.pth"))(frame, plate)
    half = BackgroundMattingV2(save_scripted(DifferenceMatting().half(), tmp_path / "b.pth"))(frame, plate)
    np.testing.assert_allclose(half, whole, atol=1e-5)


def test_an_onnx_network(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from onnx import TensorProto, helper

    shape = [1, 3, "height", "width"]
    nodes = [
        helper.make_node("Sub", ["src", "bgr"], ["difference"]),
        helper.make_node("Abs", ["difference"], ["size"]),
        helper.make_node("ReduceMean", ["size"], ["pha"], axes=[1], keepdims=1),
        helper.make_node("Identity", ["src"], ["fgr"]),
    ]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("src", "bgr")]
    outputs = [
        helper.make_tensor_value_info("fgr", TensorProto.FLOAT, shape),
        helper.make_tensor_value_info("pha", TensorProto.FLOAT, [1, 1, "height", "width"]),
    ]
    graph = helper.make_graph(nodes, "bgm", inputs, outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(tmp_path / "bgm.onnx"))
    frame, plate = scene(63, 97)
    found = BackgroundMattingV2(tmp_path / "bgm.onnx")(frame, plate)
    np.testing.assert_allclose(found, np.abs(linear_to_srgb(frame) - linear_to_srgb(plate)).mean(-1), atol=1e-5)


def test_a_network_with_a_memory_looks_four_times(tmp_path: Path) -> None:
    path = save_scripted(RememberingMatting(), tmp_path / "rvm.torchscript")
    frame, plate = scene(40, 60)
    for _ in range(2):  # the first frame leaves nothing for the second
        found = make_matting(MattingConfig(method="rvm", weights=path))(frame, plate)
        assert found.max() == pytest.approx(1 - 0.5**4)
        assert found[0].max() == 0
    with pytest.raises(InputError, match="failed on inputs"):
        RobustVideoMatting(save_scripted(DifferenceMatting(), tmp_path / "bgm.pth"))(frame, plate)


def test_what_cannot_be_used_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--matting-weights FILE"):
        make_matting(MattingConfig(method="bgmv2"))
    with pytest.raises(InputError, match="no such file"):
        make_matting(MattingConfig(method="bgmv2", weights=tmp_path / "missing.pth"))
    torch.save(DifferenceMatting().state_dict(), tmp_path / "weights.pth")
    with pytest.raises(InputError, match="weights of another network"):
        make_matting(MattingConfig(method="bgmv2", weights=tmp_path / "weights.pth"))
    with pytest.raises(InputError, match="holds weights or a pickled model"):
        make_matting(MattingConfig(method="rvm", weights=tmp_path / "weights.pth"))
    path = save_scripted(DifferenceMatting(), tmp_path / "bgm.pth")
    frame, plate = scene(64, 64)
    with pytest.raises(InputError, match="give a plate from the same camera"):
        make_matting(MattingConfig(method="bgmv2", weights=path))(frame, plate[:32])
    with pytest.raises(InputError, match="no person was found"):
        make_matting(MattingConfig(method="bgmv2", weights=path))(plate, plate)


class Attack:
    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.target}",)


def test_weights_that_are_a_programme_do_not_run(tmp_path: Path) -> None:
    for zipped in (True, False):
        torch.save({"a": Attack(tmp_path / "attacked")}, tmp_path / "w.pth", _use_new_zipfile_serialization=zipped)
        with pytest.raises(InputError, match="holds more than weights"):
            BackgroundMattingV2(tmp_path / "w.pth")
    assert not (tmp_path / "attacked").exists()


@pytest.mark.parametrize("backbone", ["mobilenetv2", "resnet50"])
def test_plain_weights_run_in_our_own_network(tmp_path: Path, backbone: str) -> None:
    """Every way of refining agrees where every patch is refined, and the coarse matte is kept where none is."""
    torch.manual_seed(0)
    network = MattingNetwork(backbone, refined=True).eval()
    for norm in network.modules():
        if isinstance(norm, torch.nn.BatchNorm2d):
            norm.running_mean.normal_(0, 0.2)  # type: ignore[union-attr]
            norm.running_var.uniform_(0.5, 1.5)  # type: ignore[union-attr]
    with torch.no_grad():
        network.decoder.conv4.bias.fill_(0.3)  # type: ignore[union-attr]
        network.refiner.conv4.bias.fill_(0.4)
    torch.save({f"module.{name}": value for name, value in network.state_dict().items()}, tmp_path / "w.pth")
    frame, plate = scene(62, 94)
    mattes = {
        mode: BackgroundMattingV2(tmp_path / "w.pth", 0.5, mode, pixels, threshold)(frame, plate)
        for mode, pixels, threshold in (("sampling", 64 * 96, None), ("thresholding", None, 0.0))
    }
    np.testing.assert_allclose(mattes["sampling"], mattes["thresholding"], atol=1e-6)
    assert mattes["sampling"].std() > 1e-4
    coarse = BackgroundMattingV2(tmp_path / "w.pth", 0.5, "thresholding", None, 1.0)(frame, plate)
    assert np.abs(coarse - mattes["sampling"]).max() > 1e-3
    whole = BackgroundMattingV2(tmp_path / "w.pth", 0.5, "full")(frame, plate)
    assert whole.shape == (62, 94)


_DECLARED = """
import torch
from torch import Tensor, nn
library = torch.library.Library("torchvision", "FRAGMENT")
library.define("roi_align(Tensor input, Tensor rois, float spatial_scale, int pooled_height, int pooled_width, "
               "int sampling_ratio, bool aligned) -> Tensor")
class Names(nn.Module):
    def __init__(self):
        super().__init__()
        self.method = "unfold"
    def forward(self, src: Tensor, bgr: Tensor) -> Tensor:
        if self.method == "roi_align":
            return torch.ops.torchvision.roi_align(src, bgr, 1.0, 2, 2, 1, False)
        return (src - bgr).abs().amax(1, keepdim=True)
source = __import__("linecache")
torch.jit.script(Names()).save({path!r})
"""
_OPENED = """
import torch
from pathlib import Path
import numpy as np
from hfb.networks import load_network
try:
    torch.jit.load({path!r})
    print("opens anyway")
except RuntimeError as error:
    assert "roi_align" in str(error), error
given = load_network(Path({path!r}))([np.ones((1, 3, 8, 8), np.float32), np.zeros((1, 3, 8, 8), np.float32)])
print("alpha", given.arrays[0].mean())
"""


def test_a_script_that_names_an_operator_of_torchvision(tmp_path: Path) -> None:
    """As BackgroundMattingV2's does; torch alone refuses to open it."""
    path = str(tmp_path / "names.pth")
    (tmp_path / "make.py").write_text(_DECLARED.replace("{path!r}", repr(path)))
    (tmp_path / "open.py").write_text(_OPENED.replace("{path!r}", repr(path)))
    said = ""
    for program in ("make.py", "open.py"):
        done = subprocess.run(
            [sys.executable, str(tmp_path / program)], capture_output=True, text=True, check=False,
            env={"PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1", "PATH": ""},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said = done.stdout
    assert said.split() == ["alpha", "1.0"]
