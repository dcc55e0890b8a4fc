"""Frames that can only be counted: a decoder is kept where one reader stopped, for the next one.

A clip is read a few frames at a time; decoding from the start each time would take quadratic time.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import av

Numbered = Iterator[tuple[int, av.VideoFrame]]


@dataclass(frozen=True, eq=False)
class _Resting:
    """A decoder whose next frame has the number `at`, of a file as it was when it was opened."""

    file: tuple[int, ...]
    at: int
    frames: Numbered


# One, since a decoder holds images. A thread that takes it owns it: both operations are atomic.
_resting: deque[_Resting] = deque(maxlen=1)


def read_on(
    path: Path, start: int, stop: int, count: int, from_start: Callable[[], Numbered]
) -> Iterator[av.VideoFrame]:
    """Yield frames `start` to `stop` (exclusive) of the `count` that a file has; ends early where the file does.

    Args:
        path: the video file.
        start: first frame.
        stop: frame after the last one.
        count: frames of the whole file.
        from_start: opens the file; (number, frame) of every frame, in order.
    """
    file = _version(path)
    frames = _taken(file, start) or from_start()
    for number, frame in frames:
        if number == stop - 1 and stop < count and file:  # before the last: its reader may stop there
            _resting.append(_Resting(file, stop, frames))
        if number >= start:
            yield frame
        if number >= stop - 1:
            return


def _taken(file: tuple[int, ...], start: int) -> Numbered | None:
    """Return the resting decoder if it is of this very file and not past the start; it is removed in any case."""
    try:
        resting = _resting.pop()
    except IndexError:
        return None
    return resting.frames if resting.file == file and resting.at <= start else None


def _version(path: Path) -> tuple[int, ...]:
    """Return a file's identity, which changes when its content does; empty where there is no file."""
    try:
        facts = path.stat()
    except OSError:
        return ()
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns
