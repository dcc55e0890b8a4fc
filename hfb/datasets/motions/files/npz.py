"""Named arrays of numbers from motion files of unknown origin."""

from collections.abc import Collection
from pathlib import Path

from hfb.errors import InputError
from hfb.io.array_files import UNPACKED_LIMIT, names_in, parse_array, read_arrays
from hfb.typing import Array, Shaped


def read_npz(path: Path, wanted: Collection[str]) -> tuple[dict[str, Shaped[Array, "..."]], list[str]]:
    """Return the wanted numeric arrays that the file has, and the names of everything in it.

    Args:
        path: the .npz file.
        wanted: names of arrays to read.

    Raises:
        InputError: no archive, a damaged one, a wanted array that is too large or holds no numbers.
    """
    try:
        arrays = read_arrays(path, wanted)
        for name, array in arrays.items():
            _check_numbers(array, name)
        return arrays, sorted(names_in(path))
    except FileNotFoundError:
        raise InputError(f"there is no file {path}; give a motion file") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be used: {error}; download it, or export it with numpy.savez, again"
        ) from error


def read_npy(path: Path) -> Shaped[Array, "..."]:
    """Read one array of numbers from a .npy file.

    Args:
        path: the .npy file.

    Raises:
        InputError: unreadable, damaged, too large or not numbers.
    """
    try:
        if path.stat().st_size > UNPACKED_LIMIT:
            raise ValueError(f"it is larger than {UNPACKED_LIMIT >> 20} MB")
        array = parse_array(path.read_bytes())
        _check_numbers(array, path.stem)
        return array
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be used: {error}; download it, or export it with numpy.save, again") from error


def _check_numbers(array: Shaped[Array, "..."], name: str) -> None:
    if array.dtype.kind not in "fiu":
        raise ValueError(f"its {name!r} holds no plain numbers but {str(array.dtype)[:40]}")
