"""The resident process: it has imported everything, has no threads, and forks a child for every command.

    python -m hfb.flows.cli.resident PACKAGE FOLDER LIKENESS IDLE_SECONDS

`hfb.flows.cli.start` starts and uses it. It listens in a folder of the user's alone, serves processes of the same user
that are like the one that started it (code, interpreter, environment, limits), and ends when it was idle for long, or
when a process that is not like it asks. A fork copies only the calling thread: locks of others would stay taken for
ever. Nothing here starts one, which is checked before every fork.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import functools
import gc
import importlib
import json
import os
import select
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TextIO

from hfb.flows.cli.start import FORWARDED, OCCUPIED, PACKAGE, check_peer, receive, send, share_memory
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.progress import Display
from hfb.tasks.tracking.store_client import load_mlflow, load_stores

# What a fit imports besides the chain, at the moment it needs it.
_LATE = (
    *("prefect.flow_engine", "prefect.task_engine", "prefect.utilities.visualization", "graphviz", "PIL.Image"),
    *("hfb.interop.writers.motion_exports", "hfb.matting.methods", "hfb.matting.plate_check", "scipy.interpolate"),
    *("hfb.report.films.slow_motion", "hfb.report.films.page_film", "hfb.report.pages.result_page"),
    *("hfb.report.pages.viewer", "hfb.kernels.rendering.render_texture", "hfb.initialization.floor_shade"),
    *("matplotlib.backends.backend_agg", "matplotlib.figure", "hfb.tasks.batch.prometheus_metrics"),
)
_REQUEST_S = 5.0


class _Lines(Display):
    """Collects what is said where nobody reads."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, line: str) -> None:
        self.lines.append(line)


class _Keeper:
    """A process that keeps a temporary Prefect server for all commands, and ends it when the resident process ends.

    It has the locks of the server's database, and what ends the server; a fork of the resident process has neither.
    """

    def __init__(self, listener: socket.socket, lock: int) -> None:
        """Start the server; `url` waits until it answers.

        Args:
            listener: of the resident process; another one could not take its place while this process had it open.
            lock: likewise.
        """
        self._told, tells = os.pipe()
        lives, self._life = os.pipe()
        if os.fork() == 0:
            os.close(self._life)
            listener.close()
            os.close(lock)
            with contextlib.suppress(BaseException), os.fdopen(tells, "w") as tell:
                self._keep(tell, lives)
            os._exit(0)
        os.close(tells)
        os.close(lives)

    def _keep(self, tell: TextIO, lives: int) -> None:
        from hfb.flows.runtime.prefect_home import make_home
        from hfb.flows.runtime.server import PrefectServer, keep_log

        os.setsid()
        keep_log()
        said = _Lines()
        with progress.showing(said):
            if make_home() is None:
                server = PrefectServer()
                server.wait()
                json.dump({"url": os.environ["PREFECT_API_URL"], "said": said.lines}, tell)
                tell.close()
                os.read(lives, 1)
                atexit._run_exitfuncs()

    @functools.cached_property
    def _answer(self) -> dict[str, Any]:
        with os.fdopen(self._told) as told, contextlib.suppress(ValueError):
            return dict(json.load(told))
        return {}  # a command starts one of its own, and says what is wrong

    @property
    def url(self) -> str | None:
        """The server's address; None where it could not start."""
        return self._answer.get("url")

    def said(self) -> list[str]:
        """Return, once, what the user is to know."""
        return self._answer.pop("said", [])


@dataclass
class _Child:
    """A command that runs: its process, and the connection of the one who waits for it."""

    number: int
    pidfd: int
    connection: socket.socket


@dataclass
class Resident:
    """The loop of the process.

    Attributes:
        listener: the socket in the user's folder.
        lock: an open file, locked while this process is the one to find.
        like: hash of what its commands take from this process.
        idle_s: time without a command after which it ends.
        server: keeps Prefect's temporary server; None where the user has a server.
    """

    listener: socket.socket
    lock: int
    like: str
    idle_s: float
    server: _Keeper | None
    _children: dict[int, _Child] = field(default_factory=dict)
    _ends: bool = False
    _poll: select.poll = field(default_factory=select.poll)

    def serve(self, warm: Iterator[None]) -> Callable[[], NoReturn] | None:
        """Serve until idle, meanwhile warming up step by step.

        Args:
            warm: steps that make later commands faster.

        Returns:
            in a forked child what runs the command; None in this process, when it is to end.
        """
        self._poll.register(self.listener, select.POLLIN)
        is_warm, since = False, time.monotonic()
        while not (self._ends and not self._children):
            left_s = self.idle_s - (time.monotonic() - since)
            warms = not is_warm and not self._children
            ready = self._poll.poll(0 if warms else None if self._children else max(0.0, left_s) * 1e3)
            for file, _ in ready:
                since = time.monotonic()
                if file in self._children:
                    self._poll.unregister(file)
                    self._reap(self._children.pop(file))
                elif (found := self._accept()) is not None:
                    if isinstance(found, _Child):
                        self._children[found.pidfd] = found
                        self._poll.register(found.pidfd, select.POLLIN)
                    else:
                        return found
            if warms and not ready:
                is_warm = next(warm, self) is self
            elif not ready and left_s <= 0:
                break
        self._withdraw()
        return None

    def _withdraw(self) -> None:
        """Let another process take this one's place; commands that run go on."""
        if not self._ends:
            self._ends = True
            with contextlib.suppress(OSError):
                Path(self.listener.getsockname()).unlink()
            self._poll.unregister(self.listener)
            self.listener.close()
            os.close(self.lock)

    def _accept(self) -> _Child | Callable[[], NoReturn] | None:
        connection, _ = self.listener.accept()
        connection.settimeout(_REQUEST_S)
        try:
            check_peer(connection)
            alike = receive(connection)[0]["like"] == self.like
            if not alike:
                self._withdraw()
            send(connection, {"like": alike})
            if not alike:
                connection.close()
                return None
            request, files = receive(connection)
        except (OSError, ValueError, KeyError):
            connection.close()
            return None
        if len(list(Path("/proc/self/task").iterdir())) != 1:
            connection.close()  # the command runs elsewhere
            self._withdraw()
            return None
        connection.settimeout(None)
        if self.server:
            request |= {"server": self.server.url, "said": self.server.said()}
        number = os.fork()
        if number == 0:
            for other in self._children.values():
                other.connection.close()
                os.close(other.pidfd)
            self.listener.close()
            os.close(self.lock)
            return lambda: _run_and_leave(lambda: _run(request, files, connection), connection)
        for file in files:
            os.close(file)
        child = _Child(number, os.pidfd_open(number), connection)
        with contextlib.suppress(OSError):
            send(connection, {}, [child.pidfd])
        return child

    def _reap(self, child: _Child) -> None:
        _, status = os.waitpid(child.number, 0)
        if os.WIFSIGNALED(status):  # else it has said so itself, though this process were gone
            with contextlib.suppress(OSError):
                send(child.connection, {"code": -os.WTERMSIG(status)})
        child.connection.close()
        os.close(child.pidfd)


