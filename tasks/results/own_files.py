"""Files of hfb in a folder without a result: a record names them, and other files are never replaced."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import lock_descriptor

from hfb.errors import InputError, TemporaryError
from hfb.io.atomic import sync_folder, write_bytes_atomic
from hfb.io.safe_folder import check_ordinary, check_tree, is_regular, open_folder, read_file
from hfb.tasks.core.handles import sha256_of

OWN_FILES = ".hfb-files.json"
_STAGING = ".hfb-part"
_LIMIT_BYTES = 1 << 20


@contextmanager
def among_own_files(out: Path, names: Sequence[str]) -> Iterator[Path]:
    """Provide a temporary folder inside the block, whose files are moved into ``out`` at its end.

    The record is written first, so that files of a killed command are known as well.

    Args:
        out: the folder.
        names: of the files.

    Raises:
        TemporaryError: a file of one of the names was not written by hfb, or was changed since.
    """
    _check_room(out, names)
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)
        made = {name: Path(folder) / name for name in names if is_regular(Path(folder) / name)}
        if not made:
            _check_room(out, names)
            return
        out.mkdir(parents=True, exist_ok=True)
        with open_folder(out) as descriptor:
            with suppress(OSError):  # NFS locks no folders
                lock_descriptor(descriptor)  # files of two commands at once would be mixed
            known = _check_room(out, names)
            now = {name: sha256_of(path) for name, path in made.items()}
            _write(out, {**known, **{name: (*known.get(name, ()), one) for name, one in now.items()}})
            put_together(out, {name: path.read_bytes() for name, path in made.items()})
            _write(out, {**known, **{name: (one,) for name, one in now.items()}})


def put_together(out: Path, files: Mapping[str, bytes]) -> None:
    """Put files into a folder: a full disk leaves the old ones, a kill some of the old ones or of the new, never both.

    Args:
        out: the folder.
        files: name -> content; the first one is never missing.
    """
    check_tree(out, _STAGING)
    staged = {name: out / _STAGING / name for name in files}
    try:
        for name, data in files.items():
            write_bytes_atomic(staged[name], data)
        replace_together(out, staged)
    finally:
        for path in staged.values():
            path.unlink(missing_ok=True)
        with suppress(OSError):  # something else lies in it
            (out / _STAGING).rmdir()


def replace_together(out: Path, files: Mapping[str, Path]) -> None:
    """Move files into their folder as `put_together` does.

    Args:
        out: the folder.
        files: name -> current place, on the same disk; the first one is never missing.
    """
    for name in list(files)[1:]:
        (out / name).unlink(missing_ok=True)
    for name, path in files.items():
        path.replace(out / name)
    sync_folder(out)


def _check_room(out: Path, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the record of a folder; raises where a foreign file is in the way."""
    check_ordinary(out, OWN_FILES)
    for name in names:
        check_ordinary(out, name)
    known = _read(out)
    there = [name for name in names if (out / name).exists()]
    foreign = [name for name in there if not is_regular(out / name) or sha256_of(out / name) not in known.get(name, ())]
    if foreign:
        raise TemporaryError(
            f"{out} holds {', '.join(foreign)}, which is not as hfb wrote it there, if it did: move it away, or choose "
            "another --out"
        )
    return known


def _read(out: Path) -> dict[str, tuple[str, ...]]:
    """Return name -> sha256 of hfb's files; several where a command was killed while it replaced one."""
    try:
        content = json.loads(read_file(out, OWN_FILES, limit=_LIMIT_BYTES))
        return {str(name): tuple(map(str, several)) for name, several in content["sha256"].items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise InputError(f"{out / OWN_FILES} is damaged: remove it, and move away what hfb is to write again") from None


def _write(out: Path, known: Mapping[str, Sequence[str]]) -> None:
    content = {"about": "what hfb wrote here; it replaces nothing else", "sha256": known}
    write_bytes_atomic(out / OWN_FILES, json.dumps(content, indent=1).encode() + b"\n")
