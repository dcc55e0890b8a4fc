"""How the kernels are compiled: once per machine, whatever the process, and again when any of their sources changes."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from hashlib import sha256
from pathlib import Path

from numba import njit
from numba.core.caching import FunctionCache

JIT = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
# Loops compiled without reference counting: numba would count every array at every call within the loops, half
# of the time spent. Such functions must not allocate; the entry points that call them do.
LOOP = {**JIT, "_nrt": False}
INLINE = {**LOOP, "forceinline": True}

_SOURCES = sha256(b"".join(p.read_bytes() for p in sorted(Path(__file__).parent.glob("kernels*.py")))).hexdigest()


class _SourcesCache(FunctionCache):
    """Numba's own cache looks at the file of the cached function only; its callees here live in several."""

    def _index_key(self, sig, codegen):
        return (*super()._index_key(sig, codegen), _SOURCES)


def entry(function):
    """Compile a function that Python calls, and keep the machine code beside it or in the user's cache."""
    compiled = njit(**JIT)(function)
    compiled._cache = _SourcesCache(function)
    return compiled


def loop_entry(function):
    """`entry` for a function that allocates nothing."""
    compiled = njit(**LOOP)(function)
    compiled._cache = _SourcesCache(function)
    return compiled
