"""Access to folders of unknown origin: symbolic links and special files are refused, never followed.

The folder that a user names may itself be a link or lie below one. Below it, every component of a path is opened with
O_NOFOLLOW relative to the descriptor of its parent, and a file must be a regular file: a named pipe would block, a
device may act when it is opened.
"""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from hfb.errors import InputError, TemporaryError

_FOLDER = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)
_DEEPEST = 32  # levels; hfb itself makes four
_KINDS = {
    stat.S_IFLNK: "symbolic link",
    stat.S_IFIFO: "named pipe",
    stat.S_IFSOCK: "socket",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
}


class NotOrdinary(TemporaryError):
    """A symbolic link or a special file is where hfb would open, list or remove something."""


def check_system() -> None:
    """Raise InputError where the system opens no file relative to a folder's descriptor, as Windows."""
    if os.open not in os.supports_dir_fd:
        raise InputError(
            "hfb reads and writes folders of results on Linux and macOS only: on Windows run it in WSL (wsl --install)"
        )


def special_kind(path: Path) -> str | None:
    """Name what a path is that is neither a regular file nor a folder; None for these two and for a missing one.

    Args:
        path: the file or folder.
    """
    try:
        return _KINDS.get(stat.S_IFMT(path.lstat().st_mode))
    except OSError:
        return None


def is_regular(path: Path) -> bool:
    """Return whether `path` is a regular file, not a link to one.

    Args:
        path: the file or folder.
    """
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def check_ordinary(root: Path, *parts: str) -> None:
    """Check every component of a path below ``root``; a missing one ends the check.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.

    Raises:
        NotOrdinary: one of them is a link or a special file.
    """
    place = root
    for part in parts:
        place = place / part
        if (kind := special_kind(place)) is not None:
            raise _refused(place, kind)


def check_tree(root: Path, *parts: str) -> None:
    """Check a folder below ``root`` and everything in it; a missing folder passes.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.

    Raises:
        NotOrdinary: a link or a special file, or folders nested more deeply than hfb nests any.
    """
    check_ordinary(root, *parts)
    top = root.joinpath(*parts)
    for entry in entries_below(top) if top.is_dir() else ():
        check_ordinary(entry.parent, entry.name)


def entries_below(folder: Path) -> Iterator[Path]:
    """Yield everything in a folder and in the folders below it that is no folder itself; links are not followed.

    Args:
        folder: folder to list.

    Raises:
        NotOrdinary: folders are nested more deeply than hfb nests any, or may not be read.
    """
    waiting = [(folder, 0)]
    while waiting:
        here, depth = waiting.pop()
        try:
            entries = list(os.scandir(here))
        except FileNotFoundError:  # removed meanwhile
            continue
        except OSError as error:
            raise NotOrdinary(f"{here} cannot be read: {error.strerror}") from None
        if depth > _DEEPEST:
            raise NotOrdinary(f"{folder} holds folders nested more than {_DEEPEST} deep: remove them")
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                waiting.append((here / entry.name, depth + 1))
            else:
                yield here / entry.name


@contextmanager
def open_folder(root: Path, *parts: str, make: bool = False) -> Iterator[int]:
    """Open a folder below ``root`` without following a link; yield its descriptor.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.
        make: create the folders below ``root`` that are missing.

    Raises:
        NotOrdinary: a component below ``root`` is a link or no folder.
        OSError: ``root`` or a component is missing, or may not be opened.
        InputError: see `check_system`.
    """
    check_system()
    place, descriptor = root, os.open(root, _FOLDER)
    try:
        for part in parts:
            place = place / part
            if make:
                _make(part, descriptor)
            inner = _inner_folder(place, part, descriptor)
            os.close(descriptor)
            descriptor = inner
        yield descriptor
    finally:
        os.close(descriptor)


def open_lock(root: Path, *parts: str) -> int:
    """Open a lock file below ``root`` for appending; create it where it is missing.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.

    Raises:
        NotOrdinary: it, or a folder on the way, is a link or a special file.
        OSError: it may not be written.
    """
    *folders, name = parts
    check_ordinary(root, *parts)
    with open_folder(root, *folders) as folder:
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        return _checked(root.joinpath(*parts), name, flags, folder)


def read_file(root: Path, *parts: str, limit: int) -> bytes:
    """Read a regular file below ``root``.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.
        limit: most bytes.

    Raises:
        NotOrdinary: it, or a folder on the way, is a link or a special file.
        FileNotFoundError: it is missing.
        InputError: it is larger than ``limit`` bytes.
        OSError: it cannot be read.
    """
    content = read_head(root, *parts, size=limit + 1)
    if len(content) > limit:
        raise InputError(f"{Path(root, *parts)} is too large: more than {limit:,} bytes; move it away")
    return content


def read_head(root: Path, *parts: str, size: int) -> bytes:
    """Read the first ``size`` bytes of a regular file below ``root``, or all there are; raises as `read_file`.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.
        size: number of bytes.
    """
    with open_file(root, *parts) as file:
        return file.read(size)


def copy_file(root: Path, *parts: str, to: Path) -> Path:
    """Copy a regular file below ``root`` for a library that opens files by path; raises as `read_file`.

    Whoever may write below ``root`` could put a link in the file's place between a check and the library's opening.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.
        to: private folder; the copy has the same place below it.

    Returns:
        the copy.
    """
    copy = to.joinpath(*parts)
    with open_file(root, *parts) as file:
        copy.parent.mkdir(parents=True, exist_ok=True)
        with copy.open("xb") as target:
            shutil.copyfileobj(file, target)
    return copy


@contextmanager
def open_file(root: Path, *parts: str) -> Iterator[BinaryIO]:
    """Open a regular file below ``root`` for reading inside the block; raises as `read_file`.

    Args:
        root: trusted folder.
        *parts: names of folders and of the file below ``root``.
    """
    *folders, name = parts
    check_ordinary(root, *parts)
    with open_folder(root, *folders) as folder:
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        with open(_checked(root.joinpath(*parts), name, flags, folder), "rb") as file:
            yield file


def check_readable(path: Path) -> None:
    """Check that a path, links followed, neither blocks nor acts when it is opened.

    Args:
        path: path from the user.

    Raises:
        OSError: it is a named pipe, a device or a socket, or missing.
    """
    if not stat.S_ISREG(mode := path.stat().st_mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, f"it is a {_KINDS[stat.S_IFMT(mode)]} and no file", str(path))


def _make(name: str, folder: int) -> None:
    with suppress(FileExistsError):  # of any kind: reported when it is opened
        os.mkdir(name, dir_fd=folder)


def _inner_folder(place: Path, name: str, folder: int) -> int:
    try:
        return os.open(name, _FOLDER | os.O_NOFOLLOW, dir_fd=folder)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENOTDIR):
            raise _refused(place, special_kind(place)) from None
        raise


def _checked(place: Path, name: str, flags: int, folder: int) -> int:
    """Open a file that was an ordinary one a moment ago, and check the opened one."""
    try:
        descriptor = os.open(name, flags, 0o666, dir_fd=folder)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):
            raise _refused(place, special_kind(place)) from None
        raise
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):  # replaced since the check
        os.close(descriptor)
        raise _refused(place, _KINDS.get(stat.S_IFMT(mode)))
    return descriptor


def _refused(place: Path, kind: str | None) -> NotOrdinary:
    if kind is None:
        return NotOrdinary(f"{place} has the name of something that hfb keeps there and is another kind: move it away")
    return NotOrdinary(f"{place} is a {kind}, which hfb does not follow or open in a folder of results: remove it")
