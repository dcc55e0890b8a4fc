"""Small networks as a user would export them, one linear map in both file formats."""

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class ShiftedCopies(nn.Module):
    """A "deblurrer": the picture moved left, not at all, and right by some pixels, as 3 N channels."""

    def __init__(self, pixels: int) -> None:
        super().__init__()
        self.pixels = pixels

    def forward(self, picture: Tensor) -> Tensor:
        left, right = torch.roll(picture, -self.pixels, 3), torch.roll(picture, self.pixels, 3)
        return torch.cat([left, picture, right], 1)


class TwoInTwoOut(nn.Module):
    """A video "deblurrer": two pictures as two arguments, a list of each frame's two copies."""

    def forward(self, first: Tensor, second: Tensor) -> list[Tensor]:
        return [first, first / 2, second, second / 2]


class Linear(nn.Module):
    """A "pose network": its 75 outputs are a linear map of the normalised crop; (camera, pose or joints)."""

    def __init__(self, weights: np.ndarray) -> None:
        super().__init__()
        self.register_buffer("weights", torch.from_numpy(weights))

    def forward(self, crop: Tensor) -> tuple[Tensor, Tensor]:
        numbers = crop.flatten(1) @ self.weights
        return numbers[:, :3], numbers[:, 3:].reshape(-1, 24, 3)


def moments(size_px: int) -> np.ndarray:
    """Weights (3 size^2, 75) that read the RED channel: camera scale = its mean, joint 1 = its mean position.

    In units of the crop, -1 to 1; x and y of joint 1 and of no other. They undo the red channel's ImageNet
    normalisation but for its mean, whose position is zero.
    """
    at = (np.arange(size_px) + 0.5) / size_px * 2 - 1
    y, x = np.meshgrid(at, at, indexing="ij")
    weights = np.zeros((3, size_px, size_px, 75), np.float32)
    weights[0, ..., 0] = DEVIATION[0] / size_px**2
    weights[0, ..., 3 + 3] = x * DEVIATION[0] / size_px**2
    weights[0, ..., 3 + 4] = y * DEVIATION[0] / size_px**2
    return weights.reshape(-1, 75)


def save_torchscript(module: nn.Module, path: Path) -> Path:
    torch.jit.script(module).save(str(path))
    return path


def save_linear_onnx(weights: np.ndarray, size_px: int, path: Path) -> Path:
    """`Linear` as an ONNX graph with named outputs."""
    constants = {"weights": weights, "shape": np.array([-1, 24, 3]), "cut": np.array([3, 72])}
    nodes = [
        helper.make_node("Flatten", ["crop"], ["flat"], axis=1),
        helper.make_node("MatMul", ["flat", "weights"], ["numbers"]),
        helper.make_node("Split", ["numbers", "cut"], ["camera", "rest"], axis=1),
        helper.make_node("Reshape", ["rest", "shape"], ["limbs"]),
    ]
    graph = helper.make_graph(
        nodes,
        "linear",
        [helper.make_tensor_value_info("crop", TensorProto.FLOAT, [1, 3, size_px, size_px])],
        [
            helper.make_tensor_value_info("camera", TensorProto.FLOAT, [1, 3]),
            helper.make_tensor_value_info("limbs", TensorProto.FLOAT, [1, 24, 3]),
        ],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(path))
    return path


def save_identity_onnx(path: Path) -> Path:
    """A deblurrer that returns its frame, of any size."""
    shape = [1, 3, "height", "width"]
    graph = helper.make_graph(
        [helper.make_node("Identity", ["blurred"], ["sharp"])],
        "identity",
        [helper.make_tensor_value_info("blurred", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("sharp", TensorProto.FLOAT, shape)],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), str(path))
    return path
