"""Small ONNX networks with the interfaces of RTMPose, RTMW and ViTPose."""

import colorsys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from hfb.initialization.joint_layouts import COCO_17

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_NEAR, _DISC_PX = 0.15, 2.0
Side = int | str


def save_network(
    path: Path,
    nodes: Sequence[onnx.NodeProto],
    outputs: Sequence[str],
    constants: dict[str, np.ndarray],
    shape: Sequence[Side] = (1, 3, 256, 192),
) -> Path:
    """A network from ``picture`` to some outputs, whose shapes the file leaves open."""
    graph = helper.make_graph(
        list(nodes),
        "keypoints",
        [helper.make_tensor_value_info("picture", TensorProto.FLOAT, list(shape))],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), str(path))
    return path


def constant_network(path: Path, *given: np.ndarray, shape: Sequence[Side] = (1, 3, 256, 192)) -> Path:
    """Says the same of every picture."""
    names = [f"output_{number}" for number in range(len(given))]
    nodes = [
        helper.make_node("ReduceMean", ["picture"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        *(helper.make_node("Add", [f"given_{name}", "nothing"], [name]) for name in names),
    ]
    constants = {f"given_{name}": one.astype(np.float32) for name, one in zip(names, given, strict=True)}
    return save_network(path, nodes, names, {"zero": np.zeros((), np.float32), **constants}, shape)


def simcc_of(points: np.ndarray, height: int = 256, width: int = 192, bins: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """SimCC outputs with their largest values at x, y (K, 2) [px of the input]."""
    along = (
        np.exp(-((np.arange(side * bins) / bins - at[:, None]) ** 2) / 8)
        for side, at in ((width, points[:, 0]), (height, points[:, 1]))
    )
    x, y = along
    return x[None], y[None]


def heatmaps_of(points: np.ndarray, height: int = 64, width: int = 48) -> np.ndarray:
    """Gaussians of 2 px about x, y (K, 2) [px of the heatmap]."""
    rows, columns = np.mgrid[:height, :width]
    away = (columns - points[:, 0, None, None]) ** 2 + (rows - points[:, 1, None, None]) ** 2
    return np.exp(-away / 8)[None]


def colours(count: int = 17) -> np.ndarray:
    """A colour per keypoint, sRGB (count, 3); those of the face are shown by nobody."""
    return np.array([colorsys.hsv_to_rgb(at / count, 1.0, 1.0) for at in range(count)], np.float32)


def paint(picture_srgb: np.ndarray, named: dict[str, np.ndarray], radius_px: float, fade: float = 0.0) -> np.ndarray:
    """Discs of the keypoints' colours at x, y [px]; `fade` takes that share of their colour away."""
    painted = np.ascontiguousarray(picture_srgb, np.float32).copy()
    for name, (x, y) in named.items():
        colour = colours()[COCO_17.index(name)] * (1 - fade) + 0.5 * fade
        centre = round((x - 0.5) * 256), round((y - 0.5) * 256)
        cv2.circle(painted, centre, round(radius_px * 256), colour.tolist(), -1, cv2.LINE_AA, 8)
    return painted


def colour_network(path: Path, kind: str, height: int = 256, width: int = 192, layout: int = 17) -> Path:
    """Finds discs of the keypoints' colours: how near each pixel's colour is, averaged over a disc.

    Keypoints behind COCO's 17 repeat the first. `kind` is simcc or heatmaps.
    """
    wanted = colours()[np.arange(layout) % 17]
    reach = np.arange(-6, 7)
    bell = np.exp(-(reach[:, None] ** 2 + reach**2) / (2 * _DISC_PX**2))
    constants = {
        "deviation": np.array(DEVIATION, np.float32)[:, None, None],
        "mean": np.array(MEAN, np.float32)[:, None, None],
        "minus_two": (-2 * wanted)[:, :, None, None].astype(np.float32),
        "square": (wanted**2).sum(1).astype(np.float32),
        "sharp": np.array(-1 / _NEAR**2, np.float32),
        "bell": np.tile((bell / bell.sum())[None, None], (layout, 1, 1, 1)).astype(np.float32),
        "colour_axis": np.array([1], np.int64),
    }
    nodes = [
        helper.make_node("Mul", ["picture", "deviation"], ["scaled"]),
        helper.make_node("Add", ["scaled", "mean"], ["rgb"]),
        helper.make_node("Mul", ["rgb", "rgb"], ["squares"]),
        helper.make_node("ReduceSum", ["squares", "colour_axis"], ["length"], keepdims=1),
        helper.make_node("Conv", ["rgb", "minus_two", "square"], ["linear"]),
        helper.make_node("Add", ["linear", "length"], ["apart"]),
        helper.make_node("Mul", ["apart", "sharp"], ["logarithm"]),
        helper.make_node("Exp", ["logarithm"], ["near"]),
        helper.make_node("Conv", ["near", "bell"], ["found"], group=layout, pads=[6, 6, 6, 6]),
    ]
    if kind == "heatmaps":
        constants |= {
            "none": np.zeros(0, np.float32),
            "small": np.array([1, layout, height // 4, width // 4], np.int64),
        }
        nodes.append(
            helper.make_node(
                "Resize",
                ["found", "", "", "small"],
                ["heatmaps"],
                mode="linear",
                coordinate_transformation_mode="align_corners",
            )
        )
        return save_network(path, nodes, ["heatmaps"], constants, (1, 3, height, width))
    for name, over, side in (("x", 2, width), ("y", 3, height)):
        constants |= {
            f"over_{name}": np.array([over], np.int64),
            f"length_{name}": np.array([1, layout, 2 * side], np.int64),
        }
        nodes += [
            helper.make_node("ReduceMax", ["found", f"over_{name}"], [f"best_{name}"], keepdims=0),
            helper.make_node(
                "Resize",
                [f"best_{name}", "", "", f"length_{name}"],
                [f"simcc_{name}"],
                mode="nearest",
                coordinate_transformation_mode="asymmetric",
                nearest_mode="floor",
            ),
        ]
    return save_network(path, nodes, ["simcc_x", "simcc_y"], constants, (1, 3, height, width))
