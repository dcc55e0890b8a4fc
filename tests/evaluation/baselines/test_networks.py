"""Users' networks: the same answers in both formats, refusals in one sentence."""

import pickle
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from hfb.errors import InputError
from hfb.networks.runtimes import denormalised, load_network, normalised
from tests.evaluation.baselines.networks import Linear, ShiftedCopies, save_linear_onnx, save_torchscript

_SIZE = 16


@pytest.fixture
def weights() -> np.ndarray:
    return np.random.default_rng(0).normal(0, 0.1, (3 * _SIZE * _SIZE, 75)).astype(np.float32)


def test_both_formats_give_the_same(tmp_path: Path, weights: np.ndarray) -> None:
    crop = np.random.default_rng(1).random((1, 3, _SIZE, _SIZE), np.float32)
    script = load_network(save_torchscript(Linear(weights), tmp_path / "net.pt"))([crop])
    onnx = load_network(save_linear_onnx(weights, _SIZE, tmp_path / "net.onnx"))([crop])
    expected = crop.reshape(-1) @ weights
    assert np.allclose(script.get(0)[0], expected[:3], atol=1e-4)
    assert np.allclose(script.get(1).reshape(-1), expected[3:], atol=1e-4)
    assert np.allclose(onnx.get("camera"), script.get(0), atol=1e-4)
    assert np.array_equal(onnx.get("limbs"), onnx.get(1))
    assert np.allclose(onnx.get("limbs"), script.get(1), atol=1e-4)


def test_outputs_that_are_not_there(tmp_path: Path, weights: np.ndarray) -> None:
    outputs = load_network(save_linear_onnx(weights, _SIZE, tmp_path / "net.onnx"))([np.zeros((1, 3, 16, 16), "f")])
    with pytest.raises(InputError, match=r"no output 'joints'; it has 0 camera \(1, 3\), 1 limbs"):
        outputs.get("joints")
    with pytest.raises(InputError, match="no output 2"):
        outputs.get(2)


class Named(nn.Module):
    def forward(self, picture: Tensor) -> dict[str, Tensor]:
        return {"mean": picture.mean(), "most": picture.amax()}


def test_outputs_by_name_from_torchscript(tmp_path: Path) -> None:
    outputs = load_network(save_torchscript(Named(), tmp_path / "net.pt"))([np.full((1, 3, 4, 4), 0.25, np.float32)])
    assert float(outputs.get("most")) == 0.25
    assert outputs.names == ("mean", "most")


class Attack:
    def __reduce__(self) -> tuple[Callable, tuple]:
        return exec, ("import pathlib; pathlib.Path('attacked').touch()",)


@pytest.mark.parametrize("kind", ["pickle", "module", "weights", "text", "empty"])
def test_no_pickle_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "net.pt"
    if kind == "pickle":
        path.write_bytes(pickle.dumps(Attack()))
    elif kind == "module":
        torch.save({"model": Attack()}, path)
    elif kind == "weights":
        torch.save(Linear(np.zeros((12, 75), np.float32)).state_dict(), path)
    else:
        path.write_text("no network" if kind == "text" else "")
    with pytest.raises(InputError, match=r"torch\.jit\.trace"):
        load_network(path)
    assert not (tmp_path / "attacked").exists()


def test_damaged_and_missing_networks(tmp_path: Path, weights: np.ndarray) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_network(tmp_path / "net.pt")
    (tmp_path / "net.onnx").write_bytes(b"not onnx")
    with pytest.raises(InputError, match="onnxruntime cannot read"):
        load_network(tmp_path / "net.onnx")
    whole = save_torchscript(Linear(weights), tmp_path / "net.pt").read_bytes()
    (tmp_path / "cut.pt").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.pt"):
        load_network(tmp_path / "cut.pt")


def test_onnx_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, weights: np.ndarray) -> None:
    path = save_linear_onnx(weights, _SIZE, tmp_path / "net.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"pip install '\.\[onnx\]'"):
        load_network(path)


def test_a_network_that_fails_says_which_and_on_what(tmp_path: Path, weights: np.ndarray) -> None:
    for path in (
        save_torchscript(Linear(weights), tmp_path / "net.pt"),
        save_linear_onnx(weights, _SIZE, tmp_path / "net.onnx"),
    ):
        with pytest.raises(InputError, match=rf"{path.name} failed on inputs of \(1, 3, 8, 8\)"):
            load_network(path)([np.zeros((1, 3, 8, 8), np.float32)])


def test_numbers_that_are_none(tmp_path: Path) -> None:
    network = load_network(save_torchscript(ShiftedCopies(1), tmp_path / "net.pt"))
    with pytest.raises(FloatingPointError, match=r"net\.pt"):
        network([np.full((1, 3, 4, 4), np.nan, np.float32)])


@pytest.mark.parametrize("normalisation", ["unit", "signed", "imagenet"])
@pytest.mark.parametrize("channels", ["rgb", "bgr"])
def test_normalisation_there_and_back(normalisation: str, channels: str) -> None:
    picture = np.random.default_rng(0).random((5, 7, 3), np.float32)
    planes = normalised(picture, normalisation, channels)
    assert np.allclose(denormalised(planes, normalisation, channels)[0], picture, atol=1e-6)
    red = planes[0, 2 if channels == "bgr" else 0]
    expected = {"unit": picture, "signed": 2 * picture - 1, "imagenet": (picture - 0.485) / 0.229}[normalisation]
    assert np.allclose(red, expected[..., 0], atol=1e-6)
