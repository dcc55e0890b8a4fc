"""Worker processes: the same result wherever it is computed, and none lost when one dies."""

import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hfb.initialization import landmarks
from hfb.matting.network import NetworkMatting
from hfb.tasks.workers.engine import Stopped
from hfb.tasks.workers.workers import WorkerLost, busy_share, measure_utilisation, run_local, stop_computing, workers

pytestmark = pytest.mark.integration


def process_id(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def die_once(mark: Path) -> str:
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "survived"


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise ValueError("said by the computation")


def parent_of(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


def meet(folder: Path) -> int:
    """Ends when a second process has come."""
    (folder / f"{os.getpid()}.here").touch()
    deadline = time.monotonic() + 120
    while len(list(folder.glob("*.here"))) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return os.getpid()


def test_without_workers_the_process_computes_itself() -> None:
    assert run_local(process_id, 0) == os.getpid()
    with workers(1):
        assert run_local(process_id, 0) == os.getpid()


def test_two_workers_compute_elsewhere_and_mend(tmp_path: Path) -> None:
    with workers(2), ThreadPoolExecutor(4) as threads:
        seen = list(threads.map(lambda _: run_local(meet, tmp_path), range(2)))
        assert os.getpid() not in seen
        assert len(set(seen)) == 2
        with pytest.raises(ValueError, match="said by the computation"):
            run_local(fail)
        assert run_local(die_once, tmp_path / "mark") == "survived"
        with pytest.raises(WorkerLost):
            run_local(die)
        assert run_local(process_id, 0) != os.getpid()
    assert run_local(process_id, 0) == os.getpid()


def test_workers_are_spawned_where_nothing_forks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    with workers(2), ThreadPoolExecutor(2) as threads:
        seen = set(threads.map(lambda _: run_local(meet, tmp_path), range(2)))
        assert len(seen - {os.getpid()}) == 2
        assert {parent_of(one) for one in seen} == {os.getpid()}  # and no server between them
        assert run_local(die_once, tmp_path / "mark") == "survived"


def what_is_loaded() -> list[str]:
    return [name for name in ("hfb.fitting.fit", "prefect", "mlflow") if name in sys.modules]


@pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="nothing forks here")
def test_workers_begin_with_the_method_and_their_process_before_them() -> None:
    script = """
import multiprocessing.forkserver as fork_server, os
from pathlib import Path
from hfb.tasks.workers.workers import begin_early, run_local, workers
for words in ("1", "threads:2"):
    begin_early(words)
    assert fork_server._forkserver._forkserver_pid is None, words
begin_early("2")
early = fork_server._forkserver._forkserver_pid
assert early
from tests.tasks.test_workers import what_is_loaded
with workers(2):
    print(run_local(what_is_loaded))
assert fork_server._forkserver._forkserver_pid == early
assert len(list(Path(f"/proc/{early}/task").iterdir())) == 1, "a fork would lack the other threads"
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "['hfb.fitting.fit']\n"), done.stderr


def test_one_worker_apart_is_another_process_and_says_how_busy_it_was() -> None:
    assert busy_share() is None
    with workers(1, apart=True):
        assert run_local(process_id, 0) != os.getpid()
        assert busy_share() is None
        began = time.monotonic()
        with measure_utilisation():
            entered = time.monotonic()
            napped = run_local(nap, 0.2)
            answered = time.monotonic()
            time.sleep(0.2)
            left = time.monotonic()
        ended = time.monotonic()
        share = busy_share()
        assert share is not None
        # it was busy no less than it napped and no longer than the answer took, on however slow a machine
        assert napped / (ended - began) - 1e-4 <= share <= (answered - entered) / (left - entered) + 1e-4


def test_another_kind_of_work_begins_without_the_memory_of_the_last() -> None:
    """Small pieces below one that stays: the C library keeps them for the process's own use."""
    with workers(1, apart=True):
        run_local(leave_free_memory)
        assert run_local(resident_mb) < run_local(leave_free_memory) - 100


def test_a_worker_loads_a_pose_network_once_and_forgets_it_for_other_work() -> None:
    with workers(1, apart=True):
        assert [run_local(load_network) for _ in range(3)] == [1, 1, 1]
        assert run_local(held_networks) == 0
        assert run_local(load_network) == 2


def load_network() -> int:
    """Load a network that only counts; return how often this process did."""

    def interpreter(**_: object) -> SimpleNamespace:
        _held.append(b"")
        return SimpleNamespace(allocate_tensors=lambda: None)

    sys.modules["ai_edge_litert.interpreter"] = cast(ModuleType, SimpleNamespace(Interpreter=interpreter))
    landmarks._load(Path("network.tflite"))
    return len(_held)


def held_networks() -> int:
    return landmarks._load.cache_info().currsize


def test_a_worker_does_not_grow_with_the_sizes_of_crops(monkeypatch: pytest.MonkeyPatch) -> None:
    grown = {}
    for kept in (None, "1024"):
        if kept:
            monkeypatch.setenv("ONEDNN_PRIMITIVE_CACHE_CAPACITY", kept)
        with workers(1, apart=True):
            # The first sizes fill what the network's library keeps, and the allocator's pools.
            run_local(look_at_sizes, 200, 240)
            grown[kept] = run_local(look_at_sizes, 240, 320)
    assert grown[None] < grown["1024"] - 10


def look_at_sizes(least_px: int, most_px: int) -> float:
    """Return by how much this process grew [MB]."""
    matting, before = NetworkMatting(), resident_mb()
    for height in range(least_px, most_px):
        frame = np.full((height, 300 - height // 2, 3), 0.5, np.float32)
        matting.look(frame, frame)
    return resident_mb() - before


def leave_free_memory() -> float:
    pieces = [bytes(10_000) for _ in range(30_000)]
    _held.append(pieces[-1])
    del pieces
    return resident_mb()


def resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20


_held: list[bytes] = []


def nap(seconds: float) -> float:
    began = time.monotonic()
    time.sleep(seconds)
    return time.monotonic() - began


def test_what_is_stopped_does_not_wait() -> None:
    began = time.monotonic()
    with workers(1, apart=True), ThreadPoolExecutor(3) as threads:
        run_local(process_id, 0)
        running = [threads.submit(run_local, nap, 60.0) for _ in range(3)]
        time.sleep(0.3)
        stop_computing()
        for one in running:
            with pytest.raises(Stopped):
                one.result(timeout=20)
        with pytest.raises(Stopped):
            run_local(process_id, 0)
    assert time.monotonic() - began < 40


class _Deaf(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        if record.name == "hfb.somewhere":
            raise BrokenPipeError


def chatter() -> str:
    """More than a pipe holds."""
    for _ in range(200):
        logging.getLogger("hfb.somewhere").warning("x" * 1000)
    return "done"


def test_nobody_who_listens_holds_no_work_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [_Deaf()])
    with ThreadPoolExecutor(1) as threads, workers(1, apart=True):
        assert threads.submit(run_local, chatter).result(timeout=60) == "done"


ORPHANS = """
import os, sys, time
from hfb.tasks.workers.workers import run_local, workers
from tests.tasks.test_workers import process_id
if __name__ == "__main__":
    with workers(2):
        print(run_local(process_id, 0), flush=True)
        time.sleep(60)
"""


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"  # spawned processes import the main module again: it has to be a file
    script.write_text(ORPHANS)
    root = Path(__file__).parents[2]
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(root)}
    )
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and _alive(worker):
        time.sleep(0.1)
    assert not _alive(worker)


def _alive(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    return status.exists() and status.read_text().split()[2] != "Z"
