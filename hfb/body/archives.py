"""The named arrays of a model file, .npz or .pkl, told apart by content; sizes are checked before anything is read."""

import io
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from hfb.body.pickled_arrays import to_array
from hfb.body.pickles import load_pickle
from hfb.errors import InputError
from hfb.shapes import Array, Shaped

MAX_BYTES = 1 << 30


def read_arrays(path: Path, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], frozenset[str]]:
    """(the wanted arrays that the file has, the names of everything in it).

    Raises:
        InputError: no file there, too large, not an archive or pickle of arrays, or a pickle that names code.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise InputError(f"{path} is a folder, not a body model; give the .npz or .pkl file in it.")
        if size > MAX_BYTES:
            raise InputError(
                f"{path} has {size / 1e9:.1f} GB, far more than a body model; give a SMPL .npz or .pkl file."
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}); give the path of a SMPL .npz or .pkl file, "
            "or leave the body model out to use the embedded one."
        ) from error
    try:
        return _from_zip(data, wanted) if data[:2] == b"PK" else _from_pickle(data, wanted)
    except InputError as error:
        raise InputError(
            f"{path} cannot be used as a body model: {error}; give a SMPL .npz or .pkl file as downloaded, "
            "or leave the body model out to use the embedded one."
        ) from error


def _from_pickle(data: bytes, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], frozenset[str]]:
    content = load_pickle(data)
    if not isinstance(content, dict):
        raise InputError("its pickle holds no named arrays")
    names = {_text(name): value for name, value in content.items()}
    try:
        return {name: to_array(value) for name, value in names.items() if name in wanted}, frozenset(names)
    except (ValueError, TypeError, IndexError, RecursionError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"its arrays cannot be put together ({type(error).__name__})") from error


def _text(name: Any) -> str:
    return name.decode("latin1") if isinstance(name, bytes) else str(name)


def _from_zip(data: bytes, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], frozenset[str]]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            chosen = {name: info for name, info in members.items() if name in wanted}
            if sum(info.file_size for info in chosen.values()) > MAX_BYTES:
                raise InputError("unpacked it would be larger than 1 GiB")
            arrays = {}
            for name, info in chosen.items():
                with archive.open(info) as member:
                    arrays[name] = _read_npy(member.read(info.file_size))
            return arrays, frozenset(members)
    except InputError:
        raise
    except Exception as error:  # a broken archive makes zipfile and numpy raise nearly anything
        raise InputError(f"it is not a readable .npz archive ({type(error).__name__})") from error


def _read_npy(data: bytes) -> Shaped[Array, "..."]:
    """One member of an .npz; numpy's own reader would run a pickled one."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(stream)
    rest = data[stream.tell() :]
    if dtype.hasobject:
        return to_array(load_pickle(rest))
    if dtype.kind not in "fiub":
        raise InputError("it holds an array of things that are not numbers")
    if len(rest) != int(np.prod(shape, dtype=np.float64)) * dtype.itemsize:
        raise InputError("it holds an array whose bytes do not fit its shape")
    return np.frombuffer(rest, dtype).reshape(shape, order="F" if fortran else "C").astype(dtype.newbyteorder("="))
