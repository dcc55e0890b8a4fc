"""The GLB container of glTF 2.0 (Khronos, glTF 2.0 Specification, 2021): JSON and one binary buffer in one file."""

import json
import struct
from typing import Any

import numpy as np

from hfb.typing import Array, Shaped

_FLOAT, _UBYTE, _USHORT, _UINT = 5126, 5121, 5123, 5125
_COMPONENTS = {
    np.dtype(np.float32): _FLOAT,
    np.dtype(np.uint8): _UBYTE,
    np.dtype(np.uint16): _USHORT,
    np.dtype(np.uint32): _UINT,
}
_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
"""Targets of buffer views of vertices and of indices."""


class GlbBuffer:
    """Collects arrays and files; every array becomes an accessor with a view of its own."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(self, values: Shaped[Array, "n *element"], target: int | None = None, bounds: bool = False) -> int:
        """Append an array of float32, uint8, uint16 or uint32; returns its accessor.

        Args:
            values: one element per row; elements of 1, 2, 3, 4 or 4 x 4 numbers (matrices by columns).
            target: `ARRAY_BUFFER` or `ELEMENT_ARRAY_BUFFER` where vertices or indices are meant.
            bounds: write the smallest and largest value of every component, as positions and key times need them.
        """
        accessor: dict[str, Any] = {
            "bufferView": self._view(np.ascontiguousarray(values).tobytes(), target),
            "componentType": _COMPONENTS[values.dtype],
            "count": len(values),
            "type": _TYPES[values.shape[1:]],
        }
        if bounds:
            flat = values.reshape(len(values), -1)
            accessor |= {"min": flat.min(0).tolist(), "max": flat.max(0).tolist()}
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def add_file(self, data: bytes) -> int:
        """Append a file, such as an image; return the number of its buffer view.

        Args:
            data: content of the file.
        """
        return self._view(data, None)

    def _view(self, data: bytes, target: int | None) -> int:
        self._data += b"\0" * (-len(self._data) % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)}
        self._views.append(view if target is None else view | {"target": target})
        self._data += data
        return len(self._views) - 1

    def glb(self, document: dict[str, Any]) -> bytes:
        """Return the file: a document without its buffers, and the collected buffers.

        Args:
            document: the JSON part.
        """
        whole = document | {
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._data)}],
        }
        text = json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self._data) + b"\0" * (-len(self._data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
