"""What stands for the objects of a pickle: nothing but the values they were made with."""

from collections.abc import Sequence
from typing import Any

from hfb.errors import InputError

_MAX_KEY = 1 << 60


class Placeholder:
    """An object of a class that is never imported: what it was called with, and its state."""

    kind = "object"
    arguments: tuple[Any, ...] = ()
    state: Any = None

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def field(self, *names: str) -> Any:
        """The first of these attributes that the pickled object had."""
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
    """Stands for joblib's NumpyArrayWrapper; the array's bytes lie in the stream right behind it.

    Attributes:
        data: the bytes, not copied; the pickled list of objects where the array is one of objects.
    """

    kind = "joblib array"
    data: Any = b""


class TorchStorage(Placeholder):
    """Stands for a storage of torch: `code` says what numbers, `data` gives their bytes."""

    kind = "torch storage"
    code = ""
    data: bytes | memoryview = b""


class TorchTensor(Placeholder):
    """Stands for a tensor: called with storage, offset, sizes, strides."""

    kind = "torch tensor"


class PlainDict(dict[Any, Any]):
    """Stands for OrderedDict and defaultdict; attributes that hang on it are dropped."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(())
        if arguments and isinstance(arguments[0], list):
            check_keys([pair[0] for pair in arguments[0]])
            self.update(arguments[0])


def check_keys(keys: Sequence[Any]) -> None:
    """Texts and numbers: large integers, floats and tuples can be chosen so that a dictionary's time is quadratic.

    Raises:
        InputError: a key is something else.
    """
    for key in keys:
        if not isinstance(key, str | bytes | Placeholder | type | None) and not (
            isinstance(key, int) and abs(key) < _MAX_KEY
        ):
            raise InputError(f"it holds a dictionary with a {type(key).__name__} for a key")
