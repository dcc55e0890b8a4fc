"""Reading of .npz and .npy files of unknown origin: sizes are checked first, and nothing is unpickled."""

import io
import math
import zipfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hfb.typing import Array, Shaped

UNPACKED_LIMIT = 512 << 20
"""Bytes of all arrays that are read from one file; with a copy and the file itself they stay below 2 GB."""

_FILE_LIMIT, _MEMBER_LIMIT, _NAME_LIMIT = 1 << 30, 10_000, 1000
_NUMBERS_AND_TEXTS = "fiubUS"

Objects = Callable[[bytes], Any]
"""A reader of the pickle in an array of objects, e.g. `hfb.io.safe.pickle_reader.load_pickle`."""


def read_arrays(
    file: Path | bytes,
    wanted: Collection[str] | None = None,
    limit: int = UNPACKED_LIMIT,
    objects: Objects | None = None,
) -> dict[str, Any]:
    """Read the arrays of numbers and texts in an .npz archive, by name.

    Args:
        file: the archive, on disk or in memory.
        wanted: only these, as far as the file has them; all of them if not given.
        limit: most bytes of the unpacked arrays.
        objects: reads the pickle of an array of objects; without it such an array is an error.

    Raises:
        OSError: no file there, or it cannot be read.
        ValueError: no archive, a damaged one, one that unpacks to more than `limit` bytes, an array of objects; and
            whatever `objects` raises.
    """
    with _opened(file) as archive:
        members = {name: info for name, info in _members(archive).items() if wanted is None or name in wanted}
        if sum(info.file_size for info in members.values()) > limit:
            raise ValueError(f"unpacked it would be larger than {limit >> 20} MB")
        return {name: parse_array(_content(archive, info), objects) for name, info in members.items()}


def names_in(file: Path | bytes) -> tuple[str, ...]:
    """Return the names of an .npz archive's arrays. Raises OSError or ValueError as `read_arrays`.

    Args:
        file: the archive, on disk or in memory.
    """
    with _opened(file) as archive:
        return tuple(_members(archive))


def weights_file(path: Path) -> io.BytesIO:
    """Copy a file of torch.save to memory for torch.load, which would inflate packed members without a limit.

    torch compresses nothing. An archive is written anew from the checked members, since two readers of archives may
    find different ones in the same bytes.

    Args:
        path: the file.

    Raises:
        OSError: no file there, or it cannot be read.
        ValueError: too large, or a damaged archive, one with packed members, or with more than its own size.
    """
    if path.stat().st_size > _FILE_LIMIT:
        raise ValueError(f"it is larger than {_FILE_LIMIT >> 20} MB")
    with path.open("rb") as file:
        is_archive = file.read(2) == b"PK"
    if not is_archive and not zipfile.is_zipfile(path):
        return io.BytesIO(path.read_bytes())
    written = io.BytesIO()
    with _opened(path) as archive, zipfile.ZipFile(written, "w", zipfile.ZIP_STORED) as copy:
        members = _members(archive)
        if any(info.compress_type != zipfile.ZIP_STORED for info in members.values()):
            raise ValueError("its contents are compressed, as torch never does: save it again with torch.save")
        if sum(info.file_size for info in members.values()) > path.stat().st_size:
            raise ValueError("it is damaged: it announces more than it has")
        if any(len(name) > _NAME_LIMIT for name in members):
            raise ValueError("it is damaged: it has a member with an endless name")
        for info in members.values():
            copy.writestr(zipfile.ZipInfo(info.filename), _content(archive, info))
    written.seek(0)
    return written


def _opened(file: Path | bytes) -> zipfile.ZipFile:
    if isinstance(file, Path) and file.stat().st_size > _FILE_LIMIT:
        raise ValueError(f"it is larger than {_FILE_LIMIT >> 20} MB")
    if isinstance(file, Path) and not file.is_file():  # opening a pipe would block
        raise ValueError("it is no plain file")
    try:
        return zipfile.ZipFile(io.BytesIO(file) if isinstance(file, bytes) else file)
    except OSError:
        raise
    except Exception as error:  # a broken archive makes zipfile raise nearly anything
        raise ValueError(f"it is not a readable archive ({type(error).__name__})") from error


def _members(archive: zipfile.ZipFile) -> Mapping[str, zipfile.ZipInfo]:
    found = archive.infolist()
    if len(found) > _MEMBER_LIMIT:
        raise ValueError(f"it has more than {_MEMBER_LIMIT} members")
    return {info.filename.removesuffix(".npy"): info for info in found}


def _content(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Read a member's bytes, never more than its announced size."""
    try:
        with archive.open(info) as member:
            content = member.read(info.file_size)
    except Exception as error:  # unpackers raise their own kinds, for passwords and unknown methods too
        raise ValueError(f"it is damaged: a member cannot be unpacked ({type(error).__name__})") from error
    if len(content) != info.file_size:
        raise ValueError("it is damaged: a member is cut off")
    return content


def parse_array(data: bytes, objects: Objects | None = None) -> Any:
    """Parse a .npy file; numpy's own reader would allocate what a header promises.

    Args:
        data: content of a .npy file.
        objects: see `read_arrays`.

    Raises:
        ValueError: no such file, a damaged one, or an array of something other than numbers and texts.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read_header(stream)
    except Exception as error:  # the header is a Python literal: a broken one makes the parser raise nearly anything
        raise ValueError("it holds an array without a readable header") from error
    rest = memoryview(data)[stream.tell() :]
    if dtype.hasobject and objects is not None:
        return objects(bytes(rest))
    if dtype.kind not in _NUMBERS_AND_TEXTS or not dtype.itemsize:
        raise ValueError(f"it holds no plain numbers but {str(dtype)[:40]}")
    if any(isinstance(side, bool) or side < 0 for side in shape) or len(rest) != math.prod(shape) * dtype.itemsize:
        raise ValueError("it holds an array whose bytes do not fit its shape")
    try:
        array: Shaped[Array, ...] = np.frombuffer(rest, dtype).reshape(shape, order="F" if fortran else "C")
        return array.astype(dtype.newbyteorder("="))
    except MemoryError as error:
        raise ValueError("it needs more memory than there is") from error
    except (ValueError, TypeError, OverflowError) as error:  # sides beyond what numpy counts, beside one of zero
        raise ValueError("it holds an array of an impossible shape") from error
