"""Conversion of placeholders of arrays and tensors to numpy arrays, from their bytes."""

import math
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.io.safe.pickle_stream import sides_of
from hfb.io.safe.placeholders import (
    ChumpyArray,
    JoblibArray,
    NumpyArray,
    NumpyDtype,
    NumpyScalar,
    Placeholder,
    SparseMatrix,
    TorchStorage,
    TorchTensor,
    raw_bytes,
)
from hfb.typing import Array, Shaped

_NUMERIC = {"b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8"}
_MAX_ENTRIES = 1 << 26  # 0.5 GB of float64


def to_array(value: Any) -> Shaped[Array, "..."]:
    """Build the numpy array of a placeholder.

    Args:
        value: loaded from a pickle.

    Raises:
        InputError: it stands for none.
    """
    try:
        return _array_of(value)
    except InputError:
        raise
    except Exception as error:  # what a hostile file combines is not foreseeable
        raise InputError(f"its arrays cannot be put together ({type(error).__name__})") from error


def _array_of(value: Any) -> Shaped[Array, "..."]:
    match value:
        case NumpyArray():
            return _numpy_array(value)
        case NumpyScalar(arguments=(dtype, data)):
            return _from_bytes((), dtype, False, data)
        case ChumpyArray():
            return _chumpy_value(value)
        case SparseMatrix():
            return _dense(value)
        case JoblibArray():
            return _joblib_array(value)
        case TorchTensor():
            return _torch_tensor(value)
        case bool() | int() | float():
            return np.asarray(value)
        case np.ndarray() if value.dtype.kind in "fiub":
            return value
        case list() | tuple() if all(isinstance(entry, (bool, int, float)) for entry in value):
            return np.asarray(value)
        case Placeholder():
            raise InputError(f"it holds a {value.kind} where numbers should be")
    raise InputError(f"it holds a {type(value).__name__} where numbers should be")


def _chumpy_value(value: ChumpyArray) -> Shaped[Array, "..."]:
    state = value.state if isinstance(value.state, dict) else {}
    if "x" in state or "r" in state:
        return to_array(value.field("x", "r"))
    entries = to_array(value.field("a")).reshape(-1)[to_array(value.field("idxs")).reshape(-1)]
    return entries.reshape(_shape(state["preferred_shape"])) if "preferred_shape" in state else entries


def _numpy_array(value: NumpyArray) -> Shaped[Array, "..."]:
    if not isinstance(value.state, tuple) or len(value.state) != 4:
        raise InputError("it holds an array that was never filled")
    shape, dtype, fortran, data = value.state
    if isinstance(data, list) and len(data) == 1:  # an object array around one thing: numpy.savez does that
        return to_array(data[0])
    return _from_bytes(shape, dtype, bool(fortran), data)


def _joblib_array(value: JoblibArray) -> Shaped[Array, "..."]:
    if isinstance(value.data, NumpyArray | list):  # an array of objects
        return to_array(value.data)
    return _from_bytes(value.field("shape"), value.field("dtype"), value.field("order") == "F", value.data)


def _torch_tensor(value: TorchTensor) -> Shaped[Array, "..."]:
    """Build a tensor from its storage: a view of the file's bytes, copied once."""
    if len(value.arguments) < 4 or not isinstance(value.arguments[0], TorchStorage):
        raise InputError("it holds a tensor without its numbers")
    storage, offset, sizes, strides = value.arguments[:4]
    shape, steps = _shape(sizes), _shape_like(strides)
    code = "u2" if storage.code == "bf2" else storage.code
    entries = np.frombuffer(storage.data, np.dtype("<" + code)) if len(storage.data) else np.zeros(0, np.dtype(code))
    if len(steps) != len(shape) or not isinstance(offset, int) or offset < 0:
        raise InputError("it holds a tensor of an impossible shape")
    last = offset + sum((size - 1) * step for size, step in zip(shape, steps, strict=True))
    if 0 not in shape and last >= len(entries):
        raise InputError("it holds a tensor larger than its numbers")
    if 0 in shape:
        return np.zeros(shape, entries.dtype)
    wide = tuple(step * entries.itemsize for step in steps)
    array = np.lib.stride_tricks.as_strided(entries[offset:], shape, wide, writeable=False).copy()
    return (array.astype(np.uint32) << 16).view(np.float32) if storage.code == "bf2" else array


def _shape_like(strides: Any) -> tuple[int, ...]:
    if not isinstance(strides, tuple) or not all(isinstance(step, int) and step >= 0 for step in strides):
        raise InputError("it holds a tensor of an impossible shape")
    return strides


def _shape(shape: Any) -> tuple[int, ...]:
    if isinstance(shape, NumpyArray):
        shape = tuple(to_array(shape).tolist())
    sides = sides_of(shape)
    if math.prod(sides) > _MAX_ENTRIES or len(sides) > 4:
        raise InputError(f"it holds an array of an absurd shape {sides[:5]}")
    return sides


def _from_bytes(shape: Any, dtype: Any, fortran: bool, data: Any) -> Shaped[Array, "..."]:
    code = dtype.arguments[0] if isinstance(dtype, NumpyDtype) and dtype.arguments else None
    if isinstance(code, bytes):
        code = code.decode("latin1")
    if not isinstance(code, str) or code.lstrip("<>=|") not in _NUMERIC:
        raise InputError("it holds an array of things that are not numbers")
    order = dtype.state[1] if isinstance(dtype.state, tuple) and len(dtype.state) > 1 else "<"
    if isinstance(order, bytes):
        order = order.decode("latin1")
    kind = np.dtype((">" if order == ">" or code.startswith(">") else "<") + code.lstrip("<>=|"))
    shape = _shape(shape)
    raw = data if isinstance(data, memoryview) else raw_bytes(data)
    if len(raw) != int(np.prod(shape, dtype=np.int64)) * kind.itemsize:
        raise InputError("it holds an array whose bytes do not fit its shape")
    return np.frombuffer(raw, kind).reshape(shape, order="F" if fortran else "C").astype(kind.newbyteorder("="))


def _dense(value: SparseMatrix) -> Shaped[Array, "rows columns"]:
    shape = _shape(value.field("_shape", "shape"))
    entries = to_array(value.field("data")).reshape(-1)
    if len(shape) != 2:
        raise InputError("it holds a sparse matrix without two sides")
    if value.form == "coo":
        rows, columns = value.field("coords") if "coords" in value.state else (value.field("row"), value.field("col"))
        row, column = to_array(rows).reshape(-1), to_array(columns).reshape(-1)
    else:
        minor = to_array(value.field("indices")).reshape(-1)
        counts = np.diff(to_array(value.field("indptr")).reshape(-1))
        if (counts < 0).any() or counts.sum() != len(entries):
            raise InputError("it holds a broken sparse matrix")
        major = np.repeat(np.arange(len(counts)), counts)
        row, column = (minor, major) if value.form == "csc" else (major, minor)
    if not (len(row) == len(column) == len(entries)):
        raise InputError("it holds a broken sparse matrix")
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    if not inside.all():
        raise InputError("it holds a broken sparse matrix")
    dense = np.zeros(shape)
    np.add.at(dense, (row, column), entries)
    return dense
