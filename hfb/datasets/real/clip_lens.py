"""The lens that clip.toml names: out of Pose2Sim's Calib.toml, cameras.json, or a calibration as OpenCV writes it."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hfb.clip import ClipCamera
from hfb.datasets.real.calibration import camera_of, read_calibration
from hfb.errors import InputError
from hfb.media.lens import Lens
from hfb.shapes import Array

_BYTE_LIMIT, _MOST_ROWS = 1 << 20, 100
_DEEPEST = 32  # OpenCV's parsers call themselves for every bracket or tag until the stack is used up
_MATRIX = ("camera_matrix", "cameraMatrix", "K", "mtx", "intrinsic_matrix", "intrinsics")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "distortion", "dist", "D")
_WIDTH, _HEIGHT = ("image_width", "imageWidth", "width"), ("image_height", "imageHeight", "height")


def clip_lens(camera: ClipCamera, video: str, height: int, width: int) -> Lens | None:
    """The calibrated lens of a clip; None where clip.toml names no calibration file.

    Args:
        video: the footage's file name: a calibration of several cameras is searched by it where no name is given.
        height, width: of the footage's frames [px].

    Raises:
        InputError: missing, damaged, no such camera in it, or of pictures of another size.
    """
    path = camera.calibration
    if path is None:
        return None
    found = _opencv(path) if _is_opencv(path) else _listed(path, camera.name, video)
    lens, size = found
    if size is not None and size != (height, width):
        raise InputError(
            f"{path}: is a calibration of {size[1]} x {size[0]} pixels and the footage has {width} x {height}; "
            "give the calibration of this camera at this size."
        )
    return lens


def _listed(path: Path, name: str | None, video: str) -> tuple[Lens, tuple[int, int]]:
    cameras = read_calibration(path)
    if name is not None:
        chosen = next((one for one in cameras if one.name == name), None)
    else:
        chosen = cameras[0] if len(cameras) == 1 else camera_of(cameras, video)
    if chosen is None:
        names = ", ".join(one.name for one in cameras[:12])
        raise InputError(f"{path}: which of its cameras took {video}? Set camera.name to one of {names}.")
    K = chosen.K
    lens = Lens(
        (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])), tuple(float(one) for one in chosen.distortion)
    )
    return lens, (chosen.height, chosen.width)


def _is_opencv(path: Path) -> bool:
    if path.suffix.lower() in (".yaml", ".yml", ".xml"):
        return True
    return path.suffix.lower() == ".json" and "cameras" not in _json(path)


def _opencv(path: Path) -> tuple[Lens, tuple[int, int] | None]:
    entries = _json(path) if path.suffix.lower() == ".json" else _storage(path)
    matrix = _array(entries, _MATRIX)
    if matrix is None or matrix.size != 9:
        raise InputError(f"{path}: has no camera_matrix of 3 x 3 numbers; give a calibration as OpenCV writes it.")
    matrix = matrix.reshape(3, 3)
    distortion = _array(entries, _DISTORTION)
    flat = np.zeros(4) if distortion is None else distortion.ravel()
    finite = np.isfinite(matrix).all() and np.isfinite(flat).all()
    if not finite or matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or len(flat) not in (4, 5, 8, 12, 14):
        raise InputError(f"{path}: its camera matrix or distortion is impossible; calibrate again.")
    width, height = (next((entries[name] for name in names if name in entries), None) for names in (_WIDTH, _HEIGHT))
    known = isinstance(width, int | float) and isinstance(height, int | float)
    lens = Lens(
        (float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])),
        tuple(float(one) for one in flat),
    )
    return lens, (int(height), int(width)) if known else None  # type: ignore[arg-type]


def _array(entries: dict[str, Any], names: tuple[str, ...]) -> Array | None:
    for name in names:
        value = entries.get(name)
        if isinstance(value, dict):
            value = value.get("data")
        if value is not None:
            try:
                return np.array(value, np.float64)
            except (ValueError, TypeError, OverflowError):
                return None
    return None


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _BYTE_LIMIT:
            raise InputError(f"{path}: is too large for a calibration.")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check camera.calibration.") from None
    except (OSError, UnicodeDecodeError):
        raise InputError(f"{path}: can't be read as text; give a calibration as OpenCV writes it.") from None


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(_text(path))
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not valid JSON; export it again.") from None
    return content if isinstance(content, dict) else {}


def _storage(path: Path) -> dict[str, Any]:
    """The entries of OpenCV's own YAML or XML that matter."""
    text = _text(path)
    sides = re.findall(r"(?:rows|cols)[^\w-]{1,8}(-?\d+)", text)
    if any(len(side) > 3 or not 0 < int(side) < _MOST_ROWS for side in sides):
        raise InputError(f"{path}: announces a matrix of a size that no calibration has; export it again.")
    if _depth(text) > _DEEPEST:
        raise InputError(f"{path}: is no calibration as OpenCV writes it: it nests without end; export it again.")
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        entries: dict[str, Any] = {}
        for name in (*_MATRIX, *_DISTORTION):
            node = storage.getNode(name)
            if not node.empty():
                entries[name] = node.mat()
        for name in (*_WIDTH, *_HEIGHT):
            node = storage.getNode(name)
            if not node.empty() and (node.isInt() or node.isReal()):
                entries[name] = node.real()
        storage.release()
    except (cv2.error, SystemError):
        raise InputError(f"{path}: is no calibration as OpenCV writes it; export it again.") from None
    return {name: value for name, value in entries.items() if value is not None}


def _depth(text: str) -> int:
    """How many brackets, tags or steps of indentation lie within each other, at most."""
    deepest, depth = max((len(line) - len(line.lstrip()) for line in text.splitlines()), default=0) // 4, 0
    for found in re.finditer(r"[\[{]|[\]}]|</|/>|<\w", text):
        depth += 1 if found[0] in "[{" or found[0][-1].isalnum() else -1
        deepest = max(deepest, depth)
    return deepest