def _run(request: dict[str, Any], files: list[int], connection: socket.socket) -> int:
    """Run a command in a forked child, as a process of its own would run it; returns its exit code."""
    os.setsid()
    for number, file in enumerate(files[:3]):
        os.dup2(file, number)
    os.fchdir(files[3])
    for file in files:
        os.close(file)
    os.umask(request["umask"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = [request["program"], *request["words"]]
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=stream.isatty() or stream is sys.stderr)  # type: ignore[union-attr]
    for name in FORWARDED:
        default = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
        signal.signal(getattr(signal, name), signal.SIG_IGN if name in request["ignored"] else default)
    threading.Thread(target=_end_with, args=(connection,), name="hfb-client", daemon=True).start()
    from hfb.flows.cli.cli import main
    from hfb.flows.runtime.server import PrefectServer, does_not_answer

    for line in request.get("said", []):
        print(line, file=sys.stderr)
    if (server := request.get("server")) and not does_not_answer(server):
        from prefect.context import refresh_global_settings_context

        os.environ["PREFECT_API_URL"] = PrefectServer.lent = server
        refresh_global_settings_context()
    return main(request["words"])


def _end_with(connection: socket.socket) -> None:
    """End this process when the one who waits for it was killed, as the command itself would have been."""
    with contextlib.suppress(OSError):
        connection.recv(1)
    os.kill(os.getpid(), signal.SIGKILL)


def _run_and_leave(run: Callable[[], int], connection: socket.socket) -> NoReturn:
    """Run a child's command and end as an interpreter does, without the time it takes to free memory."""
    code: Any = 1
    try:
        code = run()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    if code is not None and not isinstance(code, int):
        print(code, file=sys.stderr)
        code = 1
    with contextlib.suppress(BaseException):
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    with contextlib.suppress(OSError):
        send(connection, {"code": (code or 0) & 0xFF})
    os._exit(code or 0)


def _import_all(listener: socket.socket, lock: int) -> _Keeper | None:
    """Import what every command needs; meanwhile Prefect's server starts, where the user has none."""
    from hfb.flows.runtime.server import load_prefect

    load_prefect()
    from prefect.settings import get_current_settings

    keeper = None if get_current_settings().api.url else _Keeper(listener, lock)
    for name in ("hfb.flows.cli.cli", "hfb.flows.fit_image", "hfb.flows.runtime.failures", "hfb.flows.runtime.reaper"):
        importlib.import_module(name)
    load_mlflow()
    return keeper


def _warm_up() -> Iterator[None]:
    """Import, one step after another, what commands import late, and load what they read whatever they are given."""
    for name in _LATE:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
        yield
    load_stores()
    import cv2

    from hfb.initialization.matte_search import bank_templates
    from hfb.kernels.compile import load_cached
    from hfb.matting.network import shipped_network, shipped_second, shipped_third
    from hfb.tasks.core.scene import load_chosen_body

    yield from load_cached()
    for load in (shipped_network, shipped_second, shipped_third):
        load()
        yield
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # more would begin here and not live in a fork
    bank_templates(load_chosen_body(None))
    cv2.setNumThreads(threads)
    yield
    gc.collect()
    gc.freeze()  # pages of which a collection in a child would make copies


def main() -> None:
    """Listen, import, serve."""
    package, folder, like, idle_s = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], float(sys.argv[4])
    if package != PACKAGE:
        sys.exit(f"hfb is {PACKAGE} here")  # another one on the path: its commands run by themselves
    share_memory()
    lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        sys.exit(OCCUPIED)
    place = folder / "socket"
    place.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(place))
    listener.listen()  # whoever comes now waits
    gc.disable()
    keeper = _import_all(listener, lock)
    gc.freeze()
    gc.enable()
    command = Resident(listener, lock, like, idle_s, keeper).serve(_warm_up())
    if command is not None:
        command()


if __name__ == "__main__":
    main()
