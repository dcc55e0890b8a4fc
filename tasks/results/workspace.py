"""A run's folder: one process at a time, results that appear together or not at all, nothing left after an error.

OUT/motion.npz strip.png texture.png matte_0.png ... result.json    the latest finished result
OUT/intermediate/                                                   files that tasks exchange
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import lock_descriptor

from hfb.errors import Busy, InputError, TemporaryError
from hfb.interop.writers.export_names import CURVES, EXPORTED_NAMES, RECORD, REPORT, RESULT
from hfb.io.atomic import leftover_of, sync_folder, temporary_beside, write_bytes_atomic
from hfb.io.names import is_text
from hfb.io.safe_folder import (
    check_ordinary,
    check_system,
    check_tree,
    is_regular,
    open_folder,
    open_lock,
    special_kind,
)
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.core.result_folder import UNFINISHED, read_result_content
from hfb.tasks.results.own_files import among_own_files, replace_together
from hfb.tasks.telemetry.secrets import hidden_in

INTERMEDIATE = "intermediate"
_LOCK, _STAGING = ".lock", "publish"
_OF_MOTIONS = ("motion.npz", "texture.png", "strip.png", CURVES, "edges.json")  # results of several people have none
_ONLY_SOMETIMES = ("alternatives.npz", REPORT, RECORD, *EXPORTED_NAMES)  # an earlier result may have had more
_MATTE = re.compile(r"matte_\d+\.png")
_FOLDERS = ("cases", "example", "export", "meshes", "methods", "opensim")
_FOLDER = re.compile(r"(case|person)[_-]\d+")


class OutputConflict(InputError):
    """A file of the user's has the name of a result's file; what was computed is kept."""


@contextmanager
def workspace(out: Path, keep: bool = True) -> Iterator[Path]:
    """Provide the folder of intermediate files inside the block, locked for this process.

    It stays after a crash, so that the next run continues from there; after an InputError new folders are removed
    again.

    Args:
        out: where the results go.
        keep: whether what was computed stays after an OutputConflict, for the next run.

    Raises:
        InputError: the folder cannot be written, another process works in it, or it holds a link or a special file
            where hfb keeps files.
    """
    new_folders = [folder for folder in (out / INTERMEDIATE, out, *out.parents) if not folder.exists()]
    check_writable(out)
    folder = out / INTERMEDIATE
    try:
        out.mkdir(parents=True, exist_ok=True)
        with _held(out) as is_held:
            if not is_held:
                new_folders = []
                raise Busy(f"another hfb is working in {out}: wait until it has finished, or choose another --out")
            check_tree(out, INTERMEDIATE)
            _check_names(out)
            _remove_leftovers(out, folder)
            _check_moves(out, folder)
            yield folder
    except InputError as error:
        if keep and isinstance(error, OutputConflict):
            raise
        if folder in new_folders:
            shutil.rmtree(folder, ignore_errors=True)
        for created in new_folders:
            with suppress(OSError):  # something else lies in it
                created.rmdir()
        raise


@contextmanager
def _held(out: Path) -> Iterator[bool]:
    """Yield whether the folder's lock was free; it is held inside the block."""
    with open_folder(out, INTERMEDIATE, make=True):
        lock = open_lock(out, INTERMEDIATE, _LOCK)
    try:
        yield lock_descriptor(lock, blocking=False)  # FileLock itself would follow links of folders on the way
    finally:
        os.close(lock)


def _check_names(out: Path) -> None:
    """Raise NotOrdinary if a link or a special file has the name of one of a result's files."""
    for entry in os.scandir(out):
        if _is_a_name_of_hfb(entry.name) or entry.name in _FOLDERS or _FOLDER.fullmatch(entry.name):
            check_ordinary(out, entry.name)


def _remove_leftovers(out: Path, folder: Path) -> None:
    """Remove temporary files that a killed writer of hfb left."""
    for place in (out, folder):
        for entry in list(os.scandir(place)):
            name = leftover_of(entry.name)
            ours = name is not None and (place == folder or _is_a_name_of_hfb(name))
            if ours and entry.is_file(follow_symlinks=False):
                (place / entry.name).unlink(missing_ok=True)


def _check_moves(out: Path, folder: Path) -> None:
    """Raise TemporaryError if files cannot be moved out of the folder, as out of another disk or a mounted folder."""
    probe = temporary_beside(folder / RESULT)
    probe.touch()
    try:
        probe.replace(out / probe.name).unlink()
    except OSError as error:
        probe.unlink()
        if error.errno != errno.EXDEV:
            raise
        raise TemporaryError(
            f"{folder} is mounted by itself: mount {out} as a whole, or choose another --out"
        ) from None


