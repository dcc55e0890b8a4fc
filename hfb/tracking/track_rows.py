"""Reading of other systems' boxes of people, row by row."""

import csv
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.io.array_files import read_arrays
from hfb.typing import Array, Float

_COLUMNS = {
    "frame": ("frame", "frame_index", "frame_id"),
    "id": ("id", "track_id", "person", "track"),
    "left": ("left", "x1", "x", "bb_left", "xmin"),
    "top": ("top", "y1", "y", "bb_top", "ymin"),
    "right": ("right", "x2", "xmax"),
    "bottom": ("bottom", "y2", "ymax"),
    "width": ("width", "w", "bb_width"),
    "height": ("height", "h", "bb_height"),
}

_BYTE_LIMIT = 16 << 20

TrackRow = tuple[int, str, Float[Array, "4"]]
"""Frame from 0, whose, and left, top, right, bottom [px]."""


def read_rows(path: Path) -> list[TrackRow]:
    """Read all rows of a file of tracks.

    Args:
        path: a .npz, or any other file as a table of text.

    Raises:
        InputError: missing, damaged or far too large.
    """
    try:
        if path.stat().st_size > _BYTE_LIMIT:
            raise InputError(f"{path}: is too large for a file of tracks.")
        rows = _rows_of_npz(path) if path.suffix.lower() == ".npz" else _rows_of_csv(path)
        if rows and all(box.max() <= 1.5 for *_, box in rows):  # no person is so small
            raise ValueError("its boxes are shares of the picture and no pixels")
        return rows
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check person.track.") from None
    except (OSError, ValueError, KeyError, IndexError, OverflowError, csv.Error) as error:
        raise InputError(
            f"{path}: is no file of tracks ({str(error)[:120]}); give columns frame, id, left, top, width, height [px]."
        ) from None


def _rows_of_npz(path: Path) -> list[TrackRow]:
    """Read members ``frame`` (N), ``id`` (N) and ``box`` (N, 4). Raises OSError, ValueError or KeyError."""
    found = read_arrays(path, ("frame", "id", "box"), _BYTE_LIMIT)
    numbers, names, boxes = found["frame"], found["id"], np.asarray(found["box"], np.float64)
    if numbers.ndim != 1 or names.shape != numbers.shape or boxes.shape != (len(numbers), 4):
        raise ValueError("frame, id and box differ in number")
    return [(int(frame), str(name), box) for frame, name, box in zip(numbers, names, boxes, strict=True)]


def _rows_of_csv(path: Path) -> list[TrackRow]:
    """Read columns by their names, or MOTChallenge's without a head. Raises csv.Error, ValueError or IndexError."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    return _rows(line for line in csv.reader(lines, delimiter=max(",;\t ", key=lines[0].count)) if line)


def _rows(lines: Iterator[list[str]]) -> list[TrackRow]:
    first = next(lines, [""])
    head = [word.strip().lower() for word in first]
    if head[0].replace(".", "", 1).lstrip("-").isdigit():
        return [(int(float(line[0])) - 1, _name(line[1]), _sized(line, 2, 3, 4, 5)) for line in chain([first], lines)]
    column = {key: next((head.index(word) for word in words if word in head), -1) for key, words in _COLUMNS.items()}
    missing = [key for key in ("frame", "id", "left", "top") if column[key] < 0]
    if missing:
        raise ValueError(f"no column {missing[0]}")
    rows = []
    for line in lines:
        if column["right"] >= 0 and column["bottom"] >= 0:
            box = np.array([float(line[column[key]]) for key in ("left", "top", "right", "bottom")])
        else:
            box = _sized(line, *(column[key] for key in ("left", "top", "width", "height")))
        rows.append((int(float(line[column["frame"]])), _name(line[column["id"]]), box))
    return rows


def _sized(line: Sequence[str], left: int, top: int, width: int, height: int) -> Float[Array, "4"]:
    if min(width, height) < 0:
        raise ValueError("no columns right and bottom, or width and height")
    x, y, w, h = (float(line[column]) for column in (left, top, width, height))
    return np.array([x, y, x + w, y + h])


def _name(text: str) -> str:
    """Return an id as text; ``3`` and ``3.0`` are one person."""
    text = text.strip()
    return text[:-2] if text.endswith(".0") and text[:-2].isdigit() else text
