"""Pickles read without running them.

A pickle is a program: it may name any function and call it. Here every name resolves to a placeholder of hfb or to an
error, so nothing of numpy, scipy, chumpy, torch, joblib or the system is ever called; `hfb.io.safe.pickled_arrays`
rebuilds arrays from the bytes in the placeholders.
"""

import math
import pickle
from collections.abc import Callable
from typing import Any, ClassVar

from hfb.errors import InputError
from hfb.io.safe.pickle_stream import Bytes, Steps, item_bytes, sides_of, weight_of
from hfb.io.safe.placeholders import (
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
    check_number,
    encode,
    from_buffer,
    new_object,
    nothing,
    parameter,
    raw_bytes,
    reconstruct,
    size_of,
)

_SPARSE = {
    f"{form}_{kind}": type(f"{form}_{kind}", (SparseMatrix,), {"form": form})
    for form in ("csc", "csr", "coo")
    for kind in ("matrix", "array")
}
_PATHS = {"PosixPath", "WindowsPath", "PurePosixPath", "PureWindowsPath"}
_STORAGES = {
    "FloatStorage": "f4",
    "DoubleStorage": "f8",
    "HalfStorage": "f2",
    "BFloat16Storage": "bf2",
    "LongStorage": "i8",
    "IntStorage": "i4",
    "ShortStorage": "i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "b1",
}
_MAX_NAME = 200

TorchReader = Callable[[bytes, Steps], Any]
"""Type of `hfb.io.safe.torch_files.load_torch`, which is a parameter since it reads pickles itself."""

_ALLOWED: dict[str, Any] = {
    "numpy.ndarray": NumpyArray,
    "numpy.dtype": NumpyDtype,
    "_codecs.encode": encode,
    "builtins.bytes": raw_bytes,
    "builtins.bytearray": raw_bytes,
    "builtins.set": nothing,
    "builtins.frozenset": nothing,
    "builtins.object": Placeholder,
    "builtins.dict": PlainDict,
    "collections.OrderedDict": PlainDict,
    "collections.defaultdict": PlainDict,
    "joblib.numpy_pickle.NumpyArrayWrapper": JoblibArray,
    "torch._utils._rebuild_tensor": TorchTensor,
    "torch._utils._rebuild_tensor_v2": TorchTensor,
    "torch._utils._rebuild_parameter": parameter,
    "torch.Size": size_of,
    "torch.device": nothing,
    **{f"torch.{name}": type(name, (TorchStorage,), {"code": code}) for name, code in _STORAGES.items()},
    **{f"pathlib.{name}": Placeholder for name in _PATHS},
    **{f"pathlib._local.{name}": Placeholder for name in _PATHS},
    "copyreg._reconstructor": new_object,
    **{f"numpy.{core}.multiarray._reconstruct": reconstruct for core in ("core", "_core")},
    **{f"numpy.{core}.multiarray.scalar": NumpyScalar for core in ("core", "_core")},
    **{f"numpy.{core}.numeric._frombuffer": from_buffer for core in ("core", "_core")},
}


# The interpreter's unpickler written in Python: the C one grows its memo to any index that a file names.
_PythonUnpickler: Any = pickle._Unpickler


