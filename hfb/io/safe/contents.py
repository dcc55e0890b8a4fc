"""Content of another system's file, whatever its container, recognised by content; its code is never run."""

import bz2
import json
import lzma
import math
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.io.array_files import UNPACKED_LIMIT, names_in, parse_array, read_arrays
from hfb.io.safe.pickle_reader import load_pickle
from hfb.io.safe.pickle_stream import Steps, sides_of
from hfb.io.safe.pickled_arrays import to_array
from hfb.io.safe.placeholders import JoblibArray, NumpyArray, NumpyScalar
from hfb.io.safe.torch_files import load_torch, looks_like_torch
from hfb.typing import Array, Float, Int, Shaped

_MAX_BYTES = 768 << 20
_MAX_JSON_BYTES = 32 << 20  # Python takes twenty times as much for nested lists
_MAX_NUMBERS = 1 << 26  # of one array that is really read: half a GiB as float64
_MAX_OBJECT_SIDES = 4
_MAX_ENTRIES, _MAX_DEPTH = 1 << 22, 8  # of lists that stand for an array
_NPY, _GZIP, _BZ2, _XZ = b"\x93NUMPY", b"\x1f\x8b", b"BZh", b"\xfd7zXZ"
_ZLIB = (b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda")
_WHAT = "give a result file of PyMAF, HybrIK, PHALP / 4D-Humans, WHAM, TRAM, GVHMR, SAM 3D Body, NLF, AMASS or of hfb"


def read_contents(path: Path) -> Any:
    """Read a file of another system, of whatever container.

    The result consists of dictionaries, lists, numbers, texts and placeholders of arrays (see `numbers`). Containers
    are pickles, joblib's pickles (compressed ones too), files of torch.save, .npy, .npz and JSON.

    Args:
        path: the file.

    Raises:
        InputError: not there, too large, damaged, or a pickle that names code: the sentence says which.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path} is a folder; {_WHAT}")
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(
                f"{path} has {path.stat().st_size / 1e9:.1f} GB: save it without its vertices, below 0.8 GB"
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); {_WHAT}") from error
    try:
        return _loaded(data, Steps(len(data)))
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}; {_WHAT}") from error
    except MemoryError as error:
        raise InputError(f"{path} cannot be used: it needs more memory than there is; {_WHAT}") from error
    except Exception as error:  # what a hostile file combines is not foreseeable
        raise InputError(f"{path} cannot be used: it is damaged ({type(error).__name__}); {_WHAT}") from error


def numbers(value: Any, *shape: int | None, finite: bool = True) -> Float[Array, "..."]:
    """Return the array of a part of a file as float64; sides of size 1 may be missing or too many.

    Args:
        value: part of a file.
        *shape: required shape; None for a side of any length.
        finite: false where a row that is not finite leaves the others as they are.

    Raises:
        InputError: no numbers, another shape, or not finite; the text continues "FILE cannot be used: ".
    """
    array = array_in(value)
    wanted = tuple(side for side in shape if side != 1)
    squeezed = tuple(side for side in array.shape if side != 1)
    free = [side for side in wanted if side is None]
    if len(free) == 1 and len(squeezed) == len(wanted) - 1:  # one row of a list of rows
        squeezed = _with_one(squeezed, wanted)
    if len(squeezed) != len(wanted) or any(w is not None and w != s for w, s in zip(wanted, squeezed, strict=True)):
        sides = ", ".join("N" if side is None else str(side) for side in shape)
        raise InputError(f"it holds numbers of the shape {array.shape} where ({sides}) were expected")
    lengths = iter(squeezed)
    full = tuple(1 if side == 1 else next(lengths) for side in shape)
    result = array.reshape(full)
    if finite and not np.isfinite(result).all():
        raise InputError("it holds numbers that are not finite")
    return result


def frame_numbers(values: Shaped[Array, "R"], most: float = 1e9) -> Int[Array, "R"]:
    """Convert frame numbers to whole ones.

    Args:
        values: numbers of frames.
        most: largest possible number.

    Raises:
        InputError: one is so large that no recording has so many; the text continues "FILE cannot be used: ".
    """
    if not (np.abs(values) <= most).all():
        raise InputError(f"it holds a frame's number beyond {most:g}")
    return values.astype(np.int64)


def array_in(value: Any) -> Float[Array, "..."]:
    """Return `numbers` of any shape, also not finite; every array of a file passes through this function.

    Args:
        value: part of a file.

    Raises:
        InputError: no numbers, or more of them than any file of motions has.
    """
    array = np.asarray(_gathered(value, _Room()))
    if array.dtype.kind not in "fiub":
        raise InputError("it holds something else where numbers should be")
    return array.astype(np.float64)


class _Room:
    """The entries and numbers that may still be read.

    In a pickle a list may hold itself, or another one ten times, and that one another ten times, or one large tensor:
    a few hundred bytes can stand for an endless content.
    """

    def __init__(self) -> None:
        self.entries, self.numbers = _MAX_ENTRIES, _MAX_NUMBERS

    def array(self, value: Any) -> Any:
        """Convert a placeholder to an array."""
        array = to_array(value)
        self.numbers -= array.size
        if self.numbers < 0:
            raise InputError(f"it holds arrays of more than {_MAX_NUMBERS} numbers where a few were expected")
        return array


def _gathered(value: Any, room: _Room, depth: int = 0) -> Any:
    """Return an array, or lists of arrays: JSON has nothing else."""
    if not isinstance(value, list | tuple):
        return room.array(value)
    room.entries -= len(value)
    if room.entries < 0 or depth > _MAX_DEPTH:
        raise InputError("it holds lists within lists without end where numbers should be")
    parts = [_gathered(one, room, depth + 1) for one in value]
    if len({np.shape(part) for part in parts}) > 1:
        raise InputError("it holds lists of different lengths where numbers should be")
    return np.asarray(parts)


def texts(value: Any) -> list[str]:
    """Return the texts of a list, or of a numpy array of texts; empty where it is neither.

    Args:
        value: part of a file.
    """
    if isinstance(value, list | tuple):
        return [one for one in value if isinstance(one, str)]
    if isinstance(value, NumpyArray) and isinstance(value.state, tuple) and len(value.state) == 4:
        dtype, data = value.state[1], value.state[3]
    elif isinstance(value, JoblibArray):
        dtype, data = value.field("dtype"), value.data
    else:
        return []
    code = getattr(dtype, "arguments", ("",))[0]
    if isinstance(code, str) and code.lstrip("<>=|").startswith("U") and code.lstrip("<>=|")[1:].isdigit():
        width = 4 * int(code.lstrip("<>=|")[1:])
        raw = bytes(data) if not isinstance(data, str) else b""
        if width and len(raw) % width == 0:
            pieces = [raw[at : at + width] for at in range(0, len(raw), width)]
            return [piece.decode("utf-32-le", "replace").rstrip("\0") for piece in pieces]
    if isinstance(data, list):
        return [one for one in data if isinstance(one, str)]
    return []


def text_of(value: Any) -> str:
    """Return a key or name as text.

    Args:
        value: text or bytes.
    """
    plain = to_array(value).item() if isinstance(value, NumpyScalar) else value
    return plain.decode("latin1") if isinstance(plain, bytes) else str(plain)


def named(value: Any) -> dict[str, Any]:
    """Return a dictionary with texts for keys; empty where the value is none.

    Args:
        value: part of a file.
    """
    return {text_of(key): one for key, one in value.items()} if isinstance(value, dict) else {}


def _with_one(squeezed: tuple[int, ...], wanted: tuple[int | None, ...]) -> tuple[int, ...]:
    at = wanted.index(None)
    return (*squeezed[:at], 1, *squeezed[at:])


def _loaded(data: bytes, steps: Steps) -> Any:
    if data[:2] == b"PK":
        return _zipped(data, steps)
    if data[:6] == _NPY:
        return _npy(data, steps)
    if looks_like_torch(data):
        return load_torch(data, steps)
    if data[:2] == _GZIP:
        return load_pickle(_inflated(data, zlib.decompressobj(31).decompress), steps)
    if data[:2] in _ZLIB:
        return load_pickle(_inflated(data, zlib.decompressobj().decompress), steps)
    if data[:3] == _BZ2:
        return load_pickle(_inflated(data, bz2.BZ2Decompressor().decompress), steps)
    if data[:5] == _XZ or data[:1] == b"\x5d":
        return load_pickle(_inflated(data, lzma.LZMADecompressor(memlimit=1 << 28).decompress), steps)
    if data[:512].lstrip()[:1] in (b"{", b"["):
        return _json(data)
    return load_pickle(data, steps)


def _inflated(data: bytes, decompress: Callable[..., bytes]) -> bytes:
    try:
        unpacked = decompress(data, UNPACKED_LIMIT + 1)
    except (zlib.error, OSError, lzma.LZMAError, EOFError, ValueError) as error:
        raise InputError("it is damaged: it cannot be unpacked") from error
    if len(unpacked) > UNPACKED_LIMIT:
        raise InputError(f"unpacked it would be larger than {UNPACKED_LIMIT >> 20} MB")
    return unpacked


def _json(data: bytes) -> Any:
    if len(data) > _MAX_JSON_BYTES:
        raise InputError(f"it is JSON of more than {_MAX_JSON_BYTES >> 20} MB: save it as .npz")
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError("it is not readable JSON") from error


def _zipped(data: bytes, steps: Steps) -> Any:
    try:
        if any(name.endswith("data.pkl") for name in names_in(data)):
            return load_torch(data, steps)
        arrays = read_arrays(data, objects=partial(_objects, steps))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error
    return {name: _texts_as_list(array) for name, array in arrays.items()}


def _npy(data: bytes, steps: Steps) -> Any:
    """Read an array of numbers or texts, or the content of a single array of objects."""
    try:
        return _texts_as_list(parse_array(data, partial(_objects, steps)))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error


def _objects(steps: Steps, pickled: bytes) -> Any:
    return _single(load_pickle(pickled, steps))


def _texts_as_list(array: Any) -> Any:
    return array.tolist() if isinstance(array, np.ndarray) and array.dtype.kind in "US" else array


def _single(value: Any) -> Any:
    """Return the content of an object array with one entry, or the list of several."""
    if isinstance(value, NumpyArray) and isinstance(value.state, tuple) and len(value.state) == 4:
        objects = value.state[3]
        if isinstance(objects, list):
            return _nested(objects, sides_of(value.state[0]))
    return value


def _nested(objects: list[Any], shape: tuple[int, ...]) -> Any:
    """Return a flat list as lists of lists; the entry itself where the array had no sides."""
    if not shape:
        return objects[0] if len(objects) == 1 else objects
    if len(shape) > _MAX_OBJECT_SIDES or len(objects) != math.prod(shape):
        raise InputError("it holds an array of objects of an impossible shape")
    if len(shape) == 1 or not objects:
        return objects
    rows, each = shape[0], len(objects) // shape[0]
    return [_nested(objects[at * each : (at + 1) * each], shape[1:]) for at in range(rows)]
