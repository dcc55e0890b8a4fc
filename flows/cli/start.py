"""The `hfb` program: hands a short command to the user's resident process, or runs it in this one.

The resident process (`hfb.flows.cli.resident`) has imported everything; it forks a child that runs the command with
this process's files, folder and environment. This process then only forwards signals and waits. It imports no more
than that needs. Whatever speaks against the resident process, the command runs here, as it would without one.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import select
import signal
import socket
import stat
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NoReturn

import hfb.flows  # sets this project's defaults in the environment

VARIABLE = "HFB_RESIDENT"
PACKAGE = Path(__file__).parents[2]
_COMMANDS = ("demo", "fit")
_IDLE_S = 600.0
_ARENA_MAX = -8  # of malloc.h
_STARTS_WITHIN_S = 60.0
# Of a terminal or a shell, read when a command begins; any other variable may count at an import.
_READ_LATE = (
    *("PWD", "OLDPWD", "SHLVL", "_", "COLUMNS", "LINES", "PS1", "WINDOWID", "DISPLAY", "WAYLAND_DISPLAY", VARIABLE),
    *("SSH_CLIENT", "SSH_CONNECTION", "SSH_TTY", "TMUX", "TMUX_PANE", "STY", "GPG_TTY", "XDG_SESSION_ID"),
)
# What a process inherits and the resident process, started by another one, may have otherwise.
_OF_PROCESS = ("Uid", "Gid", "Groups", "CapEff", "NoNewPrivs", "Seccomp", "Cpus_allowed", "Mems_allowed")
FORWARDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2")


def main() -> int:
    """Run the command of this process's words; returns the exit code."""
    words = sys.argv[1:]
    if words and words[0] in (*_COMMANDS, "video"):
        share_memory()
    idle_s = wanted(words)
    begun = None
    if idle_s is not None:
        with contextlib.suppress(OSError, ValueError, KeyError):
            begun = _begin(words, idle_s)
    if begun is not None:
        return _wait(*begun)
    from hfb.flows.cli.cli import main as run

    return run(words)


def share_memory() -> None:
    """Have all threads share one heap of the C library: what one freed another one uses; before any thread begins."""
    with contextlib.suppress(OSError, AttributeError, TypeError):  # another system's C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def wanted(words: list[str]) -> float | None:
    """Return for how many seconds a resident process stays idle; None where the command runs in this process.

    HFB_RESIDENT=0 switches it off, another number of seconds switches it on. Without the variable a command at a
    terminal uses it: a script, a service or a CI job would leave a process behind that nobody expects.

    Args:
        words: of the command line.
    """
    if not words or words[0] not in _COMMANDS or {"-h", "--help", "--help-all"} & set(words):
        return None
    if sys.platform != "linux" or not hasattr(os, "pidfd_open") or _settings_here():
        return None
    said = os.environ.get(VARIABLE, "")
    if said:
        with contextlib.suppress(ValueError):
            return float(said) if float(said) > 0 else None
        return None
    return _IDLE_S if os.isatty(0) and os.isatty(2) else None


def _settings_here() -> bool:
    """Return whether this folder has settings that a library reads when it is imported."""
    project = Path("pyproject.toml")
    with contextlib.suppress(OSError):
        if b"tool.prefect" in project.read_bytes():
            return True
    return any(Path(name).exists() for name in (".env", "prefect.toml", ".numba_config.yaml", "matplotlibrc"))


def _begin(words: list[str], idle_s: float) -> tuple[socket.socket, int]:
    """Have a child of the resident process begin a command; returns what `_wait` needs.

    Raises OSError where there is none. A child that began all the same ends with the connection, which is closed then.
    """
    files = [os.dup(number) for number in (0, 1, 2)]  # OSError: one is closed
    files.append(os.open(".", os.O_RDONLY | os.O_DIRECTORY))
    ignored = [name for name in FORWARDED if signal.getsignal(getattr(signal, name)) is signal.SIG_IGN]
    umask = os.umask(0o077)
    os.umask(umask)
    request = {"words": words, "program": sys.argv[0], "environment": dict(os.environ), "umask": umask}
    resident = _connection(idle_s)
    try:
        send(resident, {**request, "ignored": ignored}, files)
        for file in files:
            os.close(file)
        resident.settimeout(_STARTS_WITHIN_S)
        _, (child,) = receive(resident)  # OSError: it ended, or cannot fork
        resident.settimeout(None)
    except BaseException:
        resident.close()
        raise
    return resident, child


