"""The byte stream of a pickle, with a limit on the work of reading it."""

import io
from typing import Any

from hfb.errors import InputError

_MAX_ITEM_BYTES = 1 << 16
_MAX_SIDES, _MAX_SIDE = 32, 1 << 62
_LEAST_STEPS, _STEPS_PER_BYTE = 3_000_000, 4  # PHALP, compressed: 458 steps in 300 bytes per person and frame
_BYTES_PER_STEP = 1 << 12  # that a call copies


class Steps:
    """The number of steps that reading one file may take, shared by all its pickles and those within them.

    Args:
        file_bytes: size of the file on disk; its unpacked content may have any size.
    """

    def __init__(self, file_bytes: int) -> None:
        self.left = _LEAST_STEPS + _STEPS_PER_BYTE * file_bytes

    def take(self, count: int) -> None:
        """Subtract steps from those left.

        Args:
            count: number of steps.

        Raises:
            InputError: there are not so many left.
        """
        self.left -= count
        if self.left < 0:
            raise self.spent()

    def spent(self) -> InputError:
        """Build the error for no steps left."""
        return InputError(
            "it takes millions of steps to read, far more than a file of arrays of its size: save it without masks "
            "and features, or split it into shorter files"
        )


class Bytes(io.BytesIO):
    """A stream over bytes in memory that returns parts without a copy.

    Args:
        data: content.
        steps: limit of the work; by default that of a file of these bytes.
    """

    def __init__(self, data: bytes, steps: Steps | None = None) -> None:
        super().__init__(data)
        self._whole = memoryview(data)
        self.steps = Steps(len(data)) if steps is None else steps

    def room(self) -> int:
        """Return the number of bytes to come."""
        return len(self._whole) - self.tell()

    def view(self, size: int) -> memoryview:
        """Return the next bytes.

        Args:
            size: number of bytes.

        Raises:
            InputError: there are not so many.
        """
        start = self.tell()
        if not 0 <= size <= self.room():
            raise InputError("it is cut off")
        self.seek(start + size)
        return self._whole[start : start + size]


def weight_of(argument: Any) -> int:
    """Return the steps that a function spends on an argument.

    Args:
        argument: argument of the function.
    """
    if isinstance(argument, list | tuple | dict):
        return len(argument)
    return len(argument) // _BYTES_PER_STEP if isinstance(argument, str | bytes | bytearray) else 0


def sides_of(shape: Any) -> tuple[int, ...]:
    """Check the sides of an array in a pickle: a text among them would be repeated, not multiplied.

    Args:
        shape: as the pickle has it.

    Raises:
        InputError: something else, or beyond what any array has.
    """
    if not isinstance(shape, tuple) or len(shape) > _MAX_SIDES:
        raise InputError("it holds an array of an impossible shape")
    if not all(type(side) is int and 0 <= side <= _MAX_SIDE for side in shape):
        raise InputError("it holds an array of an impossible shape")
    return shape


def item_bytes(code: Any) -> int:
    """Return the bytes of one entry of numpy's type code, such as "f4" or "U12".

    Args:
        code: text or bytes.

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
