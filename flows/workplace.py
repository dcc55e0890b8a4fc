"""A run's folder: one worker at a time, results that appear together or not at all, nothing left after an error.

OUT/motion.npz strip.png texture.png matte_0.png ... result.json    the latest finished result
OUT/intermediate/                                                   what tasks leave for each other
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hfb.errors import Busy, InputError
from hfb.export.names import EXPORTED_NAMES, REPORT
from hfb.media.atomic import write_bytes_atomic

INTERMEDIATE = "intermediate"
_ONLY_SOMETIMES = ("alternatives.npz", REPORT, *EXPORTED_NAMES)  # an earlier result may have had more


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
        raise InputError(f"{out} cannot be a folder, since {ground} is a file: choose another --out")
    if not os.access(ground, os.W_OK | os.X_OK):
        raise InputError(f"{out} cannot be written, {ground} is not yours to write: choose another --out")


def publish(out: Path, files: Mapping[str, Path], result: Mapping[str, Any]) -> None:
    """Put finished files into the run's folder, result.json last; an earlier result stays whole until then."""
    staging = out / INTERMEDIATE / "publish"
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir()
    for name, path in files.items():
        write_bytes_atomic(staging / name, path.read_bytes())
    write_bytes_atomic(staging / "result.json", json.dumps(result, indent=2, allow_nan=False).encode() + b"\n")
    for stale in (*out.glob("matte_*.png"), *(out / name for name in _ONLY_SOMETIMES)):
        stale.unlink(missing_ok=True)
    for name in (*files, "result.json"):
        (staging / name).replace(out / name)
    staging.rmdir()
