"""How kernels are compiled: once per machine, whatever the process, and again when any of their sources changes.

Kernels live in files called kernels*.py; a change in any of a room's makes all of that room's compile again.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from numba import njit
from numba.core.caching import FunctionCache

JIT = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
# Loops compiled without reference counting: numba would count every array at every call within the loops, half
# of the time spent. Such functions must not allocate; the entry points that call them do.
LOOP = {**JIT, "_nrt": False}
INLINE = {**LOOP, "forceinline": True}
# Sums whose order the compiler may choose, to add several numbers at once. It chooses by what surrounds them, so they
# are part of the entry that calls them: a process that compiles has callees by themselves, too, and its linker takes
# these, where one that loads has the entry's own copies. The first run on a machine would differ from the second.
_SUM = {**LOOP, "fastmath": {"contract", "reassoc"}}
SUM_INLINE = {**_SUM, "forceinline": True}


@lru_cache
def _sources(folder: Path) -> str:
    files = (*sorted(folder.glob("kernels*.py")), Path(__file__), Path(__file__).with_name("vector_code.py"))
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _SourcesCache(FunctionCache):
    """Numba's own cache looks at the file of the cached function only; its callees here live in several."""

    def _index_key(self, sig, codegen):
        return (*super()._index_key(sig, codegen), _sources(Path(self._py_func.__code__.co_filename).parent))


def _cached(compiled, function):
    compiled._cache = _SourcesCache(function)
    return compiled


def entry(function):
    """Compile a function that Python calls, and keep the machine code beside it or in the user's cache."""
    return _cached(njit(**JIT)(function), function)


def loop_entry(function):
    """`entry` for a function that allocates nothing."""
    return _cached(njit(**LOOP)(function), function)


def sum_entry(function):
    """`loop_entry` whose sums the compiler may add in another order than written."""
    return _cached(njit(**_SUM)(function), function)
