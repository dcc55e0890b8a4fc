"""Placeholders of a pickle's objects, which hold only their constructor's values, and of its functions."""

from collections.abc import Sequence
from typing import Any

from hfb.errors import InputError

_MAX_KEY = 1 << 60
_MAX_KEY_TEXT = 1 << 12  # a longer one would be compared, letter by letter, each time it is set again


class Placeholder:
    """An object of a class that is never imported: its constructor's arguments, and its state."""

    kind = "object"
    arguments: Sequence[Any] = ()
    state: Any = None

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def field(self, *names: str) -> Any:
        """Return the first of these attributes that the pickled object had.

        Args:
            *names: names of attributes.

        Raises:
            InputError: it had none.
        """
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


class JoblibArray(Placeholder):
    """Stands for joblib's NumpyArrayWrapper; the array's bytes follow it in the stream.

    Attributes:
        data: the bytes, not copied; the pickled list of objects where the array is one of objects.
    """

    kind = "joblib array"
    data: Any = b""


class TorchStorage(Placeholder):
    """Stands for a storage of torch: `code` is the type of its numbers, `data` gives their bytes."""

    kind = "torch storage"
    code = ""
    data: bytes | memoryview = b""


class TorchTensor(Placeholder):
    """Stands for a tensor: called with storage, offset, sizes, strides."""

    kind = "torch tensor"


class PlainDict(dict[Any, Any]):
    """Stands for OrderedDict and defaultdict; additional attributes are dropped."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(())
        if arguments and isinstance(arguments[0], list):
            check_keys([pair[0] for pair in arguments[0]])
            self.update(arguments[0])


def check_keys(keys: Sequence[Any]) -> None:
    """Check a dictionary's keys: texts, numbers, and pairs of a text and a number are accepted.

    Large integers, floats and other tuples can be chosen so that a dictionary's time is quadratic. A text's hash is
    secret, and beside the same text no two numbers have the same.

    Args:
        keys: keys of the dictionary.

    Raises:
        InputError: a key is something else.
    """
    for key in keys:
        paired = type(key) is tuple and len(key) == 2 and isinstance(key[0], str)
        text, number = key if paired else (key, key)
        if isinstance(text, str | bytes) and len(text) > _MAX_KEY_TEXT:
            raise InputError(f"it holds a dictionary with a key of {len(text)} letters")
        if paired or not isinstance(key, str | bytes | Placeholder | type | None):
            check_number(number)


def check_number(key: Any) -> None:
    """Check that a number is below the limit up to which integers are their own hash.

    Args:
        key: key of a dictionary.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(key, int) or abs(key) >= _MAX_KEY:
        raise InputError(f"it holds a dictionary with a {type(key).__name__} for a key")


def reconstruct(*_arguments: Any) -> NumpyArray:
    """Stand for numpy's constructor of empty arrays, whose state follows.

    Args:
        *_arguments: ignored.
    """
    return NumpyArray()


def from_buffer(data: Any, dtype: Any, shape: Any, order: Any) -> NumpyArray:
    """Stand for numpy's constructor of arrays in pickles of protocol 5.

    Args:
        data: bytes of the array.
        dtype: placeholder of the type.
        shape: sides.
        order: C or F.
    """
    array = NumpyArray()
    array.state = (shape, dtype, order == "F", data)
    return array


def encode(text: Any, encoding: Any = "latin1") -> bytes:
    """Encode text as pickles of Python 2 store bytes.

    Args:
        text: text to encode.
        encoding: Latin-1.

    Raises:
        InputError: no text, or another encoding.
    """
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1", "iso-8859-1"):
        raise InputError("it encodes text in an unexpected way")
    return text.encode("latin1")


def raw_bytes(data: Any = b"", encoding: Any = "latin1") -> bytes:
    """Stand for bytes() and bytearray(), but never of a bare size.

    Args:
        data: bytes, or text.
        encoding: encoding of a text.

    Raises:
        InputError: it was given something else.
    """
    if isinstance(data, str):
        return encode(data, encoding)
    if not isinstance(data, (bytes, bytearray)):
        raise InputError("it holds an array without its bytes")
    return bytes(data)


def new_object(cls: Any, *_arguments: Any) -> Any:
    """Stand for the constructor of old pickles' objects.

    Args:
        cls: placeholder class.
        *_arguments: ignored.

    Raises:
        InputError: of a class that is none of ours.
    """
    if not (isinstance(cls, type) and issubclass(cls, Placeholder | PlainDict)):
        raise InputError("it builds an unexpected object")
    return cls()


def nothing(*_arguments: Any) -> None:
    """Stand for sets and the like, which chumpy keeps beside its values; they are not used.

    Args:
        *_arguments: ignored.
    """


def size_of(values: Any = ()) -> tuple[object, ...]:
    """Stand for torch.Size.

    Args:
        values: sides.

    Raises:
        InputError: it was given no row of sides.
    """
    if not isinstance(values, list | tuple):
        raise InputError("it holds a size that is none")
    return tuple(values)


def parameter(tensor: Any = None, *_arguments: Any) -> Any:
    """Stand for torch's parameters, which are read as their tensors.

    Args:
        tensor: placeholder.
        *_arguments: ignored.
    """
    return tensor
