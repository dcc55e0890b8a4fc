"""Files of hfb in a folder without a result: a record names them, and other files are never replaced."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from hfb.errors import InputError, TemporaryError
from hfb.io.atomic import write_bytes_atomic
from hfb.io.safe_folder import check_ordinary, is_regular, read_file
from hfb.tasks.core.handles import sha256_of

OWN_FILES = ".hfb-files.json"
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
        known = _check_room(out, names)
        if not made:
            return
        now = {name: sha256_of(path) for name, path in made.items()}
        _write(out, {**known, **{name: (*known.get(name, ()), one) for name, one in now.items()}})
        for name, path in made.items():
            write_bytes_atomic(out / name, path.read_bytes())
        _write(out, {**known, **{name: (one,) for name, one in now.items()}})


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
