"""A run's folder: one worker at a time, results that appear together or not at all, nothing left after an error.

OUT/motion.npz strip.png texture.png matte_0.png ... result.json    the latest finished result
OUT/intermediate/                                                   what tasks leave for each other
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hfb.errors import Busy, InputError, NotNow
from hfb.export.names import CURVES, EXPORTED_NAMES, REPORT, RESULT
from hfb.media.atomic import write_bytes_atomic
from tasks.handles import sha256_of
from tasks.secrets import hidden_in

INTERMEDIATE = "intermediate"
_OF_MOTIONS = ("motion.npz", "texture.png", "strip.png", CURVES, "edges.json")  # results of several people have none
_ONLY_SOMETIMES = ("alternatives.npz", REPORT, *EXPORTED_NAMES)  # an earlier result may have had more
_MATTE = re.compile(r"matte_\d+\.png")


class Occupied(InputError):
    """A file of the user's lies where a result belongs; what was computed is kept."""


@contextmanager
def workplace(out: Path) -> Iterator[Path]:
    """The folder for intermediate files, held for this process alone.

    It stays after a crash, so that the next run goes on from there; after an InputError what was not there
    before is removed again.

    Raises:
        InputError: the folder cannot be written, or another process works in it.
    """
    new_folders = [folder for folder in (out / INTERMEDIATE, out, *out.parents) if not folder.exists()]
    check_writable(out)
    folder = out / INTERMEDIATE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / ".lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                new_folders = []
                raise Busy(
                    f"another hfb is working in {out}: wait until it has finished, or choose another --out"
                ) from None
            for leftover in (*out.glob(".*.part"), *folder.glob(".*.part")):
                leftover.unlink(missing_ok=True)
            yield folder
    except Occupied:
        raise
    except InputError:
        if folder in new_folders:
            shutil.rmtree(folder, ignore_errors=True)
        for created in new_folders:
            with suppress(OSError):  # something else lies in it
                created.rmdir()
        raise


def check_writable(out: Path) -> None:
    """Raises InputError where a folder cannot be made, or written into; makes nothing."""
    ground = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    if not ground.is_dir():
        raise NotNow(f"{out} cannot be a folder, since {ground} is a file: choose another --out")
    if not os.access(ground, os.W_OK | os.X_OK):
        raise NotNow(f"{out} cannot be written, {ground} is not yours to write: choose another --out")


def publish(out: Path, files: Mapping[str, Path], result: dict[str, Any]) -> None:
    """Put finished files into the run's folder, result.json last; an earlier result stays whole until then.

    What an earlier result had beyond this one is removed, and nothing else.

    Args:
        result: the content of result.json; it gets ``files``, the names of the others.

    Raises:
        Occupied: a file would take the place of an input of this run, or of one that hfb did not put there.
    """
    staging = out / INTERMEDIATE / "publish"
    inputs = set(result.get("inputs", {}).values())
    earlier, begun = _published(out, out), _published(staging, out)  # begun: by a run that was killed meanwhile
    ours = (earlier or set()) | (begun or set())
    new = {name: path for name, path in files.items() if (out / name).exists() and not _same(out / name, path)}
    taken = {name for name in new if _is_one_of(inputs, out / name)}
    if earlier is None:  # beside a result, `hfb report` and `hfb export` may have left files of these names
        taken |= new.keys() - ours | ({RESULT} if (out / RESULT).exists() else set())
    if taken:
        raise Occupied(
            f"{out} holds {', '.join(sorted(taken))}, an input of this run or no file of hfb's, which the result would "
            "replace: move it away and run again (what was computed is kept), or choose another --out"
        )
    result["files"] = sorted(files)
    staging.mkdir(exist_ok=True)
    for name, path in files.items():
        write_bytes_atomic(staging / name, path.read_bytes())
    write_bytes_atomic(staging / RESULT, _as_json(result))
    for stale in (out / name for name in ours - files.keys() if _is_a_name_of_hfb(name)):
        if stale.is_file() and not _is_one_of(inputs, stale):
            stale.unlink()
    for name in (*files, RESULT):
        (staging / name).replace(out / name)
    shutil.rmtree(staging)


@contextmanager
def beside_result(out: Path, names: Iterable[str]) -> Iterator[None]:
    """Where files go that are made of a result later on: beside one they count as its own, and go when another comes.

    Raises:
        Busy: another process works there.
    """
    if _published(out, out) is None:
        yield
        return
    with workplace(out):
        yield
        result = json.loads((out / RESULT).read_bytes())
        if "files" in result:  # else they are known by their names
            result["files"] = sorted({*result["files"], *names})
            write_bytes_atomic(out / RESULT, _as_json(result))


def _as_json(result: dict[str, Any]) -> bytes:
    return json.dumps(hidden_in(result), indent=2, allow_nan=False).encode() + b"\n"


def _published(folder: Path, out: Path) -> set[str] | None:
    """The files that hfb's result.json in a folder names; None where there is none.

    Where an older version did not name them, what in ``out`` has a name that only some results have is taken for its.
    """
    try:
        content = json.loads((folder / RESULT).read_bytes())
        if not isinstance(content["out"], str):
            return None
        if "files" in content:
            return {str(name) for name in content["files"]}
        return {path.name for path in out.iterdir() if path.name in _ONLY_SOMETIMES or _MATTE.fullmatch(path.name)}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _is_a_name_of_hfb(name: str) -> bool:
    """The folder may be from somebody else, whose result.json names anything."""
    return name in _OF_MOTIONS or name in _ONLY_SOMETIMES or _MATTE.fullmatch(name) is not None


def _same(path: Path, other: Path) -> bool:
    return path.is_file() and sha256_of(path) == sha256_of(other)


def _is_one_of(inputs: set[str], path: Path) -> bool:
    return path.is_file() and sha256_of(path) in inputs
