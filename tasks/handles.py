"""What travels between tasks: small frozen records that name finished files, never a tensor.

A handle holds a path, the sha256 of what stood there when it was made, and a few facts. It exists only for a
finished file, and it can say whether that file is still the one it was made for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel

from hfb.config import Record


class StaleFile(Exception):
    """A file that a handle names is gone, or no longer what it was."""


class FileHandle(Record):
    """One finished file."""

    path: Path
    sha256: str

    @classmethod
    def of(cls, path: Path, **facts: Any) -> Self:
        """The handle of a file as it is now."""
        return cls(path=path.resolve(), sha256=sha256_of(path), **facts)

    def verify(self) -> None:
        """Raises StaleFile unless the file is still what it was."""
        try:
            actual = sha256_of(self.path)
        except OSError as error:
            raise StaleFile(f"{self.path} is gone") from error
        if actual != self.sha256:
            raise StaleFile(f"{self.path} is no longer what it was")


class ClipHandle(Record):
    """Pictures of one static camera that fit together, and when and how they were taken."""

    frames: tuple[FileHandle, ...]
    background: FileHandle
    height: int
    width: int
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    exposure_s: float
    interval_s: float
    transfer: Literal["srgb", "linear", "bt709", "gamma22"]
    light: Literal["srgb", "linear"]


class FirstBodyHandle(FileHandle):
    """The static body of one frame."""

    source: str


class PriorsHandle(Record):
    """Which priors a fit uses: the user's files, or built-in ones."""

    kind: Literal["anatomy", "mixture"]
    pose: FileHandle | None
    motion: FileHandle | None


class FitHandle(Record):
    """A fitted motion, its texture (arrays and a picture to look at) and the losses on the way.

    Attributes:
        alternatives: the other directions in which it may have run, where they were searched.
        directions: per frame P(direction right) of the body and its limbs (`hfb.fit.alternatives.direction_record`).
    """

    motion: FileHandle
    texture: FileHandle
    texture_picture: FileHandle
    history: FileHandle
    alternatives: FileHandle | None = None
    directions: tuple[dict[str, dict[str, float | None]], ...] = ()
    seconds: float
    best_iteration: int
    loss: float


class ScoresHandle(FileHandle):
    """What the evaluation found, by name; ``initial_*`` is the first body held still."""

    scores: dict[str, float]


def sha256_of(path: Path) -> str:
    """The sha256 of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_in(value: object) -> Iterator[FileHandle]:
    """Every file that a handle, or a sequence of handles, names."""
    if isinstance(value, FileHandle):
        yield value
    elif isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from files_in(getattr(value, name))
    elif isinstance(value, tuple | list):
        for one in value:
            yield from files_in(one)


def digest(value: object) -> str:
    """sha256 of a value's content: where a file lies and how long a step took do not count."""
    return hashlib.sha256(json.dumps(_content(value), sort_keys=True).encode()).hexdigest()


def _content(value: object) -> Any:
    if isinstance(value, BaseModel):
        handle = isinstance(value, FileHandle | FitHandle)
        names = [name for name in type(value).model_fields if not (handle and name in ("path", "seconds"))]
        return {name: _content(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [_content(one) for one in value]
    if isinstance(value, dict):
        return {str(key): _content(one) for key, one in value.items()}
    return str(value) if isinstance(value, Path) else value
