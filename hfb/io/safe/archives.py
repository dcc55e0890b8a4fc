"""The named arrays of a model file, .npz or .pkl, recognised by content; sizes are checked before reading."""

from collections.abc import Collection
from pathlib import Path

from hfb.errors import InputError
from hfb.io.array_files import UNPACKED_LIMIT, names_in
from hfb.io.array_files import read_arrays as read_arrays_of
from hfb.io.safe.contents import text_of
from hfb.io.safe.pickle_reader import load_pickle
from hfb.io.safe.pickle_stream import Steps
from hfb.io.safe.pickled_arrays import to_array
from hfb.typing import Array, Shaped

MAX_BYTES = UNPACKED_LIMIT


def read_arrays(path: Path, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], frozenset[str]]:
    """Return the wanted arrays that the file has, and the names of everything in it.

    Args:
        path: .npz or .pkl.
        wanted: names.

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
    names = {text_of(name): value for name, value in content.items()}
    return {name: to_array(value) for name, value in names.items() if name in wanted}, frozenset(names)


def _from_zip(data: bytes, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], frozenset[str]]:
    steps = Steps(len(data))
    try:
        arrays = read_arrays_of(data, wanted, MAX_BYTES, lambda pickled: to_array(load_pickle(pickled, steps)))
        names = names_in(data)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error
    if any(array.dtype.kind not in "fiub" for array in arrays.values()):
        raise InputError("it holds an array of things that are not numbers")
    return arrays, frozenset(names)
