"""The boxes of an MP4 or MOV file, which FFmpeg does not pass on."""

import struct
from collections.abc import Iterator
from io import BufferedIOBase
from pathlib import Path

_BOX_LIMIT, _BOXES_LIMIT = 1 << 20, 10_000
_MP4_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")


def boxes_of(path: Path, *wanted: tuple[bytes, ...]) -> Iterator[tuple[bytes, bytes]]:
    """Yield (kind, content) of an MP4's or MOV's boxes at the given places; nothing of other or damaged files.

    Args:
        path: the file.
        *wanted: places: the kinds of a box and of those that it lies in, the outermost first.
    """
    try:
        with path.open("rb") as file:
            end = file.seek(0, 2)
            file.seek(4)
            if file.read(4) not in _MP4_FIRST_BOXES:
                return
            budget = iter(range(_BOXES_LIMIT))
            for place in wanted:
                yield from ((place[-1], content) for content in descend(file, 0, end, place, budget))
    except (OSError, struct.error):
        return


def descend(
    file: BufferedIOBase, start: int, end: int, place: tuple[bytes, ...], budget: Iterator[int]
) -> Iterator[bytes]:
    """Yield the contents of boxes at a place; ends at the first damaged box.

    Args:
        file: opened for reading.
        start: of the outermost boxes.
        end: of the outermost boxes.
        place: as in `boxes_of`.
        budget: one item for each box that may be looked at.

    Raises:
        struct.error: the file ends early.
    """
    while start + 8 <= end and next(budget, None) is not None:
        file.seek(start)
        size, kind = struct.unpack(">I4s", file.read(8))
        head = 8
        if size == 1:
            size, head = struct.unpack(">Q", file.read(8))[0], 16
        last = end if size == 0 else start + size
        if (size and size < head) or last > end:
            return
        if kind == place[0]:
            inner = start + head
            if len(place) == 1:
                file.seek(inner)
                yield file.read(min(last - inner, _BOX_LIMIT))
            else:
                # ISO's `meta` begins with a version, QuickTime's does not.
                file.seek(inner + 4)
                versioned = kind == b"meta" and file.read(4) not in (b"hdlr", b"keys", b"ilst", b"xml ")
                yield from descend(file, inner + 4 * versioned, last, place[1:], budget)
        start = last