class _Unpickler(_PythonUnpickler):
    """Resolves names to placeholders only."""

    dispatch: ClassVar[dict[int, Any]] = dict(_PythonUnpickler.dispatch)

    def __init__(self, stream: Bytes, outside: Callable[[Any], Any] | None, load_torch: TorchReader) -> None:
        super().__init__(stream, encoding="latin1")
        self._stream = stream
        self._outside = outside
        self._load_torch = load_torch

    def load(self) -> Any:
        """Load like the base class, for a limited number of steps: each takes a byte and half a microsecond."""
        self._unframer = pickle._Unframer(self._file_read, self._file_readline)  # type: ignore[attr-defined]
        self.read, self.readinto = self._unframer.read, self._unframer.readinto
        self.readline = self._unframer.readline
        self.metastack: list[list[Any]] = []
        self.stack: list[Any] = []
        self.proto = 0
        self.append = self.stack.append
        read, dispatch, steps = self.read, self.dispatch, self._stream.steps
        try:
            while steps.left > 0:
                steps.left -= 1
                dispatch[read(1)[0]](self)
        except pickle._Stop as stop:  # type: ignore[attr-defined]
            return stop.value
        raise steps.spent()

    def find_class(self, module: str, name: str) -> Any:
        module = {"__builtin__": "builtins", "copy_reg": "copyreg"}.get(module, module)
        if len(module) + len(name) > _MAX_NAME:
            raise InputError("its pickle asks for something with an endless name, which hfb does not run")
        full = f"{module}.{name}"
        if full in _ALLOWED:
            return _ALLOWED[full]
        if full == "torch.storage._load_from_bytes":
            return self._saved_by_torch
        if module.split(".")[0] == "chumpy":
            return ChumpyArray
        if module.startswith("scipy.sparse") and name in _SPARSE:
            return _SPARSE[name]
        raise InputError(f"its pickle asks for {full}, which plain numbers do not need and hfb does not run")

    def _saved_by_torch(self, data: Any = b"") -> Any:
        """Load a file of torch within the pickle, as tensors outside torch.save are stored."""
        inner = raw_bytes(data)
        if inner[:2] == b"PK":  # torch writes its older kind there; archives within archives are bombs
            raise InputError("it holds an archive within itself")
        return self._load_torch(inner, self._stream.steps)

    def persistent_load(self, pid: Any) -> Any:
        if self._outside is None:
            raise InputError("its pickle refers to something outside the file")
        return self._outside(pid)

    def get_extension(self, code: int) -> Any:
        raise InputError("its pickle uses the extension registry")

    def load_build(self) -> None:
        """Load like the base class, for placeholders only: a file must not set attributes of anything else."""
        if isinstance(self.stack[-2], PlainDict):
            self.stack.pop()
            return
        if not isinstance(self.stack[-2], Placeholder):
            raise InputError("it gives a state to something that has none")
        super().load_build()
        if isinstance(self.stack[-1], JoblibArray):
            self._read_behind(self.stack[-1])

    def _read_behind(self, array: JoblibArray) -> None:
        """Read the bytes of a joblib array: padding whose length its first byte gives, then the numbers."""
        if self._unframer.current_frame is not None and self._unframer.current_frame.read(1):
            raise InputError("it holds an array in the middle of something else")
        code = array.field("dtype").arguments[0]
        if code == "O8" or code == "O":
            array.data = _Unpickler(self._stream, self._outside, self._load_torch).load()
            return
        if array.state.get("numpy_array_alignment_bytes") is not None:
            self._stream.read(int.from_bytes(self._stream.read(1), "little"))
        array.data = self._stream.view(item_bytes(code) * math.prod(sides_of(array.field("shape"))))

    def _count(self, arguments: Any) -> None:
        """Take steps for a call's arguments, since the same long list may be passed again and again."""
        if not isinstance(arguments, tuple):
            raise InputError("it calls something with arguments that are none")
        self._stream.steps.take(len(arguments) + sum(map(weight_of, arguments)))

    def load_reduce(self) -> None:
        """Load like the base class, see `_count`."""
        self._count(self.stack[-1])
        super().load_reduce()

    def load_newobj(self) -> None:
        """Load like the base class, see `_count`."""
        self._count(self.stack[-1])
        super().load_newobj()

    def load_newobj_ex(self) -> None:
        """Load like the base class, see `_count`."""
        self._count((*self.stack[-2], self.stack[-1]))
        super().load_newobj_ex()

    def _instantiate(self, klass: Any, arguments: Any) -> None:
        self._count(tuple(arguments))
        super()._instantiate(klass, arguments)

    def load_put(self) -> None:
        """Load like the base class, for keys that cannot be made to collide: the line may hold any number."""
        place = int(self.readline()[:-1])
        check_number(place)
        self.memo[place] = self.stack[-1]

    def load_empty_set(self) -> None:
        """Load None instead of a set, whose entries could collide, and which is not needed."""
        self.append(None)

    def load_additems(self) -> None:
        """See `load_empty_set`."""
        self.pop_mark()

    def load_frozenset(self) -> None:
        """See `load_empty_set`."""
        self.pop_mark()
        self.append(None)

    def load_setitem(self) -> None:
        """Load like the base class, for keys that cannot be made to collide."""
        check_keys(self.stack[-2:-1])
        super().load_setitem()

    def load_setitems(self) -> None:
        """Load like the base class, see `load_setitem`."""
        check_keys(self.stack[::2])
        super().load_setitems()

    def load_dict(self) -> None:
        """Load like the base class, see `load_setitem`."""
        check_keys(self.stack[::2])
        super().load_dict()

    def load_bytearray8(self) -> None:
        """Load like the base class, but never allocate more than the file holds."""
        size = int.from_bytes(self.read(8), "little")
        data = self.read(size)
        if len(data) != size:
            raise InputError("it is cut off")
        self.append(data)

    dispatch[pickle.REDUCE[0]] = load_reduce
    dispatch[pickle.NEWOBJ[0]] = load_newobj
    dispatch[pickle.NEWOBJ_EX[0]] = load_newobj_ex
    dispatch[pickle.PUT[0]] = load_put
    dispatch[pickle.EMPTY_SET[0]] = load_empty_set
    dispatch[pickle.ADDITEMS[0]] = load_additems
    dispatch[pickle.FROZENSET[0]] = load_frozenset
    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.SETITEM[0]] = load_setitem
    dispatch[pickle.SETITEMS[0]] = load_setitems
    dispatch[pickle.DICT[0]] = load_dict
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8


def load_from(stream: Bytes, load_torch: TorchReader, outside: Callable[[Any], Any] | None = None) -> Any:
    """Read the next pickle of a stream, which is left at its end.

    Args:
        stream: bytes with their limit of steps.
        load_torch: reads a file of torch that the pickle holds.
        outside: gives what the pickle refers to outside itself; without it that is an error.

    Raises:
        InputError: see `hfb.io.safe.pickle_reader.load_pickle`.
    """
    try:
        return _Unpickler(stream, outside, load_torch).load()
    except InputError:
        raise
    except MemoryError as error:
        raise InputError("it needs more memory than there is") from error
    except Exception as error:  # garbage makes the machine raise nearly anything
        raise InputError(f"it is not a readable pickle ({type(error).__name__})") from error
