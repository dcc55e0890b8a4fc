"""Named arrays from files of unknown origin: nothing is unpickled, sizes are checked before anything is read."""

import io
import zipfile
from collections.abc import Collection
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.shapes import Array, Shaped

_MAX_BYTES = 512 << 20
_MAX_MEMBERS = 10_000


def read_npz(path: Path, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], list[str]]:
    """(the wanted numeric arrays that the file has, the names of everything in it).

    Raises:
        InputError: no archive, a damaged one, a wanted array that is too large or holds no numbers.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if len(archive.infolist()) > _MAX_MEMBERS:
                raise InputError(f"it has more than {_MAX_MEMBERS} members")
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            chosen = {name: info for name, info in members.items() if name in wanted}
            if sum(info.file_size for info in chosen.values()) > _MAX_BYTES:
                raise InputError(f"unpacked it would be larger than {_MAX_BYTES >> 20} MB")
            arrays = {}
            for name, info in chosen.items():
                with archive.open(info) as member:
                    arrays[name] = _parse(member.read(info.file_size), name)
            return arrays, sorted(members)
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}; export it again with numpy.savez") from error
    except FileNotFoundError:
        raise InputError(f"there is no file {path}; give a motion file") from None
    except Exception as error:  # a broken archive makes zipfile and numpy raise nearly anything
        raise InputError(
            f"{path} is not a readable .npz archive ({type(error).__name__}; cut off, or another kind of file?); "
            "download or export it again"
        ) from error


def read_npy(path: Path) -> Shaped[Array, "..."]:
    """One array of numbers from a .npy file.

    Raises:
        InputError: unreadable, damaged, too large or not numbers.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"it is larger than {_MAX_BYTES >> 20} MB")
        return _parse(path.read_bytes(), path.stem)
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}; export it again with numpy.save") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path} is not a readable .npy file ({error}); download or export it again") from error


def _parse(data: bytes, name: str) -> Shaped[Array, "..."]:
    """The array in the bytes of a .npy file; numpy's own reader would run a pickled one."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(stream)
    if dtype.hasobject or dtype.kind not in "fiu":
        raise InputError(f"its {name!r} holds no plain numbers but {dtype}")
    rest = memoryview(data)[stream.tell() :]
    if len(rest) != int(np.prod(shape, dtype=np.float64)) * dtype.itemsize:
        raise InputError(f"the bytes of its {name!r} do not fit its shape {shape}")
    return np.frombuffer(rest, dtype).reshape(shape, order="F" if fortran else "C").astype(dtype.newbyteorder("="))
