"""Access to parts of a result by name, with limits on their number before they are read.

A pickle of a few bytes can hold the same large part a thousand times.
"""

from collections.abc import Callable, Collection, Iterable
from typing import Any

from hfb.errors import InputError
from hfb.interop.readers.pose_track import PoseTrack
from hfb.io.safe.contents import named, numbers, text_of
from hfb.typing import Array, Float

MAX_PEOPLE = 1 << 17
"""Limit for systems that store every person of every frame separately: more than an hour of one person."""
_MAX_ROWS, _MAX_ENTRIES = 1 << 20, 1 << 22


def has_keys(value: Any, needed: Collection[str]) -> bool:
    """Return whether a value is a dictionary with these names, as texts or as old pickles' bytes.

    Args:
        value: a value of an unpickled result.
        needed: names.
    """
    return isinstance(value, dict) and all(name in value or name.encode() in value for name in needed)


def named_all(parts: Iterable[Any], needed: Collection[str]) -> list[dict[str, Any]] | None:
    """Convert dictionaries to text keys; None where a part is no dictionary, or lacks a needed name.

    Args:
        parts: parts of an unpickled result.
        needed: names.

    Raises:
        InputError: together they have more entries than any result.
    """
    found = list(parts)
    if not all(has_keys(one, needed) for one in found):
        return None
    if sum(len(one) for one in found) > _MAX_ENTRIES:
        raise InputError("it holds the same entries over and over")
    return [named(one) for one in found]


def numbers_at(one: dict[str, Any], name: str, *shape: int | None, finite: bool = True) -> Float[Array, "..."]:
    """Return `numbers` of an entry; errors name it.

    Args:
        one: dictionary of a result.
        name: name of the entry.
        *shape: as in `numbers`; None for any length.
        finite: refuse values that are not finite.

    Raises:
        InputError: there is none of that name, or as `numbers`.
    """
    if name not in one:
        raise InputError(f"it has no {name}")
    try:
        return numbers(one[name], *shape, finite=finite)
    except InputError as error:
        raise InputError(f"in {name} {error}") from error


def read_people(
    content: Any, needed: Collection[str], read_one: Callable[[str, dict[str, Any]], PoseTrack]
) -> list[PoseTrack] | None:
    """Read the persons of {person: {name: array}}; None where it is something else.

    Args:
        content: content of the unpickled file.
        needed: names that every person has.
        read_one: converts a person's name and entries.

    Raises:
        InputError: together they have more rows than any clip, and as `read_one`.
    """
    people = named_all(content.values(), needed) if isinstance(content, dict) else None
    if not people:
        return None
    tracks, rows = [], 0
    for key, one in zip(content, people, strict=True):
        tracks.append(read_one(text_of(key), one))
        rows += len(tracks[-1])
        if rows > _MAX_ROWS:
            raise InputError(f"it holds more than {_MAX_ROWS} rows")
    return tracks
