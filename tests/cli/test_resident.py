"""The resident process: commands that find it do as they do without it, and it never stays where nobody wants it."""

import contextlib
import json
import os
import pty
import shlex
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.orchestration import TINY_OPTIONS, Problem, tiny_problem

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="there is none elsewhere")
MISTAKE = ("fit", "none.png", "--background", "none.png")

LASTING, LONG = (("--fit.stages", f'[{{"size_px": 32, "iterations": {count}}}]') for count in (1_000, 100_000))
"""A fit that some seconds of a busy machine do not see end, and one that minutes do not."""


@dataclass
class Place:
    """Where commands run: a runtime folder of their own, and what they leave elsewhere."""

    folder: Path
    problem: Problem

    def environment(self, **more: str) -> dict[str, str]:
        there = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "MLFLOW_"))}
        there |= {"XDG_RUNTIME_DIR": str(self.folder), "HFB_RESIDENT": "60", "TMPDIR": str(self.folder)}
        there |= {"MLFLOW_TRACKING_URI": f"sqlite:///{self.folder / 'mlflow.db'}"}
        return there | {"XDG_STATE_HOME": str(self.folder / "state")} | more

    def start(self, *words: str, **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "hfb.flows.cli.start", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=self.folder / "problem",
            env=self.environment(**environment),
            preexec_fn=lambda: [signal.signal(sent, signal.SIG_DFL) for sent in (signal.SIGINT, signal.SIGHUP)],
        )

    def run(self, *words: str, **environment: str) -> tuple[int, str, str]:
        with self.start(*words, **environment) as command:
            out, said = command.communicate(timeout=240)
        return command.returncode, out, said

    def fit(self, out: str, *options: str) -> tuple[str, ...]:
        problem = self.problem
        words = ("fit", str(problem.frame), "--background", str(problem.background), "--out", out)
        return (*words, *TINY_OPTIONS, *options)

    def found(self) -> int:
        process = self.resident()
        assert process is not None
        return process

    def resident(self) -> int | None:
        """The number of the resident process that answers here."""
        with socket.socket(socket.AF_UNIX) as probe:
            try:
                probe.connect(str(self.folder / "hfb" / "socket"))
            except OSError:
                return None
            return struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]


@pytest.fixture(scope="module")
def place() -> Iterator[Place]:
    with tempfile.TemporaryDirectory(prefix="hfb-r") as folder:  # short: a socket's name has 108 characters
        found = Place(Path(folder), tiny_problem(Path(folder) / "problem"))
        yield found
        if process := found.resident():
            os.kill(process, signal.SIGTERM)
            ended(process)


def state_of(process: int | None) -> str:
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]


def ended(process: int, within_s: float = 20) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if state_of(process) not in "ZX":
                time.sleep(0.05)
                continue
        return True
    return False


def rest(process: int) -> None:
    """Wait until a process has nothing to do: it has warmed up."""
    before = -1
    while (now := sum(map(int, Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]))) != before:
        before = now
        time.sleep(1.5)


def child_of(parent: int) -> int | None:
    """The command that a resident process runs; the other child keeps Prefect's server and has a child of its own."""
    for process in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        names = {path.read_text().strip() for path in Path(f"/proc/{process}/task").glob("*/comm")}
        if "hfb-client" in names or len(list(Path(f"/proc/{process}/task").iterdir())) > 1:
            return int(process)
    return None


def test_the_same_result_as_without_it(place: Place) -> None:
    code, alone, said = place.run(*place.fit("alone", "--json"), HFB_RESIDENT="0")
    assert code == 0, said
    assert place.resident() is None
    code, _, said = place.run(*place.fit("first", "--json"))
    assert code == 0, said
    process = place.found()
    code, second, said = place.run(*place.fit("second", "--json"))
    assert code == 0, said
    assert place.resident() == process
    for name in ("first", "second"):
        files = (place.folder / "problem" / one / "motion.npz" for one in ("alone", name))
        one, other = (dict(np.load(file)) for file in files)
        assert one.keys() == other.keys()
        assert all(np.array_equal(one[key], other[key]) for key in one)
    assert json.loads(alone).keys() == json.loads(second).keys()
    assert "libraries:" in said
    rest(process)
    assert len(list(Path(f"/proc/{process}/task").iterdir())) == 1
    place.run(*MISTAKE)
    assert place.resident() == process


def test_mistakes_are_told_as_without_it(place: Place) -> None:
    assert place.run(*MISTAKE) == place.run(*MISTAKE, HFB_RESIDENT="0")
    assert place.run(*MISTAKE)[0] == 2
    assert place.run("fit", "--help") == place.run("fit", "--help", HFB_RESIDENT="0")


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "TERM"])
def test_signals_reach_the_command(sent: int, code: int, place: Place) -> None:
    with place.start(*place.fit(f"signal-{code}", *LONG)) as command:
        shown = ""
        for line in command.stderr or ():
            shown += line
            if line.startswith("matte: "):
                command.send_signal(sent)
    assert command.returncode == code, shown
    assert "Traceback" not in shown
    assert not (place.folder / "problem" / f"signal-{code}" / "result.json").exists()


