"""A result's folder as readers see it: result.json, read safely, and whether the result is complete. Light to import.

From the moment that files of an earlier result are replaced until the last new one is there, result.json holds
``unfinished``. A killed run leaves it so, and every reader reports it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.interop.writers.export_names import RESULT
from hfb.io.json_file import read_json
from hfb.io.safe_folder import check_ordinary, read_head

UNFINISHED = "unfinished"
_HEAD_BYTES = 64


def read_result_content(root: Path, *parts: str) -> dict[str, Any]:
    """Read result.json of a folder, or of one below it.

    Args:
        root: the folder.
        *parts: names of folders below it.

    Raises:
        InputError: it is missing, damaged or no result's, or it, or a folder below ``root``, is a link or a special
            file.
    """
    path = root.joinpath(*parts, RESULT)
    content = read_json(path, root=root)
    if not isinstance(content, dict):
        raise InputError(f"{path} is not a result of hfb: give the folder of one")
    return content


def is_unfinished(root: Path, *parts: str) -> bool:
    """Return whether a result's files were being replaced when its command was stopped; only a few bytes are read.

    Args:
        root: the folder.
        *parts: names of folders below it.
    """
    try:
        head = read_head(root, *parts, RESULT, size=_HEAD_BYTES)
    except (OSError, ValueError):  # NotOrdinary is a ValueError
        return False
    return head.lstrip(b"{ \r\n").startswith(f'"{UNFINISHED}"'.encode())


def list_unfinished_files(folder: Path) -> set[str]:
    """Return the files of a command that was stopped while it put them in place; empty for any other folder.

    Args:
        folder: of the result.
    """
    try:
        return {RESULT, *map(str, read_result_content(folder)["files"])} if is_unfinished(folder) else set()
    except (InputError, TypeError, KeyError):
        return set()


def check_result(folder: Path, names: Iterable[str]) -> None:
    """Check a result's folder before its files are read; a result.json that is missing or damaged passes.

    Args:
        folder: of the result.
        names: the files that will be read.

    Raises:
        InputError: the result is unfinished, or one of these files is a link or a special file.
    """
    for name in (RESULT, *names):
        check_ordinary(folder, *Path(name).parts)
    if is_unfinished(folder):
        raise InputError(
            f"the result in {folder} is unfinished, since its command was stopped while it put the files in place: "
            "run the same command again, which goes on from there"
        )
