"""Uploads: one request, a line of JSON and then the bytes of its files. A job's folder appears whole or not at all."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

from hfb.errors import InputError
from hfb.flows.app.request import INPUTS, MOST_BYTES, JobRequest, check_clip_file, check_request
from hfb.io.atomic import sync_folder

_HEAD_BYTES = 1 << 16
MOST_UPLOAD = MOST_BYTES + _HEAD_BYTES
"""Bytes of a request."""

KIND = "application/x-hfb-upload"
"""The request's media type; a page of another origin cannot send it without asking, which is never granted."""

_ROOM_BYTES = 1 << 30
_PART = ".upload-"


class _Body:
    """The bytes of a request, as they come."""

    def __init__(self, chunks: AsyncIterator[bytes]) -> None:
        self._chunks, self._left = chunks, b""

    async def head(self) -> bytes:
        """Return the first line."""
        while b"\n" not in self._left and len(self._left) <= _HEAD_BYTES:
            if not (chunk := await anext(self._chunks, b"")):
                break
            self._left += chunk
        line, end, self._left = self._left.partition(b"\n")
        if not end or len(line) > _HEAD_BYTES:
            raise InputError("the request holds no files: load the page again")
        return line

    async def part(self, size: int) -> AsyncIterator[bytes]:
        """Yield exactly so many bytes. Raises InputError where they end before."""
        while size > 0:
            chunk = self._left or await anext(self._chunks, b"")
            if not chunk:
                raise InputError("the upload ended before its files did: try again")
            yield chunk[:size]
            self._left, size = chunk[size:], size - len(chunk[:size])


async def receive(chunks: AsyncIterator[bytes], length: int, out: Path) -> tuple[str, JobRequest]:
    """Store an upload; returns the name of its folder, and what is asked for.

    Args:
        chunks: of the request's body.
        length: bytes of the body, as the request says.
        out: folder of all jobs.

    Raises:
        InputError: it cannot be used; nothing of it is kept.
    """
    body = _Body(chunks)
    part = out / f"{_PART}{secrets.token_hex(8)}"
    try:
        head = await body.head()
        request = check_request(_parsed(head))
        size = sum(one.size for one in request.files)
        if length != len(head) + 1 + size:
            raise InputError("a file changed while it was read: give it again")
        if shutil.disk_usage(out).free < size + _ROOM_BYTES:
            raise InputError(f"the disk of {out} is nearly full: free some space")
        part.mkdir(mode=0o700)
        (part / INPUTS).mkdir()
        for one, name in zip(request.files, request.stored_names(), strict=True):
            with (part / INPUTS / name).open("xb") as file:
                async for chunk in body.part(one.size):
                    file.write(chunk)
                file.flush()
                os.fsync(file.fileno())
        check_clip_file(part / INPUTS)
        name = f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(4)}"
        part.rename(out / name)
        sync_folder(out)
        return name, request
    finally:
        shutil.rmtree(part, ignore_errors=True)


def leftovers(out: Path) -> Iterator[Path]:
    """Yield folders of uploads that were never finished.

    Args:
        out: folder of all jobs.
    """
    yield from out.glob(f"{_PART}*")


def _parsed(line: bytes) -> object:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        raise InputError("the request cannot be read: load the page again") from None
