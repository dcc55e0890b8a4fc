"""Commands in a real pseudo-terminal and through a pipe: bars swallow no line, results are alone on standard output."""

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from hfb.flows.cli.cli import main
from hfb.flows.runtime.session import results_alone_on_stdout
from hfb.tasks.telemetry import displays
from tests.orchestration import TINY_OPTIONS, Problem

_WIDTH = 60
_ROOT = Path(__file__).parents[2]

# Steps, log lines from this thread, another one and a worker process, and a long line, while a bar turns.
LOGGING = """
import logging, sys, threading, time
from hfb.flows.runtime.server import keep_log
from hfb.tasks.telemetry import displays, progress
from hfb.tasks.workers.workers import run_local, workers

def warn(words):
    logging.getLogger("hfb.test").warning(words)

if __name__ == "__main__":
    keep_log()
    with progress.showing(*displays.displays_for()), workers(1, apart=True), progress.step("fit"):
        for number in range(20):
            progress.advance(number, 20, "loss 0.5")
            warn(f"line {number} of this thread")
            time.sleep(0.02)
        thread = threading.Thread(target=warn, args=("a line of another thread",))
        thread.start()
        thread.join()
        run_local(warn, "a line of a worker")
        progress.say("a long line " + "0123456789" * 12 + " ends here")
        time.sleep(0.3)
"""


def in_terminal(command: list[str], folder: Path) -> tuple[int, str]:
    """Exit code, and everything that a terminal of 60 columns was sent."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, _WIDTH, 0, 0))
    settings = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": str(_ROOT), "XDG_STATE_HOME": str(folder)}
    process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=settings)
    os.close(slave)
    sent = b""
    try:
        while piece := os.read(master, 1 << 16):
            sent += piece
    except OSError:  # the other end was closed
        pass
    os.close(master)
    return process.wait(), sent.decode()


def left_on(screen: str) -> list[str]:
    """The lines that stay: what a bar wrote and then erased is gone (rich erases line by line, upwards)."""
    lines, row = [""], 0
    for part in re.split(r"(\x1b\[[0-9;?]*[A-Za-z]|\r|\n)", screen):
        if part == "\n":
            row += 1
            lines += [""] * (row + 1 - len(lines))
        elif part == "\x1b[2K":
            lines[row] = ""
        elif match := re.fullmatch(r"\x1b\[(\d+)A", part):
            row = max(0, row - int(match.group(1)))
        elif part and not part.startswith("\x1b") and part != "\r":
            lines[row] += part
    return [line.rstrip() for line in lines]


def test_bars_swallow_no_log_line(tmp_path: Path) -> None:
    (tmp_path / "logging_program.py").write_text(LOGGING)
    code, sent = in_terminal([sys.executable, "logging_program.py"], tmp_path)
    assert code == 0, sent
    assert "\x1b[?25l" in sent  # a live bar: the cursor is hidden
    assert "loss 0.5" in sent
    lines = left_on(sent)
    wanted = [f"warning: line {number} of this thread" for number in range(20)]
    wanted += ["warning: a line of another thread", "warning: a line of a worker"]
    for line in (*wanted, "a long line " + "0123456789" * 12 + " ends here"):
        assert line in lines, sent
    assert any(re.fullmatch(r"  fit +\d+\.\d s", line) for line in lines)
    assert not any("━" in line for line in lines)


def test_a_command_in_a_terminal(tmp_path: Path) -> None:
    words = ["synth", "clip", "--frames", "2", "--size", "64", "--out", "clip"]
    code, sent = in_terminal([sys.executable, "-m", "hfb.flows.cli.cli", *words], tmp_path)
    assert code == 0, sent
    lines = left_on(sent)
    assert any(re.fullmatch(r"  frames +\d+\.\d s", line) for line in lines)
    assert any(line.startswith("2 frames with their truth in clip") for line in lines)
    assert (tmp_path / "clip" / "truth.npz").is_file()


def test_a_terminal_that_can_nothing_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    with os.fdopen(slave, "w") as stream:
        monkeypatch.setenv("TERM", "xterm")
        assert isinstance(displays.displays_for(stream)[0], displays.Live)
        monkeypatch.setenv("TERM", "dumb")
        assert isinstance(displays.displays_for(stream)[0], displays.Plain)
    os.close(master)


def test_through_pipes(tmp_path: Path) -> None:
    """Lines on standard error, one JSON object on standard output."""
    settings = {**os.environ, "PYTHONPATH": str(_ROOT), "XDG_STATE_HOME": str(tmp_path)}
    words = [
        sys.executable,
        "-m",
        "hfb.flows.cli.cli",
        "synth",
        "clip",
        "--frames",
        "2",
        "--size",
        "75",
        "--mp4",
        "--json",
        "--out",
        "a",
    ]
    told = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env=settings)
    assert json.loads(told.stdout)["frames"] == 2
    assert told.stdout.count("\n") == 1
    assert "frames: " in told.stderr
    assert "\x1b" not in told.stderr


def test_a_reader_that_goes_away() -> None:
    """As in `hfb models | head -c 1`."""
    reading, writing = os.pipe()
    os.close(reading)
    words = [sys.executable, "-m", "hfb.flows.cli.cli", "models", "--json"]
    settings = {**os.environ, "PYTHONPATH": str(_ROOT)}
    done = subprocess.run(words, stdout=writing, stderr=subprocess.PIPE, text=True, env=settings)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_whole_chain_prints_one_line_of_json(
    problem: Problem, store: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["fit", str(problem.frame), "--background", str(problem.background), *TINY_OPTIONS]
    assert main([*words, "--out", str(tmp_path / "out"), "--json", "--quiet"]) == 0
    shown = capfd.readouterr()
    assert json.loads(shown.out)["out"] == str(tmp_path / "out")
    assert shown.out.count("\n") == 1
    assert shown.err == ""


def test_nothing_but_results_on_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    with results_alone_on_stdout():
        print("printed by a library")
        os.write(1, b"written by a library in C\n")
        subprocess.run([sys.executable, "-c", "print('printed by a process')"], check=True)
    print("the result")
    shown = capfd.readouterr()
    assert shown.out == "the result\n"
    for words in ("printed by a library", "written by a library in C", "printed by a process"):
        assert words in shown.err
