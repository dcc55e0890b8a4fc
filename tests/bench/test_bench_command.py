"""Whole commands, as users start them; with BASELINE=another checkout that build's too, in turn, and the ratio."""

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hfb.datasets.synthetic.clip_making import make_clip
from tests.bench import jobs
from tests.bench.conftest import Scale
from tests.bench.figures import Figures
from tests.bench.rounds import interleaved

BUILDS = {"this build": Path(sys.executable).parent / "hfb"}
if baseline := os.environ.get("BASELINE"):
    BUILDS["baseline"] = Path(baseline).resolve() / ".venv/bin/hfb"


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder of a short name: a socket's has at most 108 characters."""
    with tempfile.TemporaryDirectory(prefix="hfb-b", ignore_cleanup_errors=True) as made:
        yield Path(made)


def run(program: Path, folder: Path, *words: object, **variables: str) -> None:
    there = jobs.environment(folder) | {"XDG_RUNTIME_DIR": str(folder), "HFB_RESIDENT": "200", **variables}
    there.pop("PYTHONPATH")  # each build has its own sources
    done = subprocess.run([program, *map(str, words)], env=there, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def set_both(figures: Figures, key: str, found: dict[str, float], note: str) -> None:
    """Set the figure of this build; say the baseline's and the ratio."""
    ours = found["this build"]
    figures.set(key, ours, note)
    if theirs := found.get("baseline"):
        figures.say(f"{key} of the baseline = {theirs:.4g}, ratio {ours / theirs:.3f}")


def test_warm_command(scale: Scale, figures: Figures, folder: Path) -> None:
    """A folder per build, made by a first run; every run makes a new result."""
    if not scale.measures:
        pytest.skip("make bench; tests/cli has whole commands")
    numbers = iter(range(1000))

    def demo(name: str, program: Path) -> Callable[[], None]:
        place = folder / name.partition(" ")[0]
        place.mkdir()
        return lambda: run(program, place, "demo", "--quiet", "--out", place / f"out_{next(numbers)}")

    programs = {name: demo(name, program) for name, program in BUILDS.items()}
    for first in programs.values():
        first()
    time.sleep(5)  # the resident process warms up
    times = interleaved(programs, scale.fits)
    set_both(figures, "command_seconds", {name: one.median for name, one in times.items()}, "warm, median")


@pytest.mark.usefixtures("thorough")
def test_cold_command(scale: Scale, figures: Figures, folder: Path) -> None:
    if not scale.measures:
        pytest.skip("make bench; tests/cli has whole commands")
    found = {}
    for name, program in BUILDS.items():
        place = folder / name.partition(" ")[0]
        place.mkdir()
        began = time.perf_counter()
        run(program, place, "demo", "--quiet", "--out", place / "out", NUMBA_CACHE_DIR=str(place / "kernels"))
        found[name] = time.perf_counter() - began
    set_both(figures, "cold_command_seconds", found, "no kernels, no databases, one run")


@pytest.mark.usefixtures("thorough")
def test_memory_of_a_clips_worker(scale: Scale, figures: Figures, folder: Path) -> None:
    if not scale.measures or sys.platform != "linux":
        pytest.skip("make bench, on Linux")
    clip = make_clip(folder / "clip", 4, 480, 640, video=True)
    found = {}
    for name, program in BUILDS.items():
        place = folder / name.partition(" ")[0]
        place.mkdir()
        words = ["video", clip.source, "--background", clip.background, "--clip", clip.clip, "--out", place / "out"]
        there = jobs.environment(place)
        there.pop("PYTHONPATH")
        command = [program, *map(str, words), "--workers", "2", "--quiet"]
        with subprocess.Popen(command, env=there, stdout=subprocess.DEVNULL) as video:
            peak = 0.0
            while video.poll() is None:
                processes = [process for one in _children(video.pid) for process in (one, *_children(one))]
                peak = max([peak, *map(_peak_mb, processes)])
                time.sleep(0.2)
        assert video.returncode == 0
        found[name] = peak
    set_both(figures, "clip_worker_mb", found, "4 frames of 480 x 640, two workers, pages shared with others included")


def _children(process: int) -> list[int]:
    try:
        return [int(one) for one in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    except OSError:
        return []


def _peak_mb(process: int) -> float:
    """Return the peak of a worker, of multiprocessing's server or started by itself; 0 for other processes."""
    try:
        if not re.search(rb"multiprocessing\.(forkserver|spawn)", Path(f"/proc/{process}/cmdline").read_bytes()):
            return 0.0
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")), 0.0)
