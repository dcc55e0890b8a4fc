"""A result's folder as its readers see it: result.json, read safely, and whether the result is whole. Light to import.

From the moment that files of an earlier result are replaced until the last new one is there, result.json says
``unfinished``. A run that is killed meanwhile leaves it so, and every reader says so.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.export.names import RESULT
from hfb.json_file import JSON_LIMIT_BYTES, parse_json
from hfb.media.safe_folder import check_ordinary, read_file

UNFINISHED = "unfinished"


def result_content(folder: Path, fix: str = "make the result again") -> dict[str, Any]:
    """The content of result.json; every number in it is finite.

    Args:
        fix: ends the sentence of an error.

    Raises:
        FileNotFoundError: there is none.
        NotOrdinary: it is a link or a special file.
        OSError: it cannot be read.
        InputError: it is damaged, too large, or no result's.
    """
    path = folder / RESULT
    try:
        data = read_file(folder, RESULT, limit=JSON_LIMIT_BYTES)
    except InputError:
        raise
    except ValueError:
        raise InputError(f"{path} has over {JSON_LIMIT_BYTES >> 20} MB, far more than hfb writes: {fix}") from None
    content = parse_json(data, path, fix)
    if not isinstance(content, dict):
        raise InputError(f"{path} is no result of hfb: {fix}")
    return content


def is_finished(folder: Path) -> bool:
    """Return whether a whole result lies there."""
    try:
        return UNFINISHED not in result_content(folder)
    except (OSError, InputError):
        return False


def unfinished_files(folder: Path) -> set[str]:
    """What a command left that was stopped while it put the files in place; nothing where none was."""
    try:
        content = result_content(folder)
        return {RESULT, *map(str, content["files"])} if UNFINISHED in content else set()
    except (OSError, InputError, TypeError, KeyError):
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
    except (OSError, InputError):
        return
    if unfinished:
        raise unfinished_result(folder)


def unfinished_result(folder: Path) -> InputError:
    """The sentence about a result that was being replaced when its command was killed."""
    return InputError(
        f"the result in {folder} is unfinished, since its command was stopped while it put the files in place: run "
        "the same command again, which goes on from there"
    )
