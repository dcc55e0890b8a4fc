"""Killed, interrupted, ended: the next run goes on, and nothing keeps running."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.orchestration import TINY_OPTIONS, Problem, mlflow_rows

FIT = """
import sys
from pathlib import Path
from hfb.flows.fit_image import fit_image
from hfb.config import ExportConfig, FitConfig, RunConfig, Stage
from hfb.tasks.telemetry import displays, progress
frame, plate, first, out = map(Path, sys.argv[1:])
config = RunConfig(
    fit=FitConfig(subframes=2, texture_px=16, stages=(Stage(size_px=32, iterations=40),)),
    export=ExportConfig(films=(), report=False),
)
with progress.showing(displays.lines_on(sys.stderr, first_s=0.05)):
    fit_image([frame], plate, out, config, first_bodies=[first])
"""
SERVER = """
from hfb.flows.runtime.server import PrefectServer
import time
print(PrefectServer()._process.pid, flush=True)
time.sleep(600)
"""


def fitting(problem: Problem, out: Path) -> subprocess.Popen[str]:
    words = (problem.frame, problem.background, problem.first_body, out)
    return subprocess.Popen([sys.executable, "-c", FIT, *map(str, words)], stderr=subprocess.PIPE, text=True)


def test_kill_in_the_middle_of_the_fit(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    victim = fitting(problem, out)
    for line in victim.stderr:
        if line.startswith("fit "):
            victim.kill()
            break
    assert victim.wait() == -signal.SIGKILL
    assert not (out / "result.json").exists()
    (out / "intermediate" / ".motion.npz.1-a.part").write_bytes(b"what a killed writer leaves")

    rest = fitting(problem, out)
    _, shown = rest.communicate(timeout=120)
    assert rest.returncode == 0, shown
    assert "matte: reused" in shown
    assert "fit: reused" not in shown
    assert (out / "result.json").exists()
    assert not list(out.rglob("*.part"))
    assert mlflow_rows(store, "select status from runs") == [("FINISHED",)]


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "TERM"])
def test_interrupted_command(sent: int, code: int, problem: Problem, store: Path, tmp_path: Path) -> None:
    words = ["fit", str(problem.frame), "--background", str(problem.background), "--out", str(tmp_path / "out")]
    victim = subprocess.Popen(
        [sys.executable, "-m", "hfb.flows.cli.cli", *words, *TINY_OPTIONS],
        stderr=subprocess.PIPE,
        text=True,
        # tests that run in the background of a shell, as under nohup, would hand down that Ctrl-C is ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    shown = ""
    for line in victim.stderr:
        shown += line
        if line.startswith("matte: "):
            victim.send_signal(sent)
    assert victim.wait() == code, shown
    assert "Traceback" not in shown
    assert not (tmp_path / "out" / "result.json").exists()


STUCK = """
import argparse, sys, threading
from hfb.flows.cli import cli

def stuck(given):
    lock = threading.Lock()
    lock.acquire()
    while True:
        try:
            print("waits", file=sys.stderr, flush=True)
            lock.acquire()
        except BaseException:
            pass

cli._ENDS_WITHIN_S = 0.5
cli._parse = lambda words: argparse.Namespace(run=stuck)
sys.exit(cli.main([]))
"""


IGNORED = """
import argparse, contextlib, os, sys, time
from prefect.utilities.engine import capture_sigterm
from hfb.flows.cli import cli

class Module:
    def __del__(self):
        os.kill(os.getpid(), number)
        time.sleep(5)

def loads_kernels(given):
    with capture_sigterm() if where == "flow" else contextlib.nullcontext():
        Module()
        for _ in range(300):
            time.sleep(0.1)