def test_a_killed_or_hung_up_client_ends_its_command(place: Place) -> None:
    for sent in (signal.SIGKILL, signal.SIGHUP):
        with place.start(*place.fit(f"gone-{sent}", *LONG)) as command:
            for line in command.stderr or ():
                if line.startswith("matte: "):
                    process = child_of(place.found())
                    command.send_signal(sent)
                    break
            assert command.wait(timeout=30) == -sent
        assert process is not None
        assert ended(process)
        assert not (place.folder / "problem" / f"gone-{sent}" / "result.json").exists()


def test_ctrl_z_stops_a_command_and_fg_goes_on_with_it(place: Place) -> None:
    """In a real shell with job control, on a terminal."""
    shell, terminal = pty.fork()
    if shell == 0:
        os.chdir(place.folder / "problem")
        os.execvpe("bash", ["bash", "--norc", "--noprofile", "-i"], place.environment(TERM="dumb"))
    shown = bytearray()

    def read() -> None:
        with contextlib.suppress(OSError):  # the shell has ended
            while part := os.read(terminal, 1 << 12):
                shown.extend(part)

    def wait(is_so: Callable[[], object]) -> None:
        deadline = time.monotonic() + 120
        while not is_so():
            assert time.monotonic() < deadline, shown.decode()
            time.sleep(0.1)

    def type_in(line: str) -> None:
        os.write(terminal, line.encode())

    threading.Thread(target=read, daemon=True).start()
    type_in(shlex.join([sys.executable, "-m", "hfb.flows.cli.start", *place.fit("stopped", *LASTING)]) + "\n")
    wait(lambda: b"matte: " in shown or b"first body" in shown)
    command = child_of(place.found())
    type_in("\x1a")
    wait(lambda: b"Stopped" in shown)
    wait(lambda: state_of(command) == "T")
    type_in("fg\n")
    wait(lambda: state_of(command) != "T")
    type_in("echo ended with $?; exit\n")
    wait(lambda: b"ended with 0" in shown)
    os.waitpid(shell, 0)
    assert (place.folder / "problem/stopped/result.json").exists()


def test_two_at_once(place: Place) -> None:
    place.run(*MISTAKE)
    process = place.found()
    both = [place.start(*place.fit(name)) for name in ("left", "right")]
    for command in both:
        _, said = command.communicate(timeout=240)
        assert command.returncode == 0, said
    assert place.resident() == process


def test_other_surroundings_have_another_process(place: Place) -> None:
    place.run(*MISTAKE)
    process = place.found()
    assert place.run(*MISTAKE, NUMBA_BOUNDSCHECK="1")[0] == 2
    assert place.resident() not in (None, process)
    assert ended(process)


def test_a_killed_one_is_replaced_and_an_idle_one_ends(place: Place) -> None:
    place.run(*MISTAKE)
    process = place.found()
    os.kill(process, signal.SIGKILL)
    assert ended(process)
    assert place.run(*MISTAKE, HFB_RESIDENT="2")[0] == 2
    process = place.found()
    servers = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    assert servers
    assert ended(process)
    assert place.resident() is None
    assert not (place.folder / "hfb/socket").exists()
    assert all(ended(int(one)) for one in servers)


def test_a_folder_that_others_can_enter_is_not_used(place: Place, tmp_path: Path) -> None:
    (tmp_path / "hfb").mkdir(mode=0o755)
    code, _, said = place.run(*MISTAKE, XDG_RUNTIME_DIR=str(tmp_path))
    assert (code, "none.png does not exist" in said) == (2, True)
    assert not list((tmp_path / "hfb").iterdir())


@pytest.mark.skipif(os.getuid() != 0, reason="only root can act as another user")
def test_another_users_socket_is_not_used(place: Place, tmp_path: Path) -> None:
    """Somebody else listens where the resident process would."""
    (tmp_path / "hfb").mkdir(mode=0o700)
    pid = os.fork()
    if pid == 0:
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(tmp_path / "hfb/socket"))
            os.setuid(65534)
            listener.listen()
            connection, _ = listener.accept()
            os._exit(1 if connection.recv(1) else 0)
    while str(tmp_path / "hfb/socket") not in Path("/proc/net/unix").read_text():
        time.sleep(0.01)
    time.sleep(0.5)  # it listens
    code, _, said = place.run(*MISTAKE, XDG_RUNTIME_DIR=str(tmp_path))
    assert (code, "none.png does not exist" in said) == (2, True)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0  # nothing was sent to it


def test_scripts_leave_no_process_behind_and_terminals_do(place: Place, tmp_path: Path) -> None:
    environment = place.environment(XDG_RUNTIME_DIR=str(tmp_path))
    del environment["HFB_RESIDENT"]
    words = [sys.executable, "-m", "hfb.flows.cli.start", *MISTAKE]
    assert subprocess.run(words, env=environment, capture_output=True, cwd=tmp_path, check=False).returncode == 2
    assert not (tmp_path / "hfb").exists()
    master, slave = pty.openpty()
    threading.Thread(target=lambda: os.read(master, 1 << 16), daemon=True).start()
    command = subprocess.run(words, env=environment, stdin=slave, stdout=slave, stderr=slave, cwd=tmp_path, check=False)
    assert command.returncode == 2
    process = Place(tmp_path, place.problem).found()
    os.kill(process, signal.SIGTERM)
    assert ended(process)
