"""What travels between tasks: small frozen records that name finished files, never a tensor.

A handle holds a path, the sha256 of what stood there when it was made, and a few facts. It exists only for a
finished file, and it can say whether that file is still the one it was made for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, cast

from pydantic import BaseModel

from hfb.config import Record
from hfb.io.safe_folder import check_readable

T = TypeVar("T")


class StaleFile(Exception):
    """A file that a handle names is gone, or no longer what it was."""


Stamp = tuple[int, int, int, int, int]
_read: dict[Path, tuple[Stamp, str]] = {}
"""sha256 of the files that this process has read, and the stamp that each had then."""


class Call(Record):
    """The arguments of one call of a mapped task (`hfb.tasks.map_task`).

    A field ``folder`` is where the call writes its files; it is no part of the call's content.
    """


class FileHandle(Record):
    """One finished file."""

    path: Path
    sha256: str

    @classmethod
    def of(cls, path: Path, **facts: Any) -> Self:
        """The handle of a file as it is now."""
        return cls(path=path.resolve(), sha256=sha256_of(path), **facts)

    def check(self) -> Stamp:
        """Raises StaleFile as `verify`; a file that was not touched since this process read it is not read again.

        Returns:
            what would be another if it were touched.
        """
        try:
            stamp = _stamp(self.path)
            known = _read.get(self.path)
            actual = known[1] if known is not None and known[0] == stamp else sha256_of(self.path)
        except OSError as error:
            raise StaleFile(f"{self.path} is gone") from error
        if actual != self.sha256:
            raise StaleFile(f"{self.path} is no longer what it was")
        return stamp

    def verify(self) -> None:
        """Raises StaleFile unless the file is still what it was."""
        try:
            actual = sha256_of(self.path)
        except OSError as error:
            raise StaleFile(f"{self.path} is gone") from error
        if actual != self.sha256:
            raise StaleFile(f"{self.path} is no longer what it was")


class ClipHandle(Record):
    """Pictures of one static camera that fit together, and when and how they were taken.

    Attributes:
        remarks: what a person should know about them, one sentence each.
    """

    frames: tuple[FileHandle, ...]
    background: FileHandle
    height: int
    width: int
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    exposure_s: float
    interval_s: float
    transfer: Literal["srgb", "linear", "bt709", "gamma22"]
    light: Literal["srgb", "linear"]
    remarks: tuple[str, ...] = ()

    def only(self, index: int) -> ClipHandle:
        """Return one frame as a clip of its own."""
        return self.model_copy(update={"frames": (self.frames[index],)})


class FirstBodyHandle(FileHandle):
    """The static body of one frame.

    Attributes:
        doubt: of a search, see `hfb.tracking.clip_bodies.front_doubt`; 0 where it was not asked for.
    """

    source: str
    doubt: float = 0.0


class PriorsHandle(Record):
    """Which priors a fit uses: the user's files, or built-in ones."""

    kind: Literal["anatomy", "mixture"]
    pose: FileHandle | None
    motion: FileHandle | None


class FitHandle(Record):
    """A fitted motion, its texture (arrays and a picture to look at) and the losses on the way.

    Attributes:
        mattes: those that the fit's last stage was compared with, one per frame.
        stage_seconds: wall time per stage of the schedule, in its order.
        alternatives: the other directions in which it may have run, where they were searched.
        directions: per frame P(direction right) of the body and its limbs (`hfb.fitting.alternatives`).
    """

    motion: FileHandle
    texture: FileHandle
    texture_image: FileHandle
    history: FileHandle
    mattes: tuple[FileHandle, ...]
    alternatives: FileHandle | None = None
    directions: tuple[dict[str, dict[str, float | None]], ...] = ()
    seconds: float
    stage_seconds: dict[str, float]
    best_iteration: int
    loss: float


class ScoresHandle(FileHandle):
    """What the evaluation found, by name; ``initial_*`` is the first body held still."""

    scores: dict[str, float]


_NO_CONTENT: dict[type[Record], tuple[str, ...]] = {
    Call: ("folder",),
    FileHandle: ("path", "seconds"),
    FitHandle: ("seconds", "stage_seconds"),
}
"""Fields that say where something lies or how long it took, and so do not count in a digest."""


def sha256_of(path: Path) -> str:
    """The sha256 of a file's content.

    Raises:
        OSError: it cannot be read, or is a named pipe, a device or a socket.
    """
    check_readable(path)
    before = _stamp(path)
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if _stamp(path) == before:
        _read[path] = before, found
    return found


def _stamp(path: Path) -> Stamp:
    """Any write or replacement changes it: the time of the last change is the kernel's, nobody can set it."""
    facts = path.stat()
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


@contextmanager
def verify_unchanged(*values: object) -> Iterator[None]:
    """What is read inside is what the handles name, from the beginning to the end.

    Raises:
        StaleFile: a file is gone or no longer what it was, before the work or after it.
    """
    files = list(files_in(values))
    stamps = [file.check() for file in files]
    yield
    for file, stamp in zip(files, stamps, strict=True):
        if file.check()[:-1] != stamp[:-1]:  # a further link to it, as backups make, changes but the last one
            raise StaleFile(f"{file.path} was replaced while it was read")


def files_in(value: object) -> Iterator[FileHandle]:
    """Every file that a handle, or a sequence of handles, names."""
    if isinstance(value, FileHandle):
        yield value
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from files_in(getattr(value, name))
    elif isinstance(value, tuple | list):
        for one in value:
            yield from files_in(one)


def with_files(value: T, change: Callable[[FileHandle], FileHandle]) -> T:
    """The same handle, or sequence of handles, with every file that it names changed."""
    changed: Any = value
    if isinstance(value, BaseModel):
        parts = {name: getattr(value, name) for name in type(value).model_fields}
        changed = value.model_copy(update={name: with_files(part, change) for name, part in parts.items()})
        changed = change(changed) if isinstance(changed, FileHandle) else changed
    elif isinstance(value, tuple | list):
        changed = type(value)(with_files(one, change) for one in value)
    return cast(T, changed)


def digest(value: object) -> str:
    """sha256 of a value's content: where a file lies and how long a step took do not count."""
    return hashlib.sha256(json.dumps(_content(value), sort_keys=True).encode()).hexdigest()


def _content(value: object) -> Any:
    if isinstance(value, BaseModel):
        ignored = next((names for kind, names in _NO_CONTENT.items() if isinstance(value, kind)), ())
        names = [name for name in type(value).model_fields if name not in ignored]
        return {name: _content(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [_content(one) for one in value]
    if isinstance(value, dict):
        return {str(key): _content(one) for key, one in value.items()}
    return str(value) if isinstance(value, Path) else value
