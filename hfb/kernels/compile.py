"""How kernels are compiled: once per machine, whatever the process, and again when any of their sources changes.

All compiled code lives in this room. Its sources have one hash: a change in any file compiles all kernels again.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import atexit
import logging
import os
import pickle
import shutil
import stat
import tempfile
from contextlib import suppress
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from numba import config, njit
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
def _sources() -> str:
    files = sorted(Path(__file__).parent.rglob("*.py"))
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


_DAMAGED = OSError, EOFError, pickle.UnpicklingError, ValueError, LookupError, AttributeError, ImportError, RuntimeError
_log = logging.getLogger(__name__)


class _SourcesCache(FunctionCache):
    """Numba's own cache looks at the file of the cached function only; its callees here live in several.

    It goes beside the sources, into the user's cache, or else into a temporary folder; a damaged one is made again.
    """

    def __init__(self, function):
        try:
            super().__init__(function)
        except RuntimeError:  # no folder can be written
            _use_temporary_folder()
            super().__init__(function)

    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except _DAMAGED as error:
            _log.info("%s: compiled again, since its cache cannot be read (%s)", self._name, error)
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data):
        try:
            super().save_overload(sig, data)
        except _DAMAGED as error:
            _say_once(f"kernels are compiled again next time, since they cannot be kept ({error})")
            self.disable()

    def _index_key(self, sig, codegen):
        return (*super()._index_key(sig, codegen), _sources())


def _cached(compiled, function):
    with suppress(RuntimeError):  # no temporary folder either: compiled by every process
        compiled._cache = _SourcesCache(function)
    return compiled


def _use_temporary_folder():
    """Keep kernels in a temporary folder of this user; processes that this one starts do the same."""
    try:
        folder = _private_folder()
    except OSError:
        _say_once("kernels are compiled again by every process, since no folder can be written: set NUMBA_CACHE_DIR")
        return
    config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(folder)
    _say_once(f"kernels are kept in {folder} only, since no cache folder can be written: set NUMBA_CACHE_DIR to one")


def _private_folder():
    """A folder that nobody else can write: what lies in it is run."""
    folder = Path(tempfile.gettempdir()) / f"hfb-kernels-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077:
        return folder
    made = tempfile.mkdtemp(prefix="hfb-kernels-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


@lru_cache
def _say_once(remark):
    _log.warning(remark)


def entry(function):
    """Compile a function that Python calls, and keep the machine code beside it or in the user's cache."""
    return _cached(njit(**JIT)(function), function)


def loop_entry(function):
    """`entry` for a function that allocates nothing."""
    return _cached(njit(**LOOP)(function), function)


def sum_entry(function):
    """`loop_entry` whose sums the compiler may add in another order than written."""
    return _cached(njit(**_SUM)(function), function)
