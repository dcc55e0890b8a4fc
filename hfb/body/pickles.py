"""Pickles read without running them.

A pickle is a programme: it may name any function and call it. Here every name resolves to a placeholder of ours
or to an error, so nothing of numpy, scipy, chumpy, torch, joblib or the system is ever called; hfb.body.pickled_arrays
rebuilds arrays by hand from the bytes that the placeholders collected.
"""

import io
import pickle
from collections.abc import Callable
from typing import Any, ClassVar

from hfb.body.placeholders import (
    ChumpyArray,
    JoblibArray,
    NumpyArray,
    NumpyDtype,
    NumpyScalar,
    Placeholder,
    PlainDict,
    SparseMatrix,
    TorchStorage,
    TorchTensor,
    check_keys,
)
from hfb.errors import InputError

_SPARSE = {"csc_matrix", "csr_matrix", "coo_matrix", "csc_array", "csr_array", "coo_array"}
_PATHS = {"PosixPath", "WindowsPath", "PurePosixPath", "PureWindowsPath"}
_STORAGES = {
    "FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "BFloat16Storage": "bf2", "LongStorage": "i8",
    "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1",
}  # fmt: skip
_MAX_ITEM_BYTES = 1 << 16
_MAX_STEPS = 3_000_000


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


def raw_bytes(data: Any = b"", encoding: Any = "latin1") -> bytes:
    """bytes() and bytearray(), but never of a bare size."""
    if isinstance(data, str):
        return _encode(data, encoding)
    if not isinstance(data, (bytes, bytearray)):
        raise InputError("it holds an array without its bytes")
    return bytes(data)


def _new_object(cls: Any, *_arguments: Any) -> Any:
    if not (isinstance(cls, type) and issubclass(cls, Placeholder | PlainDict)):
        raise InputError("it builds an unexpected object")
    return cls()


def _plain(*_arguments: Any) -> None:
    """Sets and the like, which chumpy keeps beside its values; they are of no use here."""


def _tuple(values: Any = ()) -> tuple[Any, ...]:
    if not isinstance(values, list | tuple):
        raise InputError("it holds a size that is none")
    return tuple(values)


def _parameter(tensor: Any = None, *_arguments: Any) -> Any:
    return tensor


def _saved_by_torch(data: Any = b"") -> Any:
    """A file of torch within the pickle, as tensors outside torch.save are kept."""
    from hfb.body.torch_files import load_torch  # it needs this module

    inner = raw_bytes(data)
    if inner[:2] == b"PK":  # torch writes its older kind there; archives within archives are bombs
        raise InputError("it holds an archive within itself")
    return load_torch(inner)


_ALLOWED: dict[str, Any] = {
    "numpy.ndarray": NumpyArray,
    "numpy.dtype": NumpyDtype,
    "_codecs.encode": _encode,
    "builtins.bytes": raw_bytes,
    "builtins.bytearray": raw_bytes,
    "builtins.set": _plain,
    "builtins.frozenset": _plain,
    "builtins.object": Placeholder,
    "builtins.dict": PlainDict,
    "collections.OrderedDict": PlainDict,
    "collections.defaultdict": PlainDict,
    "joblib.numpy_pickle.NumpyArrayWrapper": JoblibArray,
    "torch._utils._rebuild_tensor": TorchTensor,
    "torch._utils._rebuild_tensor_v2": TorchTensor,
    "torch._utils._rebuild_parameter": _parameter,
    "torch.storage._load_from_bytes": _saved_by_torch,
    "torch.Size": _tuple,
    "torch.device": _plain,
    **{f"torch.{name}": type(name, (TorchStorage,), {"code": code}) for name, code in _STORAGES.items()},
    **{f"pathlib.{name}": Placeholder for name in _PATHS},
    **{f"pathlib._local.{name}": Placeholder for name in _PATHS},
    "copyreg._reconstructor": _new_object,
    **{f"numpy.{core}.multiarray._reconstruct": _reconstruct for core in ("core", "_core")},
    **{f"numpy.{core}.multiarray.scalar": NumpyScalar for core in ("core", "_core")},
    **{f"numpy.{core}.numeric._frombuffer": _from_buffer for core in ("core", "_core")},
}


def _sparse_placeholder(name: str) -> type[SparseMatrix]:
    return type(name, (SparseMatrix,), {"form": name[:3]})


# The interpreter's unpickler written in Python: the C one grows its memo to any index that a file names.
_PythonUnpickler: Any = pickle._Unpickler


