"""Files for workers that do not share disks: each under its content's hash, behind a URL.

A worker needs nothing but the URL: it fetches the files of a call, works in a folder of its own, and uploads the
results. Any filesystem of Arrow works (``s3://bucket/prefix?endpoint_override=host:9000``, ``gs://``, ``file:///``);
credentials come from where that filesystem looks for them, never from the URL.
"""

from __future__ import annotations

import functools
import hashlib
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.core.handles import FileHandle, StaleFile, files_in, sha256_of, with_files
from hfb.tasks.telemetry.secrets import without_secrets

if TYPE_CHECKING:
    from pyarrow.fs import FileSystem

T = TypeVar("T")
_BLOCK_BYTES = 1 << 20


class SharedStore:
    """Uploads and downloads files; an existing file is never written again."""

    def __init__(self, url: str) -> None:
        """Open the store.

        Args:
            url: of the store, without a password.

        Raises:
            InputError: the URL cannot be used, or holds a password.
        """
        self._fs, self._root = _open(url)
        self._known: set[str] = set()

    def put(self, value: object) -> None:
        """Upload all files that a handle, or a sequence of handles, names.

        Args:
            value: handles.
        """
        for file in files_in(value):
            if file.sha256 not in self._known:
                self._put(file)
                self._known.add(file.sha256)

    def take(self, value: T, place: Callable[[FileHandle], Path]) -> T:
        """Download files; returns the same handles with the files' new places.

        Args:
            value: handles.
            place: returns the place for a file.

        Raises:
            StaleFile: a file is gone, or is not what its handle says.
        """
        return with_files(value, lambda file: self._take(file, place(file)))

    def _put(self, file: FileHandle) -> None:
        from pyarrow.fs import FileType

        place = self._place(file)
        if self._fs.get_file_info(place).type == FileType.File:
            return
        self._fs.create_dir(place.rpartition("/")[0], recursive=True)
        part = f"{place}.{secrets.token_hex(4)}.part"
        with file.path.open("rb") as source, self._fs.open_output_stream(part) as there:
            shutil.copyfileobj(source, there, _BLOCK_BYTES)
        self._fs.move(part, place)

    def _take(self, file: FileHandle, path: Path) -> FileHandle:
        here = file.model_copy(update={"path": path})
        if path.exists() and sha256_of(path) == file.sha256:
            return here
        try:
            with self._fs.open_input_stream(self._place(file)) as there:
                data = there.read()
        except FileNotFoundError as error:
            raise StaleFile(f"{file.path.name} is no longer in the shared store") from error
        if hashlib.sha256(data).hexdigest() != file.sha256:
            raise StaleFile(f"{file.path.name} in the shared store is no longer what it was")
        write_bytes_atomic(path, data)
        return here

    def _place(self, file: FileHandle) -> str:
        return f"{self._root}/{file.sha256[:2]}/{file.sha256}"


def _open(url: str) -> tuple[FileSystem, str]:
    from pyarrow.fs import FileSystem

    if without_secrets(url) != url:
        raise InputError("--store: keep the password out of the URL; the store's own environment variables name it")
    try:
        fs, root = FileSystem.from_uri(url)
    except (ValueError, OSError) as error:
        raise InputError(
            without_secrets(f"--store {url}: give a place such as s3://bucket/prefix or file:///folder ({error})")
        ) from None
    return fs, root.rstrip("/")


@functools.cache
def shared_store(url: str) -> SharedStore:
    """Return the store behind a URL, opened once per process.

    Args:
        url: of the store.
    """
    return SharedStore(url)