def _wait(resident: socket.socket, child: int) -> int:
    """Forward signals to the child until it has ended; returns its exit code, or ends by its signal.

    Args:
        resident: tells the code, or the signal as a negative number.
        child: its pidfd.
    """

    def forward(number: int, _frame: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(child, number)

    def stop(number: int, _frame: object) -> None:
        forward(signal.SIGSTOP, None)
        os.kill(os.getpid(), signal.SIGSTOP)  # goes on here when it is continued
        forward(signal.SIGCONT, None)

    for name in FORWARDED:
        if signal.getsignal(number := getattr(signal, name)) is not signal.SIG_IGN:
            signal.signal(number, forward)
    signal.signal(signal.SIGTSTP, stop)
    try:
        code = int(receive(resident)[0]["code"])
    except OSError:  # the resident process was killed, and the child after it
        select.select([child], [], [])
        print("hfb: the command was killed; the same command goes on from there", file=sys.stderr)
        return 1
    if code < 0:
        _end_by(-code)
    return code


def _end_by(number: int) -> NoReturn:
    if number != signal.SIGKILL:
        signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
    os._exit(128 + number)


def _connection(idle_s: float) -> socket.socket:
    """Return a connection to a resident process that is like this one; starts it where there is none. OSError."""
    place, like = private_folder(), _likeness()
    deadline = time.monotonic() + _STARTS_WITHIN_S
    starter: subprocess.Popen[bytes] | None = None
    while True:
        with contextlib.suppress(ConnectionError, FileNotFoundError):
            found = socket.socket(socket.AF_UNIX)
            found.settimeout(_STARTS_WITHIN_S)
            found.connect(str(place / "socket"))
            check_peer(found)
            send(found, {"like": like})
            if receive(found)[0]["like"]:
                return found
            found.close()  # it is of another version, or of other surroundings, and ends now
        if starter is None or (starter.poll() is not None and starter.returncode == OCCUPIED):
            command = [sys.executable, *subprocess._args_from_interpreter_flags(), "-m"]  # type: ignore[attr-defined]
            command += ["hfb.flows.cli.resident", str(PACKAGE), str(place), like, str(idle_s)]
            starter = subprocess.Popen(
                command,
                cwd="/",
                env={**os.environ, "JE_ARROW_MALLOC_CONF": "background_thread:false"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        elif starter.poll() is not None or time.monotonic() > deadline:
            raise OSError("no resident process")
        time.sleep(0.02)


OCCUPIED = 75
"""Exit code of a resident process that finds another one."""


def private_folder() -> Path:
    """Return a folder that this user alone can enter. Raises OSError where it is somebody else's."""
    run = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(run) / "hfb" if run else Path(tempfile.gettempdir()) / f"hfb-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{folder} is not this user's alone")
    return folder


def check_peer(connection: socket.socket) -> None:
    """Raise PermissionError unless the process at the other end is this user's.

    Args:
        connection: a Unix socket.
    """
    said = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    if struct.unpack("3i", said)[1] != os.getuid():
        raise PermissionError("the process at the other end is not this user's")


def _likeness() -> str:
    """Return a hash of all that a forked command takes from the resident process: code, interpreter, surroundings."""
    folders = [PACKAGE, PACKAGE / "flows", PACKAGE / "tasks"]  # links, in a source tree
    sources = [path for one in folders for path in one.resolve().rglob("*") if path.suffix not in ("", ".pyc")]
    newest = max(path.stat().st_mtime_ns for path in sources)
    installed = [Path(path).stat().st_mtime_ns for path in sys.path[1:] if Path(path).is_dir()]
    status = Path("/proc/self/status").read_text().splitlines()
    process = [line for line in status if line.partition(":")[0] in _OF_PROCESS]
    process += [Path(f"/proc/self/{name}").read_text() for name in ("limits", "cgroup", "oom_score_adj")]
    process += [str(Path(f"/proc/self/{name}").readlink()) for name in ("root", "ns/mnt", "ns/pid", "ns/net")]
    profiles = Path(os.environ.get("PREFECT_PROFILES_PATH", ""))
    process += [str(profiles.stat().st_mtime_ns if profiles.is_file() else None)]
    environment = sorted((name, value) for name, value in os.environ.items() if name not in _READ_LATE)
    interpreter = [sys.version, sys.prefix, sys.executable, list(sys.flags), sorted(sys._xoptions), sys.warnoptions]
    everything = [hfb.__version__, str(PACKAGE), newest, len(sources), installed, interpreter, sys.path[1:], process]
    everything += [environment, os.getpriority(os.PRIO_PROCESS, 0)]
    return hashlib.sha256(json.dumps(everything).encode()).hexdigest()


def send(connection: socket.socket, message: dict[str, Any], files: list[int] | None = None) -> None:
    """Send a message, and open files with its first byte.

    Args:
        connection: a Unix socket.
        message: plain values.
        files: file descriptors.
    """
    text = json.dumps(message).encode()
    socket.send_fds(connection, [struct.pack("!I", len(text))], files or [])
    connection.sendall(text)


def receive(connection: socket.socket) -> tuple[dict[str, Any], list[int]]:
    """Return the next message and its files. Raises ConnectionError where the other end has gone.

    Args:
        connection: a Unix socket.
    """
    head, files, _, _ = socket.recv_fds(connection, 4, 8)
    rest = struct.unpack("!I", head)[0] if len(head) == 4 else 0
    text = b""
    while len(text) < rest and (part := connection.recv(rest - len(text))):
        text += part
    if not rest or len(text) < rest:
        raise ConnectionResetError("the other end has gone")
    for file in files:
        os.set_inheritable(file, False)
    return json.loads(text), files


if __name__ == "__main__":
    sys.exit(main())
