"""What stands for the objects of a pickle: nothing but the values they were made with."""

from typing import Any

from hfb.errors import InputError


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
        super().__init__(arguments[0] if arguments and isinstance(arguments[0], list) else ())
