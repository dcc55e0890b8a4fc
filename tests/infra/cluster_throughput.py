"""By hand: what a second Dask worker is worth on one machine, with nothing else running.

    python -m tests.infra.cluster_throughput DIR [--frames 64] [--rounds 3] [--plain] [-- options of hfb video]

The same clip of 240 x 320 pixels by one worker and by two, in turn (one two, two one, ...), so that what slows the
machine down for a while slows down both; Dask by infra/settings/dask.yaml or, --plain, as it comes. Prints one JSON
object: of every run its seconds per step and how many seconds of processor time something else took meanwhile; then,
per step and for the whole command, the ratio of the medians. All motions must have the same bytes.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
from distributed import Client

from hfb.datasets.synthetic.clip_making import make_clip
from hfb.tasks.core.handles import sha256_of
from tests.faults.servers import free_port
from tests.infra.orchestration_cost import processor_s

_ROOT = Path(__file__).parents[2]
_SETTINGS = _ROOT / "infra" / "settings" / "dask.yaml"
_STEP = re.compile(r"^(mattes|first bodies|first bodies between|windows|scores): ([0-9.]+) s", re.M)


@contextmanager
def started(*words: str, settings: Path | None) -> Iterator[None]:
    """A command of Dask's for as long as this lasts."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(_ROOT)}
    if settings:
        environment["DASK_CONFIG"] = str(settings)
    with subprocess.Popen(
        [sys.executable, "-m", "dask", *words], env=environment, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield
        finally:
            process.terminate()


@contextmanager
def cluster_of(workers: int, settings: Path | None) -> Iterator[str]:
    """The address of a scheduler with so many worker processes of one thread."""
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    with ExitStack() as stack:
        scheduler = ("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        stack.enter_context(started(*scheduler, settings=settings))
        for _ in range(workers):
            stack.enter_context(started("worker", address, "--nthreads", "1", "--no-dashboard", settings=settings))
        with Client(address, timeout=60) as client:
            client.wait_for_workers(workers, timeout=60)
        yield address


def foreign_s(before: tuple[float, float]) -> float:
    """Processor time since `before` of what neither this process nor a child of its spent [s]."""
    everything, ours = spent()
    return everything - before[0] - (ours - before[1])


def spent() -> tuple[float, float]:
    """Processor time of the machine, and of this process with all its children, so far [s]."""
    times = psutil.cpu_times()
    return times.user + times.nice + times.system, processor_s(psutil.Process())


def run(clip: Path, place: Path, workers: int, settings: Path | None, options: list[str]) -> dict[str, Any]:
    """One command on a cluster of its own."""
    out = place / "out"
    environment = {
        **os.environ,
        "MLFLOW_TRACKING_URI": f"sqlite:///{place / 'mlflow.db'}",
        "PREFECT_HOME": str(place / "prefect"),
        "XDG_STATE_HOME": str(place / "state"),
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(_ROOT),
    }
    with cluster_of(workers, settings) as address:
        before, began = spent(), time.monotonic()
        ended = subprocess.run(
            [
                sys.executable,
                "-m",
                "hfb.flows.cli.cli",
                "video",
                clip,
                "--out",
                out,
                "--workers",
                f"dask:{address}",
                *options,
            ],
            env=environment,
            capture_output=True,
            text=True,
        )
        whole_s, foreign = time.monotonic() - began, foreign_s(before)
    if ended.returncode:
        raise SystemExit(ended.stdout + ended.stderr)
    steps = {name: float(seconds) for name, seconds in _STEP.findall(ended.stdout + ended.stderr)}
    return {
        "workers": workers,
        **steps,
        "whole": round(whole_s, 1),
        "foreign": round(foreign, 1),
        "motion": sha256_of(out / "motion.npz"),
    }


def main() -> None:
    """See the module."""
    words = sys.argv[1:]
    at = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--plain", action="store_true")
    given = parser.parse_args(words[:at])
    clip = given.folder.resolve() / f"clip-{given.frames}"
    if not (clip / "truth.npz").exists():
        make_clip(clip, given.frames, 240, 320, seed=1)
    runs = []
    for number in range(given.rounds):
        for workers in (1, 2) if number % 2 == 0 else (2, 1):
            place = given.folder.resolve() / f"run-{int(time.time())}"
            place.mkdir()
            runs.append(run(clip, place, workers, None if given.plain else _SETTINGS, words[at + 1 :]))
            print(json.dumps(runs[-1]), file=sys.stderr, flush=True)
    if len({one["motion"] for one in runs}) > 1:
        raise SystemExit("the motions differ")
    ratios = {
        step: round(_median(runs, 1, step) / _median(runs, 2, step), 3)
        for step in runs[0]
        if step not in ("workers", "foreign", "motion")
    }
    print(json.dumps({"runs": runs, "throughput_of_two": ratios}, indent=1))


def _median(runs: list[dict[str, Any]], workers: int, step: str) -> float:
    return statistics.median(one[step] for one in runs if one["workers"] == workers)


if __name__ == "__main__":
    main()