class Bytes(io.BytesIO):
    """A stream over bytes in memory, parts of which can be had without a copy."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._whole = memoryview(data)
        self.steps_left = _MAX_STEPS

    def view(self, size: int) -> memoryview:
        """The next bytes.

        Raises:
            InputError: there are not so many.
        """
        start = self.tell()
        if not 0 <= size <= len(self._whole) - start:
            raise InputError("it is cut off")
        self.seek(start + size)
        return self._whole[start : start + size]


class _Unpickler(_PythonUnpickler):
    """Resolves names to placeholders only."""

    dispatch: ClassVar[dict[int, Any]] = dict(_PythonUnpickler.dispatch)

    def __init__(self, stream: Bytes, outside: Callable[[Any], Any] | None) -> None:
        super().__init__(stream, encoding="latin1")
        self._stream = stream
        self._outside = outside

    def load(self) -> Any:
        """As the base class, for so many steps: each takes a byte of the file and half a microsecond."""
        self._unframer = pickle._Unframer(self._file_read, self._file_readline)  # type: ignore[attr-defined]
        self.read, self.readinto = self._unframer.read, self._unframer.readinto
        self.readline = self._unframer.readline
        self.metastack: list[list[Any]] = []
        self.stack: list[Any] = []
        self.proto = 0
        self.append = self.stack.append
        read, dispatch, stream = self.read, self.dispatch, self._stream
        try:
            while stream.steps_left > 0:
                stream.steps_left -= 1
                dispatch[read(1)[0]](self)
        except pickle._Stop as stop:  # type: ignore[attr-defined]
            return stop.value
        raise InputError("it takes millions of steps to read, as no file of arrays does")

    def find_class(self, module: str, name: str) -> Any:
        module = {"__builtin__": "builtins", "copy_reg": "copyreg"}.get(module, module)
        full = f"{module}.{name}"
        if full in _ALLOWED:
            return _ALLOWED[full]
        if module.split(".")[0] == "chumpy":
            return ChumpyArray
        if module.startswith("scipy.sparse") and name in _SPARSE:
            return _sparse_placeholder(name)
        raise InputError(f"its pickle asks for {full}, which plain numbers do not need and hfb does not run")

    def persistent_load(self, pid: Any) -> Any:
        if self._outside is None:
            raise InputError("its pickle refers to something outside the file")
        return self._outside(pid)

    def get_extension(self, code: int) -> Any:
        raise InputError("its pickle uses the extension registry")

    def load_build(self) -> None:
        """As the base class, for placeholders only: a file must not set attributes of anything else."""
        if isinstance(self.stack[-2], PlainDict):
            self.stack.pop()
            return
        if not isinstance(self.stack[-2], Placeholder):
            raise InputError("it gives a state to something that has none")
        super().load_build()
        if isinstance(self.stack[-1], JoblibArray):
            self._read_behind(self.stack[-1])

    def _read_behind(self, array: JoblibArray) -> None:
        """The bytes of a joblib array: padding that its first byte counts, then the numbers."""
        if self._unframer.current_frame is not None and self._unframer.current_frame.read(1):
            raise InputError("it holds an array in the middle of something else")
        code = array.field("dtype").arguments[0]
        if code == "O8" or code == "O":
            array.data = _Unpickler(self._stream, self._outside).load()
            return
        if array.state.get("numpy_array_alignment_bytes") is not None:
            self._stream.read(int.from_bytes(self._stream.read(1), "little"))
        size = item_bytes(code)
        for side in array.field("shape"):
            size *= side
        array.data = self._stream.view(size)

    def load_setitem(self) -> None:
        """As the base class, for keys that cannot be made to collide."""
        check_keys(self.stack[-2:-1])
        super().load_setitem()

    def load_setitems(self) -> None:
        """As the base class, see `load_setitem`."""
        check_keys(self.stack[::2])
        super().load_setitems()

    def load_dict(self) -> None:
        """As the base class, see `load_setitem`."""
        check_keys(self.stack[::2])
        super().load_dict()

    def load_bytearray8(self) -> None:
        """As the base class, but never allocating more than the file holds."""
        size = int.from_bytes(self.read(8), "little")
        data = self.read(size)
        if len(data) != size:
            raise InputError("it is cut off")
        self.append(data)

    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.SETITEM[0]] = load_setitem
    dispatch[pickle.SETITEMS[0]] = load_setitems
    dispatch[pickle.DICT[0]] = load_dict
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8


def item_bytes(code: Any) -> int:
    """Bytes of one entry of numpy's type code, such as "f4" or "U12".

    Raises:
        InputError: no such code.
    """
    text = code.decode("latin1") if isinstance(code, bytes) else code
    if not isinstance(text, str) or not text.lstrip("<>=|")[1:].isdigit():
        raise InputError("it holds an array of things that are not numbers")
    kind, size = text.lstrip("<>=|")[0], int(text.lstrip("<>=|")[1:])
    if kind not in "biufcUS" or size > _MAX_ITEM_BYTES:
        raise InputError("it holds an array of things that are not numbers")
    return 4 * size if kind == "U" else size


def load_pickle(data: bytes) -> Any:
    """What a pickle holds, with placeholders for everything that is not a plain Python value.

    Raises:
        InputError: it names anything but arrays, or is not a whole pickle; the text continues "FILE cannot be
            used: ".
    """
    return load_from(Bytes(data))


def load_from(stream: Bytes, outside: Callable[[Any], Any] | None = None) -> Any:
    """The next pickle of a stream, which is left at its end.

    Args:
        outside: gives what the pickle refers to outside itself; without it that is an error.

    Raises:
        InputError: see `load_pickle`.
    """
    try:
        return _Unpickler(stream, outside).load()
    except InputError:
        raise
    except Exception as error:  # garbage makes the machine raise nearly anything
        raise InputError(f"it is not a readable pickle ({type(error).__name__})") from error
