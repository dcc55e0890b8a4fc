"""Compilation and caching of kernels: once per machine, and again when any of their sources changes.

All compiled code is in this package and has one hash, which names its cache folder: another clone, or a package that
was moved, uses the kernels of the same sources; a change in any file compiles all of them again.
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
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import llvmlite
import numba
import platformdirs
from filelock import FileLock, Timeout
from numba import config, njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator

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

READY = Path(__file__).parent / "ready_made"
"""Kernels of the package (`hfb.kernels.ready`), as trusted as its sources; a user's own come first."""


@lru_cache
def sources_folder() -> str:
    """Return the name of the folder for all that determines machine code but the CPU (which numba's index tells)."""
    files = sorted(Path(__file__).parent.rglob("*.py"))
    versions = f"{numba.__version__} {llvmlite.__version__}".encode()
    return f"hfb-{sha256(versions + b''.join(file.read_bytes() for file in files)).hexdigest()[:16]}"


_DAMAGED = OSError, EOFError, pickle.UnpicklingError, ValueError, LookupError, AttributeError, ImportError, RuntimeError
_KEPT_DAYS = 60
_LOCKED_S = 300.0  # far longer than one kernel takes: the lock's owner has died by then
_log = logging.getLogger(__name__)


class _SourcesLocator(_CacheLocator):
    """The cache folder of a function's machine code, named by the hash of the sources, not by their place."""

    def __init__(self, folder: Path, py_func, py_file):
        self._folder, self._py_file = folder, py_file
        self._line = py_func.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func, py_file):
        for place in _places(Path(py_file)):
            with suppress(OSError):
                return cls(_prepared(place), py_func, py_file)
        return None

    def get_cache_path(self):
        return str(self._folder)

    def get_source_stamp(self):
        return sha256(sources_folder().encode() + Path(self._py_file).read_bytes()).hexdigest()

    def get_disambiguator(self):
        return str(self._line)


def _places(file: Path) -> Iterator[Path]:
    """Yield folders for machine code, the preferred one first."""
    if config.CACHE_DIR:
        yield Path(config.CACHE_DIR)
    yield platformdirs.user_cache_path("hfb") / "kernels"
    yield file.parent / "__pycache__"


@lru_cache
def _prepared(place: Path) -> Path:
    """Return the sources' folder in a writable place; folders that were not used lately are removed."""
    folder = place / sources_folder()
    folder.mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()
    os.utime(folder)
    unused = time.time() - _KEPT_DAYS * 86400
    for other in place.glob("hfb-" + "?" * 16):
        with suppress(OSError):
            if other.stat().st_mtime < unused:
                shutil.rmtree(other)
    return folder


class _SourcesCacheImpl(CompileResultCacheImpl):
    _locator_classes = (_SourcesLocator,)