number, where = int(sys.argv[1]), sys.argv[2]
cli._parse = lambda words: argparse.Namespace(run=loads_kernels)
sys.exit(cli.main([]))
"""


@pytest.mark.parametrize(
    ("sent", "where", "code"),
    [(signal.SIGINT, "command", 130), (signal.SIGTERM, "command", 143), (signal.SIGTERM, "flow", 143)],
)
def test_a_signal_that_python_ignores_is_sent_again(sent: int, where: str, code: int) -> None:
    """What a signal raises within `__del__` is ignored; kernels that are loaded free modules of llvmlite so."""
    words = [sys.executable, "-c", IGNORED, str(int(sent)), where]
    ended = subprocess.run(
        words,
        stderr=subprocess.PIPE,
        text=True,
        timeout=25,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert ended.returncode == code, ended.stderr
    assert "ignored" not in ended.stderr


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "TERM"])
def test_a_command_that_cannot_end_is_ended(sent: int, code: int) -> None:
    """A library's lock, taken when the signal came, is waited for by whoever tidies up."""
    victim = subprocess.Popen(
        [sys.executable, "-c", STUCK],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert victim.stderr.readline() == "waits\n"
    victim.send_signal(sent)
    _, shown = victim.communicate(timeout=60)
    assert victim.returncode == code
    assert "did not in a minute" in shown


def test_the_temporary_server_ends_with_a_killed_process(tmp_path: Path) -> None:
    environment = {**os.environ, "PREFECT_HOME": str(tmp_path / "prefect"), "XDG_STATE_HOME": str(tmp_path)}
    environment.pop("PREFECT_API_URL", None)
    parent = subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True, env=environment)
    server = int(parent.stdout.readline())
    os.kill(server, 0)
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            os.kill(server, 0)
        except ProcessLookupError:
            return
        if Path(f"/proc/{server}/stat").exists() and Path(f"/proc/{server}/stat").read_text().split()[2] == "Z":
            return
        time.sleep(0.1)
    os.kill(server, signal.SIGKILL)
    pytest.fail("the temporary server outlived its process")


JUDGE = """
import sys
from pathlib import Path
from hfb.flows.benchmark import BenchmarkPlan, run_benchmark
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.datasets.set_spec import SetSpec
from hfb.tasks.telemetry import displays, progress
if __name__ == "__main__":
    out, toml, workers = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    plan = BenchmarkPlan(
        spec=SetSpec(size_px=64, seed=5), count=4, methods=(method_spec(f"tiny={toml}"), method_spec("static")),
        start="simulated",
    )
    with progress.showing(displays.lines_on(sys.stderr, first_s=0.05)):
        run_benchmark(plan, out, workers)
"""
JUDGED_TOML = """
[fit]
subframes = 2
texture_px = 16
stages = [{ size_px = 32, iterations = 60 }]
"""


def test_a_killed_benchmark_goes_on_where_it_was(store: Path, tmp_path: Path) -> None:
    toml, script = tmp_path / "tiny.toml", tmp_path / "judge.py"
    toml.write_text(JUDGED_TOML)
    script.write_text(JUDGE)  # spawned workers import the main module: it has to be a file
    out = tmp_path / "out"
    command = [sys.executable, str(script), str(out), str(toml), "2"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    with (tmp_path / "shown").open("w") as shown:
        victim = subprocess.Popen(command, stderr=shown, env=environment)
        while victim.poll() is None and len(list(out.rglob("row.json"))) < 4:
            time.sleep(0.01)
        victim.kill()
    assert victim.wait() == -signal.SIGKILL, (tmp_path / "shown").read_text()
    done = {path: path.stat().st_mtime_ns for path in out.rglob("row.json")}
    assert not (out / "summary.json").exists()

    rest = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=300, env=environment)
    assert rest.returncode == 0, rest.stderr
    assert "cases: reused" in rest.stderr
    assert "methods: reused" not in rest.stderr
    assert len(list(out.rglob("row.json"))) == 8, rest.stderr
    kept = [path for path, stamp in done.items() if path.stat().st_mtime_ns == stamp]
    assert len(kept) >= len(done) - 2  # what two workers had in hand at the kill may be made again
    assert sorted(mlflow_rows(store, "select status from runs")) == [("FINISHED",)] * 3
