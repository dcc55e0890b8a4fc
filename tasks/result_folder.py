"""A result's folder as its readers see it: result.json, read safely, and whether the result is whole. Light to import.

From the moment that files of an earlier result are replaced until the last new one is there, result.json says
``unfinished``. A run that is killed meanwhile leaves it so, and every reader says so.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.export.names import RESULT
from hfb.media.safe_folder import check_ordinary, read_file

UNFINISHED = "unfinished"
_BYTE_LIMIT = 64 << 20


def result_content(folder: Path) -> dict[str, Any]:
    """The content of result.json.

    Raises:
        FileNotFoundError: there is none.
        NotOrdinary: it is a link or a special file.
        OSError, ValueError, RecursionError: it cannot be read, or is no result's.
    """
    content = json.loads(read_file(folder, RESULT, limit=_BYTE_LIMIT))
    if not isinstance(content, dict):
        raise ValueError("it is no result of hfb")
    return content


def is_finished(folder: Path) -> bool:
    """Return whether a whole result lies there."""
    try:
        return UNFINISHED not in result_content(folder)
    except (OSError, ValueError, RecursionError):  # NotOrdinary is a ValueError
        return False


def unfinished_files(folder: Path) -> set[str]:
    """What a command left that was stopped while it put the files in place; nothing where none was."""
    try:
        content = result_content(folder)
        return {RESULT, *map(str, content["files"])} if UNFINISHED in content else set()
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return set()


def check_result(folder: Path, names: Iterable[str]) -> None:
    """Check a result's folder before its files are read; a result.json that is missing or damaged passes.

    Args:
        names: the files that will be read.

    Raises:
        InputError: the result is unfinished, or one of these files is a link or a special file.
    """
    for name in (RESULT, *names):
        check_ordinary(folder, *Path(name).parts)
    try:
        unfinished = UNFINISHED in result_content(folder)
    except (OSError, ValueError, RecursionError):
        return
    if unfinished:
        raise unfinished_result(folder)


def unfinished_result(folder: Path) -> InputError:
    """The sentence about a result that was being replaced when its command was killed."""
    return InputError(
        f"the result in {folder} is unfinished, since its command was stopped while it put the files in place: run "
        "the same command again, which goes on from there"
    )