class _SourcesCache(FunctionCache):
    """A cache for functions whose callees are in several files; numba's own checks only the function's file.

    It is in `NUMBA_CACHE_DIR`, the user's cache, beside the sources, or else in a temporary folder; a damaged one is
    rebuilt. What is not there may be among the package's ready-made kernels, which are only read: of other sources, for
    another processor or damaged they are none. Of several processes that need a kernel that is not compiled yet, one
    compiles it.

    Attributes:
        waits: for a kernel that another process compiles; else `load_overload` raises Timeout.
    """

    _impl_class = _SourcesCacheImpl
    waits = True

    def __init__(self, function):
        try:
            super().__init__(function)
        except RuntimeError:  # no folder can be written
            _use_temporary_folder()
            super().__init__(function)
        made = self._impl.filename_base, self._impl.locator.get_source_stamp()
        self._ready_file = IndexDataCacheFile(str(READY / sources_folder()), *made)
        self._lock = None

    def knows(self, sig, target_context):
        """Return whether a kernel is kept, or ready, for this processor."""
        key = self._index_key(sig, target_context.codegen())
        return any(key in _index(file) for file in (self._cache_file, self._ready_file))

    def load_overload(self, sig, target_context):
        found = self._loaded(sig, target_context)
        if found is not None:
            return found
        # made now: a forked process may not use its parent's
        self._lock = FileLock(Path(self._cache_path) / f"{self._impl.filename_base}.lock", thread_local=False)
        try:
            self._lock.acquire(timeout=_LOCKED_S if self.waits else 0)
        except (OSError, NotImplementedError) as error:  # Timeout is an OSError
            if isinstance(error, Timeout) and not self.waits:
                raise
            _log.info("%s: compiled without a lock (%s)", self._name, error)
            return None
        found = self._loaded(sig, target_context)
        if found is not None:  # another process has compiled it meanwhile
            self._unlock()
        return found

    def _unlock(self):
        if self._lock is not None:
            self._lock.release(force=True)
            self._lock = None

    def _loaded(self, sig, target_context):
        try:
            found = super().load_overload(sig, target_context)
        except _DAMAGED as error:
            _log.info("%s: compiled again, since its cache cannot be read (%s)", self._name, error)
            with suppress(OSError):
                self.flush()
            found = None
        if found is None:
            with suppress(*_DAMAGED):
                data = self._ready_file.load(self._index_key(sig, target_context.codegen()))
                found = data and self._impl.rebuild(target_context, data)
        return found

    def save_overload(self, sig, data):
        try:
            super().save_overload(sig, data)
        except _DAMAGED as error:
            _say_once(f"kernels are compiled again next time, since they cannot be kept ({error})")
            self.disable()
        finally:
            self._unlock()


def _index(file):
    """Return the kernels that an index tells of; none where it cannot be read."""
    with suppress(*_DAMAGED):
        return file._load_index()
    return {}


_entries = []


def _cached(compiled, function):
    with suppress(RuntimeError):  # no temporary folder either: compiled by every process
        compiled._cache = _SourcesCache(function)
        _entries.append(compiled)
    return compiled


def load_cached():
    """Load the machine code of all imported kernels that is kept or ready; yields after each, compiles nothing."""
    for compiled in _entries:
        cache = compiled._cache
        for sig, *_ in {**_index(cache._ready_file), **_index(cache._cache_file)}:
            if cache.knows(sig, compiled.targetctx):
                with suppress(*_DAMAGED):
                    compiled.compile(sig)
                yield


def compile_unless_taken(compiled, sig):
    """Compile a kernel that is neither kept nor ready, unless another process does so now.

    Args:
        compiled: a kernel.
        sig: types of its arguments.
    """
    if not compiled._cache.knows(sig, compiled.targetctx):
        compiled._cache.waits = False
        with suppress(Timeout):
            compiled.compile(sig)


def _use_temporary_folder():
    """Keep kernels in a temporary folder of this user; processes that this one starts do the same."""
    try:
        folder = _private_folder()
    except OSError:
        _say_once("kernels are compiled again by every process, since no folder can be written: set NUMBA_CACHE_DIR")
        return
    keep_in(folder)
    _say_once(f"kernels are kept in {folder} only, since no cache folder can be written: set NUMBA_CACHE_DIR to one")


def keep_in(folder):
    """Keep the kernels of this process, and of those that it starts, in a folder.

    Args:
        folder: of any name.
    """
    config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(folder)


def _private_folder():
    """Return a folder that only this user can write, since its content is executed."""
    if hasattr(os, "getuid"):
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
    """Compile a function that Python calls, and cache the machine code for later processes.

    Args:
        function: function to compile.
    """
    return _cached(njit(**JIT)(function), function)


def loop_entry(function):
    """Apply `entry` to a function that allocates nothing.

    Args:
        function: function to compile.
    """
    return _cached(njit(**LOOP)(function), function)


def sum_entry(function):
    """Apply `loop_entry`, and let the compiler reorder sums.

    Args:
        function: function to compile.
    """
    return _cached(njit(**_SUM)(function), function)
