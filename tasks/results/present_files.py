"""Where the files of a recorded run lie now: told by their content, wherever they were moved to."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from hfb.errors import InputError
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking.recipe import GivenFile


def find_present(files: Mapping[str, GivenFile], folder: Path | None) -> dict[str, Path]:
    """sha256 -> path of every file, at its old place or anywhere below a folder.

    Args:
        files: by role, such as ``frame_0``.

    Raises:
        InputError: some are gone or were changed; the sentence names them, and how to point at moved ones.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"{folder} is no folder: give the one that holds the run's inputs with --inputs")
    found: dict[str, Path] = {}
    missing: dict[str, str] = {}
    for number, (role, file) in enumerate(files.items()):
        progress.advance(number, len(files))
        state = _state(file)
        if state is None:
            found[file.sha256] = file.path
        else:
            missing[role] = f"{role} ({file.path}) {state}"
    if folder is not None and missing:
        found |= _below(folder, [files[role] for role in missing])
    left = [words for role, words in missing.items() if files[role].sha256 not in found]
    if left:
        shown = ", ".join(left[:5]) + (f" and {len(left) - 5} more" if len(left) > 5 else "")
        where = f"nor is it in {folder}: " if folder is not None and len(left) == 1 else ""
        where = where or (f"nor are they in {folder}: " if folder is not None else "")
        raise InputError(f"{shown}; {where}point at the folder that holds the same files with --inputs DIR")
    return found


def _state(file: GivenFile) -> str | None:
    """What is wrong with a file at its old place."""
    try:
        if file.path.stat().st_size == file.bytes and sha256_of(file.path) == file.sha256:
            return None
    except FileNotFoundError:
        return "is gone"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return "was changed"


def _below(folder: Path, files: list[GivenFile]) -> dict[str, Path]:
    """The files that lie somewhere in a folder; only files of a wanted size are read."""
    wanted: dict[int, set[str]] = defaultdict(set)
    for file in files:
        wanted[file.bytes].add(file.sha256)
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        try:
            sought = wanted[path.stat().st_size] - found.keys() if path.is_file() else set()
            sha256 = sha256_of(path) if sought else ""
        except OSError:  # not ours to read
            continue
        if sha256 in sought:
            found[sha256] = path.resolve()
    return found