def check_writable(out: Path) -> None:
    """Raise InputError if a folder cannot be created or written; creates nothing.

    Args:
        out: where the results go.
    """
    check_system()
    if not is_text(out.absolute()):
        raise InputError(f"{out.absolute()} has a name that is not text in UTF-8: choose another --out")
    for folder in (out.absolute(), *out.absolute().parents):
        if folder.name == INTERMEDIATE and is_regular(folder / _LOCK):
            raise TemporaryError(f"{out} lies among the intermediate files of {folder.parent}: choose another --out")
    if out.is_symlink() and not out.exists():
        raise TemporaryError(f"{out} is a link that leads nowhere: choose another --out")
    ground = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    if not ground.is_dir():
        raise TemporaryError(f"{out} cannot be a folder, since {ground} is a file: choose another --out")
    if not os.access(ground, os.W_OK | os.X_OK):
        raise TemporaryError(f"{out} cannot be written, {ground} is not yours to write: choose another --out")


def publish(out: Path, files: Mapping[str, Path], result: dict[str, Any]) -> None:
    """Move finished files into the run's folder: they appear together, or result.json marks them as unfinished.

    All are first copied beside their places. From then on, until the last of them is renamed, result.json holds
    ``unfinished`` (see tasks/core/result_folder.py); the next run of any command replaces it. Further files of an
    earlier result are removed, as far as hfb wrote them.

    Args:
        out: the run's folder.
        files: name -> current place.
        result: the content of result.json; it gets ``files``, the names of the others, and their ``sha256``.

    Raises:
        OutputConflict: a file would replace an input of this run, or one that hfb did not write.
    """
    staging = out / INTERMEDIATE / _STAGING
    inputs = set(result.get("inputs", {}).values())
    earlier = _published(out)
    _check_room(out, files, inputs, earlier)
    result |= {"files": sorted(files), "sha256": {name: sha256_of(path) for name, path in sorted(files.items())}}
    staging.mkdir(exist_ok=True)
    check_tree(out, INTERMEDIATE, _STAGING)
    for name, path in files.items():
        write_bytes_atomic(staging / name, path.read_bytes())
    write_bytes_atomic(staging / RESULT, _as_json(result))
    _mark(out, result, earlier)
    _remove_stale(out, earlier, files, inputs)
    for name in files:
        (staging / name).replace(out / name)
    sync_folder(out)  # before the note that they are not all there is gone
    (staging / RESULT).replace(out / RESULT)
    sync_folder(out)
    _clear(staging, {*files, RESULT, *earlier.files})


def mark_unfinished(out: Path) -> None:
    """Mark an earlier result as unfinished while parts of it are replaced; does nothing where there is none.

    Args:
        out: folder of the result.
    """
    earlier = _published(out)
    if earlier.known:
        _mark(out, {"out": str(out.resolve())}, earlier)


@contextmanager
def beside_result(out: Path, names: Sequence[str]) -> Iterator[Path]:
    """Provide a folder inside the block for files made later from a result.

    Where ``out`` holds a result they are moved beside it at the end and belong to it: the next result removes them.

    Args:
        out: folder of the result.
        names: of the files.

    Raises:
        Busy: another process works there.
        OutputConflict, TemporaryError: a file would replace one that hfb did not write.
    """
    if not _published(out).known:
        with among_own_files(out, names) as folder:
            yield folder
        return
    with workspace(out) as folder:
        staging = folder / _STAGING
        staging.mkdir(exist_ok=True)
        _clear(staging, set(names))
        staging.mkdir(exist_ok=True)
        yield staging
        made = {name: staging / name for name in names if is_regular(staging / name)}
        earlier = _published(out)
        _check_room(out, made, set(), earlier)
        _move_beside(out, made, earlier)
        _clear(staging, set(names))


def _move_beside(out: Path, made: Mapping[str, Path], earlier: _Published) -> None:
    """Record files first and move them then: a file that no record names would stay beside other results."""
    result = read_result_content(out)
    if "files" in result:  # else they are known by their names
        result["files"] = sorted({*result["files"], *made})
    new = {name: sha256_of(path) for name, path in made.items()}
    if earlier.complete:
        result["sha256"] |= {name: [*earlier.sha256.get(name, ()), one] for name, one in new.items()}
    write_bytes_atomic(out / RESULT, _as_json(result))
    replace_together(out, made)
    if earlier.complete:
        result["sha256"] |= new
        write_bytes_atomic(out / RESULT, _as_json(result))


def _as_json(result: dict[str, Any]) -> bytes:
    return json.dumps(hidden_in(result), indent=2, allow_nan=False).encode() + b"\n"


