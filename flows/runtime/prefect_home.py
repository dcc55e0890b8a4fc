"""hfb's own Prefect home: the user's settings apply, the user's database is never opened. Light to import.

Prefect's default home holds a database that every Prefect of the user migrates to its own version. hfb's temporary
server therefore has a home of its own; only the profiles, which name the API address and its login, are the user's.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

import platformdirs

from hfb.errors import InputError, TemporaryError

_HOME, _PROFILES = "PREFECT_HOME", "PREFECT_PROFILES_PATH"
_OWN = "hfb"  # below a PREFECT_HOME of the user
_USERS_HOME = "~/.prefect"


def use_own_home() -> None:
    """Set PREFECT_HOME to hfb's own folder: below the user's where one is set, else in the user's state folder.

    Must be called before Prefect is imported. Processes that a command of hfb starts have the same home.
    """
    with suppress(RuntimeError):  # no home folder is known: `check_home` says so
        default = platformdirs.user_state_path("hfb") / "prefect"
        configured = Path(os.environ[_HOME]).expanduser().absolute() if os.environ.get(_HOME) else None
        if configured is None or (configured != default and configured.name != _OWN):
            users = configured or Path(_USERS_HOME).expanduser()
            os.environ[_PROFILES] = os.environ.get(_PROFILES) or str(users / "profiles.toml")
            os.environ[_HOME] = str(default if configured is None else configured / _OWN)


def check_home() -> None:
    """Raise InputError if the user's home folder is unknown, so that files would land in a folder called ~."""
    try:
        Path.home()
    except RuntimeError:
        raise InputError("your home folder is not known: set HOME to a folder of yours") from None


def make_home() -> str | None:
    """Make hfb's Prefect home; where it cannot be written, take a temporary one for this process.

    Returns:
        a remark for the user about a temporary home; None for the regular one.

    Raises:
        TemporaryError: there is no place for a temporary home either.
    """
    home = Path(os.environ[_HOME])
    try:
        home.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=home):
            pass
        return None
    except OSError as error:
        reason = error.strerror or str(error)
    try:
        temporary = tempfile.mkdtemp(prefix="hfb-prefect-")
    except OSError as error:
        raise TemporaryError(
            f"no folder for temporary files can be written ({error.strerror}): set TMPDIR to one that can"
        ) from None
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    os.environ[_HOME] = str(Path(temporary) / _OWN)
    Path(os.environ[_HOME]).mkdir()
    variable = "XDG_STATE_HOME" if home == platformdirs.user_state_path("hfb") / "prefect" else "PREFECT_HOME"
    return f"{home} cannot be written ({reason}): Prefect's files are temporary; set {variable} to keep them"
