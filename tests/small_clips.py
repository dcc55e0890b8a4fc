"""Clips so small that a whole one takes seconds, and what is looked at in their results."""

import argparse
import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from hfb.config import RunConfig
from hfb.datasets.synthetic.clip_making import MadeClip, make_clip
from hfb.flows.cli.options import add_config_flags, run_config
from hfb.tasks.workers.engine import Engine
from tests.orchestration import made_for_run, mlflow_rows, orchestrated

FRAMES = 12
SMALL_OPTIONS = (
    "--init.method",
    "matte",
    "--matting.method",
    "known-background",
    "--fit.subframes",
    "3",
    "--fit.texture-px",
    "16",
    "--fit.stages",
    '[{"size_px": 32, "iterations": 3}]',
    "--fit.settle",
    "0",
    "--fit.weights.joints",
    "0",
    "--fit.matte-scales",
    "1",
    "--fit.image-scales",
    "1",
    "--video.key-every",
    str(FRAMES),
    "--export.report",
    "false",
    "--export.films",
    "none",
    "--video.window",
    "2",
    "--video.person-windows",
    "1",
    "--video.stages",
    '[{"size_px": 32, "iterations": 3}]',
    "--video.longest-fill",
    "1",
)
"""One full search of a body at either end, three iterations of every window."""

LONGER = ("--video.stages", '[{"size_px": 32, "iterations": 30}]')
"""Windows that take long enough to be interrupted."""


def small_config(*more: str) -> RunConfig:
    """The configuration of the small options and some others."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    add_config_flags(parser)
    return run_config(parser.parse_args([*SMALL_OPTIONS, *more]))


@functools.cache
def small_clip(frames: int = FRAMES, leaves: tuple[int, int] | None = None, video: bool = False) -> MadeClip:
    """A clip of 96 x 128 pixels with its truth, made once; its folder is what `hfb video` takes."""
    name = f"clip-{frames}-{leaves}-{video}".replace(" ", "")

    def make(folder: Path) -> None:
        made = make_clip(folder, frames, 96, 128, seed=3, leaves=leaves, video=video)
        paths = {name: str(path) for name, path in vars(made).items()}
        folder.with_name(f"{name}.json").write_text(json.dumps(paths))

    folder = made_for_run(name, make)
    paths = json.loads(folder.with_name(f"{name}.json").read_text())
    return MadeClip(**{name: Path(path) for name, path in paths.items()})


def run_clip(
    source: Path,
    out: Path,
    *more: str,
    workers: Engine | int = 2,
    truth: Path | None = None,
    background: str | None = None,
) -> dict[str, Any]:
    """`hfb video` of the small options in this process."""
    from hfb.flows.video import run_video
    from hfb.tasks.inputs.video_inputs import take_video_inputs

    config = small_config(*more)
    return run_video(take_video_inputs(source, config, None, background, truth=truth), out, config, workers)


@functools.cache
def finished() -> tuple[Path, Path, dict[str, Any]]:
    """The small clip, done once: its folder, the MLflow database and result.json."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch, orchestrated(folder, patch):
            made = small_clip()
            result = run_clip(made.truth.parent, folder / "out", truth=made.truth)
            (folder / "told.json").write_text(json.dumps(result))

    folder = made_for_run("finished", make)
    return folder / "out", folder / "mlflow.db", json.loads((folder / "told.json").read_text())


def begun(out: Path) -> Path:
    """A folder in which everything of the small clip was done already, with its files' own times."""
    shutil.copytree(finished()[0], out)
    return out


def stamps(out: Path, pattern: str) -> dict[str, int]:
    """When intermediate files were written."""
    found = (path for path in (out / "intermediate").glob(pattern) if not path.name.startswith("."))
    return {path.name: path.stat().st_mtime_ns for path in found}


def started(out: Path, *more: str, **environment: str) -> subprocess.Popen[str]:
    """`hfb video` of the small clip in a process of its own; what it says goes to ``out`` with .shown."""
    made = small_clip()
    words = ["video", str(made.truth.parent), "--truth", str(made.truth), "--out", str(out), "--workers", "2", "--json"]
    with shown(out).open("a") as messages:
        return subprocess.Popen(
            [sys.executable, "-m", "hfb.flows.cli.cli", *words, *SMALL_OPTIONS, *more],
            stdout=subprocess.PIPE,
            stderr=messages,
            text=True,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1]), **environment},
            # tests that run in the background of a shell would hand down that Ctrl-C is ignored
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )


def shown(out: Path) -> Path:
    """The messages of `started`."""
    return out.with_suffix(".shown")


def until(condition: Callable[[], bool], process: subprocess.Popen[str], out: Path, seconds: float = 240) -> None:
    """Wait for something that a process does; its messages are the error where it ends before."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, shown(out).read_text()
        assert time.monotonic() < deadline, shown(out).read_text()
        time.sleep(0.01)


def new_windows(out: Path, before: dict[str, int]) -> int:
    """How many windows were fitted since."""
    return sum(stamp != before.get(name) for name, stamp in stamps(out, "window_*.npz").items())


def children(process: int) -> list[int]:
    """The processes that a process started, and theirs."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == process:
                found += [int(entry.name), *children(int(entry.name))]
    return found


def computing(process: int) -> list[int]:
    """The worker processes of a command."""
    return [worker for one in children(process) if b"forkserver" in command_line(one) for worker in children(one)]


def command_line(process: int) -> bytes:
    """Of a process; nothing where it has ended meanwhile."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def assert_every_frame_once(store: Path, frames: Sequence[int] = range(FRAMES)) -> None:
    """One finished run, and one point per frame and metric."""
    assert mlflow_rows(store, "select status from runs") == [("FINISHED",)]
    for metric in ("frame/seen", "fit/loss", "eval/matte_iou", "eval/psnr_db"):
        steps = [
            step for (step,) in mlflow_rows(store, f"select step from metrics where key = '{metric}' order by step")
        ]
        assert steps == list(frames), metric