@dataclass(frozen=True)
class _Published:
    """The files that hfb's result.json names.

    Attributes:
        known: whether there is such a result.json.
        files: names.
        complete: whether it names every file and its hash; results of older versions do not.
        sha256: of these files; several where one was being replaced.
    """

    known: bool = False
    files: frozenset[str] = frozenset()
    complete: bool = False
    sha256: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def wrote(self, name: str, path: Path) -> bool:
        """Return whether a file is the one that hfb wrote under this name.

        Args:
            name: in result.json.
            path: the file.
        """
        return name in self.files and (not self.complete or sha256_of(path) in self.sha256.get(name, ()))


def _published(out: Path) -> _Published:
    """Return the record of the result in a folder.

    Older versions did not name all files: then files of names that only some results have count as the result's.
    """
    try:
        content = read_result_content(out)
        if not isinstance(content["out"], str):
            return _Published()
        if "files" not in content:
            sometimes = {entry.name for entry in os.scandir(out) if _only_sometimes(entry.name)}
            return _Published(True, frozenset(sometimes))
        told = content.get("sha256", {}).items()
        sha256 = {name: [one] if isinstance(one, str) else list(map(str, one)) for name, one in told}
        return _Published(True, frozenset(map(str, content["files"])), "sha256" in content, sha256)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return _Published()


def _check_room(out: Path, files: Mapping[str, Path], inputs: set[str], earlier: _Published) -> None:
    """Raise OutputConflict if a file of the user's would be replaced."""
    for name in (*files, RESULT):
        if (kind := special_kind(out / name)) is not None:
            raise OutputConflict(
                f"{out / name} is a {kind} where a file of the result belongs: move it away and run again"
            )
    new = {name: path for name, path in files.items() if (out / name).exists() and not _same(out / name, path)}
    taken = {name for name in new if _is_one_of(inputs, out / name) or not is_regular(out / name)}
    if not earlier.known and (out / RESULT).exists():
        taken.add(RESULT)
    if not earlier.known or earlier.complete:  # beside an older version's, `hfb report` may have left such files
        taken |= new.keys() - earlier.files
    if taken:
        raise OutputConflict(
            f"{out} holds {', '.join(sorted(taken))}, an input of this run or no file of hfb's, which the result would "
            "replace: move it away and run again (what was computed is kept), or choose another --out"
        )


def _mark(out: Path, result: Mapping[str, Any], earlier: _Published) -> None:
    """Replace result.json by the note, which names old and new files, so that the next run replaces both."""
    note: dict[str, Any] = {
        UNFINISHED: "files are being replaced; where no hfb is running, run the same command again",
        "out": result["out"],
        "inputs": result.get("inputs", {}),
        "files": sorted({*result.get("files", ()), *earlier.files}),
    }
    if earlier.complete or not earlier.known:
        new = result.get("sha256", {})
        told = {name: [*earlier.sha256.get(name, ()), new.get(name)] for name in note["files"]}
        note["sha256"] = {name: [one for one in several if one is not None] for name, several in told.items()}
    write_bytes_atomic(out / RESULT, _as_json(note))


def _remove_stale(out: Path, earlier: _Published, files: Mapping[str, Path], inputs: set[str]) -> None:
    """Remove the earlier result's further files, unless they were changed since hfb wrote them."""
    for name in earlier.files - files.keys():
        path = out / name
        if not _is_a_name_of_hfb(name) or not is_regular(path) or _is_one_of(inputs, path):
            continue
        if earlier.wrote(name, path):
            path.unlink()


def _clear(staging: Path, names: set[str]) -> None:
    """Remove the staging folder with the files of a killed run."""
    for entry in list(os.scandir(staging)):
        name = leftover_of(entry.name) or entry.name
        if (name in names or _is_a_name_of_hfb(name)) and entry.is_file(follow_symlinks=False):
            (staging / entry.name).unlink()
    with suppress(OSError):  # something else lies in it
        staging.rmdir()


def _only_sometimes(name: str) -> bool:
    return name in _ONLY_SOMETIMES or _MATTE.fullmatch(name) is not None


def _is_a_name_of_hfb(name: str) -> bool:
    """Return whether hfb writes files of this name: the folder may be of foreign origin, with any result.json."""
    return name in (*_OF_MOTIONS, RESULT) or _only_sometimes(name)


def _same(path: Path, other: Path) -> bool:
    return is_regular(path) and sha256_of(path) == sha256_of(other)


def _is_one_of(inputs: set[str], path: Path) -> bool:
    return is_regular(path) and sha256_of(path) in inputs
