"""Files that appear whole or not at all: write beside the target, fsync, rename."""

import os
import re
import secrets
from pathlib import Path

_TEMPORARY = re.compile(r"\.(.+)\.\d+-[0-9a-f]+\.part(\.\w+)?", re.DOTALL)


def temporary_beside(path: Path, suffix: str = "") -> Path:
    """Return a temporary name in a file's folder, for the time in which it is written.

    Args:
        path: the file to be written.
        suffix: ending of a file whose writer goes by it; ``path`` is then given without it.
    """
    return path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part{suffix}")


def leftover_of(name: str) -> str | None:
    """Return the target's name of a killed writer's temporary file; None for any other file.

    Args:
        name: name of a file.
    """
    found = _TEMPORARY.fullmatch(name)
    return found[1] + (found[2] or "") if found else None


def write_bytes_atomic(path: Path, data: bytes) -> None:
    """Write `data` to `path`; a reader (or a crash) sees the old file or the new one, never half of one.

    Args:
        path: the file; its folder is created.
        data: content.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_beside(path)
    try:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make a rename durable, where the system can (not on every network file system).

    Args:
        folder: the renamed file's folder.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        pass
    finally:
        os.close(descriptor)
