"""Calibration files of any maker as plain dictionaries: TOML, JSON, YAML, and OpenCV's own YAML and XML."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import yaml

from hfb.errors import InputError
from hfb.io.toml_file import read_toml

_BYTE_LIMIT, _PLAIN_YAML_LIMIT = 1 << 20, 1 << 17
_MOST_ROWS = 100
_DEEPEST = 32  # OpenCV's parsers call themselves for every bracket or tag until the stack is used up
_ALIAS = re.compile(r"(?:^|[\s,\[{:-])[&*][\w-]", re.MULTILINE)


def read_document(path: Path) -> dict[str, Any]:
    """Read a calibration file; empty where it is not a table of entries.

    Args:
        path: the file.

    Raises:
        InputError: missing, too large, damaged, or nested without end.
    """
    if path.suffix.lower() == ".toml":
        return read_toml(path)
    text = _text(path)
    if path.suffix.lower() == ".json":
        return _json(path, text)
    sides = re.findall(r"(?:rows|cols)[^\w-]{1,8}(-?\d+)", text)
    if any(len(side) > 3 or not 0 < int(side) < _MOST_ROWS for side in sides):
        raise InputError(f"{path}: announces a matrix of a size that no calibration has; export it again.")
    if _depth(text) > _DEEPEST:
        raise InputError(f"{path}: is no calibration as OpenCV writes it: it nests without end; export it again.")
    written_so = text.lstrip("\ufeff").startswith("%YAML:") or "!!opencv-matrix" in text
    return _opencv(path, text) if path.suffix.lower() == ".xml" or written_so else _yaml(path, text)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _BYTE_LIMIT:
            raise InputError(f"{path}: is too large for a calibration.")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check camera.calibration.") from None
    except (OSError, UnicodeDecodeError):
        raise InputError(f"{path}: can't be read as text; give a calibration as OpenCV writes it.") from None


def _json(path: Path, text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not valid JSON; export it again.") from None
    return content if isinstance(content, dict) else {}


def _yaml(path: Path, text: str) -> dict[str, Any]:
    """Parse plain YAML of ROS and Kalibr, of which OpenCV's own parser reads only some."""
    if len(text) > _PLAIN_YAML_LIMIT or _ALIAS.search(text):
        raise InputError(f"{path}: is too large for a calibration, or repeats parts by aliases; export it again.")
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        raise InputError(f"{path}: is no calibration as OpenCV, ROS or Kalibr write it; export it again.") from None
    return _named(content) if isinstance(content, dict) else {}


def _named(value: Any) -> Any:
    """Convert the keys of every table to texts; YAML's may be numbers and dates."""
    if isinstance(value, dict):
        return {str(key): _named(one) for key, one in value.items()}
    return [_named(one) for one in value] if isinstance(value, list) else value


def _opencv(path: Path, text: str) -> dict[str, Any]:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        content = _node(storage.root())
        storage.release()
    except (cv2.error, SystemError):
        raise InputError(f"{path}: is no calibration as OpenCV writes it; export it again.") from None
    return content if isinstance(content, dict) else {}


def _node(node: Any) -> Any:
    """Convert a node of OpenCV's storage; matrices become dictionaries with their numbers as `data`."""
    if node.isMap():
        return {key: _node(node.getNode(key)) for key in node.keys()}  # noqa: SIM118  a node is no dictionary
    if node.isSeq():
        return [_node(node.at(index)) for index in range(min(node.size(), _MOST_ROWS))]
    if node.isInt() or node.isReal():
        return node.real()
    return node.string() if node.isString() else None


def _depth(text: str) -> int:
    """Return the deepest nesting of brackets, tags or indentation."""
    deepest, depth = max((len(line) - len(line.lstrip()) for line in text.splitlines()), default=0) // 4, 0
    for found in re.finditer(r"[\[{]|[\]}]|</|/>|<\w", text):
        depth += 1 if found[0] in "[{" or found[0][-1].isalnum() else -1
        deepest = max(deepest, depth)
    return deepest
