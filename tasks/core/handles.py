"""Handles: small frozen records that tasks exchange; they name finished files and never hold a tensor.

A handle holds a path, the sha256 of the file when it was made, and a few facts. It exists only for a finished file,
and can check whether that file is unchanged.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, cast

from pydantic import BaseModel

from hfb.config import ReadoutTo, Record
from hfb.geometry.world import World
from hfb.io.safe_folder import check_readable

T = TypeVar("T")


class StaleFile(Exception):
    """A file that a handle names is missing or was changed."""


Stamp = tuple[int, int, int, int, int]
_read: dict[Path, tuple[Stamp, str]] = {}
"""sha256 and stamp of the files that this process has read."""


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
        """Return the handle of a file in its current state.

        Args:
            path: the file.
            **facts: further fields of the handle.
        """
        return cls(path=path.resolve(), sha256=sha256_of(path), **facts)

    def check(self) -> Stamp:
        """Verify the file, without reading it again if it was not touched since this process read it.

        Returns:
            a stamp that changes when the file is touched.
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
        """Check the file's sha256."""
        _read.pop(self.path, None)
        self.check()


class FrameHandle(FileHandle):
    """A blurred picture.

    Attributes:
        gain: per channel, its exposure over the background's (`hfb.matting.exposure_match`).
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)


class ReadoutRecord(Record):
    """A rolling shutter: the time from the first row's exposure to the last row's, and where that row lies."""

    seconds: float
    to: ReadoutTo


class ClipHandle(Record):
    """Frames of one static camera with their plate, and when and how they were taken.

    Attributes:
        remarks: sentences for the user.
        plate_remarks: those of them that are about the plate.
        world: of exports; None where nothing is known of it.
        readout: None where all rows are exposed at once, or nothing is known of it.
    """

    frames: tuple[FrameHandle, ...]
    background: FileHandle
    height: int
    width: int
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    exposure_s: float
    interval_s: float
    transfer: Literal["srgb", "linear", "bt709", "gamma22"]
    light: Literal["srgb", "linear"]
    remarks: tuple[str, ...] = ()
    plate_remarks: tuple[str, ...] = ()
    world: World | None = None
    readout: ReadoutRecord | None = None

    def only(self, index: int) -> ClipHandle:
        """Return one frame as a clip of its own.

        Args:
            index: of the frame.
        """
        return self.model_copy(update={"frames": (self.frames[index],)})


class FirstBodyHandle(FileHandle):
    """The static body of one frame.

    Attributes:
        doubt: of a search, see `hfb.initialization.fronts.front_doubts`; 0 where it was not computed.
    """

    source: str
    doubt: float = 0.0


class PriorsHandle(Record):
    """The priors of a fit: the user's files, or built-in ones."""

    kind: Literal["anatomy", "mixture"]
    pose: FileHandle | None
    motion: FileHandle | None


class FrontRecord(Record):
    """Which way the person faces, where both ways were fitted.

    Attributes:
        probability: of the front that was kept.
        mirrored: the first bodies were found facing the other way.
        turn_deg: angle between both; small for somebody seen from the side, whose left and right it is about.
    """

    probability: float
    mirrored: bool
    turn_deg: float


class FitHandle(Record):
    """A fitted motion, its texture (arrays and an image) and the history of losses.

    Attributes:
        mattes: those that the fit's last stage used, one per frame.
        alternatives: motions of other directions, where they were searched.
        directions: per frame P(direction right) of the body and its limbs (`hfb.fitting.alternatives`).
        front: None where it was never in doubt.
        stage_seconds: wall time per stage of the schedule, in its order.
    """

    motion: FileHandle
    texture: FileHandle
    texture_image: FileHandle
    history: FileHandle
    mattes: tuple[FileHandle, ...]
    alternatives: FileHandle | None = None
    directions: tuple[dict[str, dict[str, float | None]], ...] = ()
    front: FrontRecord | None = None
    seconds: float
    stage_seconds: dict[str, float]
    best_iteration: int
    loss: float


class ScoresHandle(FileHandle):
    """Scores by name; ``initial_*`` belongs to the first body held still."""

    scores: dict[str, float]


_NO_CONTENT: dict[type[Record], tuple[str, ...]] = {
    Call: ("folder",),
    FileHandle: ("path", "seconds"),
    FitHandle: ("seconds", "stage_seconds"),
}
"""Fields that say where a file lies or how long a step took; they do not count in a digest."""


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file's content.

    Args:
        path: the file.

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
    """Return what any write or replacement changes: only the kernel can set the time of the last change."""
    facts = path.stat()
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


@contextmanager
def verify_unchanged(*values: object) -> Iterator[None]:
    """Verify all files before and after the block.

    Args:
        *values: handles or sequences of handles.

    Raises:
        StaleFile: a file is missing or was changed, before the block or after it.
    """
    files = list(files_in(values))
    stamps = [file.check() for file in files]
    yield
    for file, stamp in zip(files, stamps, strict=True):
        if file.check()[:-1] != stamp[:-1]:  # a further link to it, as backups make, changes but the last one
            raise StaleFile(f"{file.path} was replaced while it was read")


def files_in(value: object) -> Iterator[FileHandle]:
    """Yield every file that a handle, or a sequence of handles, names.

    Args:
        value: anything; other values have no files.
    """
    if isinstance(value, FileHandle):
        yield value
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from files_in(getattr(value, name))
    elif isinstance(value, tuple | list):
        for one in value:
            yield from files_in(one)


def with_files(value: T, change: Callable[[FileHandle], FileHandle]) -> T:
    """Return the same handle, or sequence of handles, with every file handle replaced.

    Args:
        value: anything; other values are returned as they are.
        change: returns the new handle of a file.
    """
    changed: Any = value
    if isinstance(value, BaseModel):
        parts = {name: getattr(value, name) for name in type(value).model_fields}
        changed = value.model_copy(update={name: with_files(part, change) for name, part in parts.items()})
        changed = change(changed) if isinstance(changed, FileHandle) else changed
    elif isinstance(value, tuple | list):
        changed = type(value)(with_files(one, change) for one in value)
    return cast(T, changed)


def digest(value: object) -> str:
    """Return the sha256 of a value's content; places of files and durations do not count.

    Args:
        value: handles, records or plain values.
    """
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
