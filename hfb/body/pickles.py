"""Arrays out of pickles without running them.

A pickle is a programme: it may name any function and call it. Here every name resolves to a placeholder of ours
or to an error, so nothing of numpy, scipy, chumpy or the system is ever called; arrays are rebuilt by hand from
the bytes that the placeholders collected.
"""

import io
import pickle
from typing import Any, ClassVar, NoReturn

import numpy as np

from hfb.errors import InputError
from hfb.shapes import Array, Shaped

_NUMERIC = {"b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8"}
_SPARSE = {"csc_matrix", "csr_matrix", "coo_matrix", "csc_array", "csr_array", "coo_array"}
_MAX_ENTRIES = 1 << 27  # 1 GiB of float64


class Placeholder:
    """An object of a class that is never imported: what it was called with, and its state."""

    kind = "object"
    arguments: tuple[Any, ...] = ()
    state: Any = None

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def field(self, *names: str) -> Any:
        """The first of these attributes that the pickled object had."""
        state = self.state if isinstance(self.state, dict) else {}
        for name in names:
            if name in state:
                return state[name]
        raise InputError(f"it holds a {self.kind} without {' or '.join(names)}")


class NumpyArray(Placeholder):
    """Stands for numpy.ndarray: the state is (version, shape, dtype, Fortran order, bytes or a list of objects)."""

    kind = "numpy array"

    def __setstate__(self, state: Any) -> None:
        self.state = state[-4:]  # very old pickles lack the version


class NumpyDtype(Placeholder):
    """Stands for numpy.dtype: called with its code, e.g. "f8"; the state's second entry is the byte order."""

    kind = "numpy dtype"


class NumpyScalar(Placeholder):
    """Stands for numpy's scalar constructor: called with a dtype and bytes."""

    kind = "numpy scalar"


class SparseMatrix(Placeholder):
    """Stands for scipy.sparse matrices in compressed or coordinate form."""

    kind = "sparse matrix"
    form = ""


class ChumpyArray(Placeholder):
    """Stands for every class of chumpy: a value is its attribute x, or entries `idxs` of another one, `a`."""

    kind = "chumpy expression"


def _reconstruct(*_arguments: Any) -> NumpyArray:
    return NumpyArray()


def _from_buffer(data: Any, dtype: Any, shape: Any, order: Any) -> NumpyArray:
    array = NumpyArray()
    array.state = (shape, dtype, order == "F", data)
    return array


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1", "iso-8859-1"):
        raise InputError("it encodes text in an unexpected way")
    return text.encode("latin1")


def _raw(data: Any = b"", encoding: Any = "latin1") -> bytes:
    """bytes() and bytearray(), but never of a bare size."""
    if isinstance(data, str):
        return _encode(data, encoding)
    if not isinstance(data, (bytes, bytearray)):
        raise InputError("it holds an array without its bytes")
    return bytes(data)


def _new_object(cls: Any, *_arguments: Any) -> Any:
    if not (isinstance(cls, type) and issubclass(cls, Placeholder)):
        raise InputError("it builds an unexpected object")
    return cls()


def _plain(*_arguments: Any) -> None:
    """Sets and the like, which chumpy keeps beside its values; they are of no use here."""


_ALLOWED: dict[str, Any] = {
    "numpy.ndarray": NumpyArray,
    "numpy.dtype": NumpyDtype,
    "_codecs.encode": _encode,
    "builtins.bytes": _raw,
    "builtins.bytearray": _raw,
    "builtins.set": _plain,
    "builtins.frozenset": _plain,
    "builtins.object": Placeholder,
    "copyreg._reconstructor": _new_object,
    **{f"numpy.{core}.multiarray._reconstruct": _reconstruct for core in ("core", "_core")},
    **{f"numpy.{core}.multiarray.scalar": NumpyScalar for core in ("core", "_core")},
    **{f"numpy.{core}.numeric._frombuffer": _from_buffer for core in ("core", "_core")},
}


def _sparse_placeholder(name: str) -> type[SparseMatrix]:
    return type(name, (SparseMatrix,), {"form": name[:3]})


# The interpreter's unpickler written in Python: the C one grows its memo to any index that a file names.
_PythonUnpickler: Any = pickle._Unpickler


class _Unpickler(_PythonUnpickler):
    """Resolves names to placeholders only."""

    dispatch: ClassVar[dict[int, Any]] = dict(_PythonUnpickler.dispatch)

    def find_class(self, module: str, name: str) -> Any:
        module = {"__builtin__": "builtins", "copy_reg": "copyreg"}.get(module, module)
        full = f"{module}.{name}"
        if full in _ALLOWED:
            return _ALLOWED[full]
        if module.split(".")[0] == "chumpy":
            return ChumpyArray
        if module.startswith("scipy.sparse") and name in _SPARSE:
            return _sparse_placeholder(name)
        raise InputError(f"its pickle asks for {full}, which a body model does not need and hfb does not run")

    def persistent_load(self, pid: Any) -> NoReturn:
        raise InputError("its pickle refers to something outside the file")

    def get_extension(self, code: int) -> NoReturn:
        raise InputError("its pickle uses the extension registry")

    def load_build(self) -> None:
        """As the base class, for placeholders only: a file must not set attributes of anything else."""
        if not isinstance(self.stack[-2], Placeholder):
            raise InputError("it gives a state to something that has none")
        super().load_build()

    def load_bytearray8(self) -> None:
        """As the base class, but never allocating more than the file holds."""
        size = int.from_bytes(self.read(8), "little")
        data = self.read(size)
        if len(data) != size:
            raise InputError("it is cut off")
        self.append(data)

    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8


def load_pickle(data: bytes) -> Any:
    """What a pickle holds, with placeholders for everything that is not a plain Python value.

    Raises:
        InputError: it names anything but arrays, or is not a whole pickle; the text continues "FILE cannot be
            used: ".
    """
    try:
        return _Unpickler(io.BytesIO(data), encoding="latin1").load()
    except InputError:
        raise
    except Exception as error:  # garbage makes the machine raise nearly anything
        raise InputError(f"it is not a readable pickle ({type(error).__name__})") from error


def to_array(value: Any) -> Shaped[Array, "..."]:
    """The numpy array that a loaded value stands for.

    Raises:
        InputError: it stands for none.
    """
    match value:
        case NumpyArray():
            return _numpy_array(value)
        case NumpyScalar(arguments=(dtype, data)):
            return _from_bytes((), dtype, False, data)
        case ChumpyArray():
            return _chumpy_value(value)
        case SparseMatrix():
            return _dense(value)
        case bool() | int() | float():
            return np.asarray(value)
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


def _shape(shape: Any) -> tuple[int, ...]:
    if isinstance(shape, NumpyArray):
        shape = tuple(to_array(shape).tolist())
    if not isinstance(shape, tuple) or not all(isinstance(size, int) and size >= 0 for size in shape):
        raise InputError("it holds an array of an impossible shape")
    entries = 1
    for size in shape:
        entries *= size
    if entries > _MAX_ENTRIES or len(shape) > 4:
        raise InputError(f"it holds an array of an absurd shape {shape[:5]}")
    return shape


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
    raw = _raw(data)
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
