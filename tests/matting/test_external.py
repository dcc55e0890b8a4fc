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
from hfb.io.toml_file import to_record
from hfb.matting.matting_protocol import Matting
from hfb.matting.methods import make_matting
from hfb.matting.user_networks.bgmv2_network import MattingNetwork
from hfb.matting.user_networks.external import BackgroundMattingV2, RobustVideoMatting
from hfb.networks.network_files import check_network_file
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


def onnx_network(path: Path, refined: int | None = None) -> Path:
    """Alpha is the mean difference; a constant number of a quarter-size error map's pixels is chosen, as released."""
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
    constants = []
    if refined is not None:
        nodes += [
            helper.make_node("AveragePool", ["pha"], ["error"], kernel_shape=[4, 4], strides=[4, 4]),
            helper.make_node("Flatten", ["error"], ["flat"], axis=1),
            helper.make_node("TopK", ["flat", "k"], ["worst", "where"], axis=1, sorted=0),
        ]
        constants = [helper.make_tensor("k", TensorProto.INT64, [1], [refined // 16])]
        outputs.append(helper.make_tensor_value_info("worst", TensorProto.FLOAT, [1, refined // 16]))
    graph = helper.make_graph(nodes, "bgm", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(path))
    return path


def test_an_onnx_network(tmp_path: Path) -> None:
    frame, plate = scene(63, 97)
    found = BackgroundMattingV2(onnx_network(tmp_path / "bgm.onnx"))(frame, plate)
    np.testing.assert_allclose(found, np.abs(linear_to_srgb(frame) - linear_to_srgb(plate)).mean(-1), atol=1e-5)


@pytest.mark.parametrize(("refined", "factor"), [(80_000, 2), (320_000, 4)])
def test_a_small_picture_is_enlarged_for_a_fixed_number_of_refined_pixels(
    tmp_path: Path, refined: int, factor: int
) -> None:
    """The matte comes back at the picture's size; the next picture of that size does not try, and load, what failed."""
    file = onnx_network(tmp_path / "bgm.onnx", refined)
    matting = BackgroundMattingV2(file)
    frame, plate = scene(254, 255)
    found = matting(frame, plate)
    expected = np.abs(linear_to_srgb(frame) - linear_to_srgb(plate)).mean(-1)
    assert found.shape == (254, 255)
    assert np.abs(found - expected).mean() < 0.02
    assert matting._factors == {(256, 256): factor}
    file.rename(tmp_path / "kept.onnx")
    np.testing.assert_array_equal(matting(frame, plate), found)
    (tmp_path / "kept.onnx").rename(file)
    with pytest.raises(InputError, match="24 x 16 px has even at 8 times its size: give a larger picture, or"):
        matting(*scene(16, 24))


@pytest.mark.parametrize(
    "option",
    [
        {"backbone_scale": 0.5},
        {"refine_mode": "full"},
        {"refine_pixels": 80},
        {"refine_threshold": 0.1},
        {"half": True},
    ],
)
def test_an_onnx_file_has_its_own_options(option: dict[str, Any]) -> None:
    flag = f"--matting.{next(iter(option)).replace('_', '-')}: an ONNX file has its own"
    with pytest.raises(InputError, match=flag):
        to_record(MattingConfig, {"method": "bgmv2", "weights": "bgm.ONNX", **option}, "options")
    MattingConfig.model_validate({"method": "bgmv2", "weights": "bgm.pth", **option})
    MattingConfig(method="bgmv2", weights=Path("bgm.onnx"), tile_px=512)


def test_refined_pixels_grow_with_the_picture(tmp_path: Path) -> None:
    """80,000 at HD as the authors recommend, 320,000 at 4K; never more than there are, and a given number stays."""
    path = save_scripted(DifferenceMatting(), tmp_path / "bgm.pth")
    sizes = {(256, 256): 65536, (480, 640): 80_000, (1080, 1920): 80_000, (2160, 3840): 320_000}
    for size, wanted in sizes.items():
        for given in (None, 1600):
            matting = BackgroundMattingV2(path, refine_pixels=given)
            matting._network(*size)
            ((_, pixels),) = matting._networks
            assert pixels == (given or wanted)


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


def drawn_weights(backbone: str) -> MattingNetwork:
    """Weights by chance whose matte is neither empty nor full."""
    torch.manual_seed(0)
    network = MattingNetwork(backbone, refined=True).eval()
    for norm in network.modules():
        if isinstance(norm, torch.nn.BatchNorm2d):
            norm.running_mean.normal_(0, 0.2)  # type: ignore[union-attr]
            norm.running_var.uniform_(0.5, 1.5)  # type: ignore[union-attr]
    with torch.no_grad():
        network.decoder.conv4.bias.fill_(0.3)  # type: ignore[union-attr]
        network.refiner.conv4.bias.fill_(0.4)
    return network


@pytest.mark.parametrize("backbone", ["mobilenetv2", "resnet50"])
def test_plain_weights_run_in_our_own_network(tmp_path: Path, backbone: str) -> None:
    """Every way of refining agrees where every patch is refined, and the coarse matte is kept where none is."""
    state = drawn_weights(backbone).state_dict()
    torch.save({f"module.{name}": value for name, value in state.items()}, tmp_path / "w.pth")
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


@pytest.mark.parametrize("name", ["state_dict", "model_state_dict"])
def test_weights_within_a_checkpoint(tmp_path: Path, name: str) -> None:
    state = drawn_weights("mobilenetv2").state_dict()
    torch.save({"epoch": 3, "optimizer": {"lr": 1e-4}, name: state}, tmp_path / "checkpoint.pth")
    torch.save(state, tmp_path / "plain.pth")
    frame, plate = scene(64, 96)
    mattes = [BackgroundMattingV2(tmp_path / file)(frame, plate) for file in ("checkpoint.pth", "plain.pth")]
    np.testing.assert_array_equal(*mattes)


def test_half_precision_is_near_whole(tmp_path: Path) -> None:
    """bfloat16 keeps 8 bits: alpha of plain weights, of a script and of a recurrent one within 0.03."""
    frame, plate = scene(62, 94)
    torch.save(drawn_weights("mobilenetv2").state_dict(), tmp_path / "w.pth")
    save_scripted(DifferenceMatting(), tmp_path / "bgm.pth")
    save_scripted(RememberingMatting(), tmp_path / "rvm.pth")
    for method, file in (("bgmv2", "w.pth"), ("bgmv2", "bgm.pth"), ("rvm", "rvm.pth")):
        whole, half = (
            make_matting(MattingConfig.model_validate({"method": method, "weights": tmp_path / file, "half": half}))
            for half in (False, True)
        )
        expected = whole(frame, plate)
        found = half(frame, plate)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, atol=0.03)
    kinds = {value.dtype for value in half._network._module.buffers()}  # type: ignore[attr-defined]
    assert kinds <= {torch.bfloat16}
    weights = BackgroundMattingV2(tmp_path / "w.pth", half=True)
    found = weights(frame, plate)
    assert weights._weights is not None
    assert {value.dtype for value in weights._weights.parameters()} == {torch.bfloat16}
    np.testing.assert_array_equal(weights(frame, plate), found)


@pytest.mark.integration
def test_what_is_no_network_is_told_by_the_file_alone(tmp_path: Path) -> None:
    """Before torch is loaded: options are checked within half a second."""
    for name in ("text.pth", "text.onnx"):
        (tmp_path / name).write_text("hello")
        with pytest.raises(InputError, match=r"or no network|is no ONNX network"):
            check_network_file(tmp_path / name, weights_too=True)
    with pytest.raises(InputError, match="no such file"):
        check_network_file(tmp_path / "missing.pth")
    torch.save({}, tmp_path / "weights.pth")
    check_network_file(tmp_path / "weights.pth", weights_too=True)
    with pytest.raises(InputError, match="no network that runs by itself"):
        check_network_file(tmp_path / "weights.pth")
    check_network_file(save_scripted(DifferenceMatting(), tmp_path / "bgm.pth"))
    check_network_file(onnx_network(tmp_path / "bgm.onnx"))
    program = "import sys, hfb.networks.network_files; print('torch' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said == "False\n"


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
from hfb.networks.runtimes import load_network
try:
    torch.jit.load({path!r})
    print("opens anyway")
except RuntimeError as error:
    assert "roi_align" in str(error), error
given = load_network(Path({path!r}))([np.ones((1, 3, 8, 8), np.float32), np.zeros((1, 3, 8, 8), np.float32)])
print("alpha", given.arrays[0].mean())
"""


@pytest.mark.integration
def test_a_script_that_names_an_operator_of_torchvision(tmp_path: Path) -> None:
    """As BackgroundMattingV2's does; torch alone refuses to open it."""
    path = str(tmp_path / "names.pth")
    (tmp_path / "make.py").write_text(_DECLARED.replace("{path!r}", repr(path)))
    (tmp_path / "open.py").write_text(_OPENED.replace("{path!r}", repr(path)))
    said = ""
    for program in ("make.py", "open.py"):
        done = subprocess.run(
            [sys.executable, str(tmp_path / program)],
            capture_output=True,
            text=True,
            check=False,
            env={"PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1", "PATH": ""},
        )
        assert done.returncode == 0, done.stderr
        said = done.stdout
    assert said.split() == ["alpha", "1.0"]
