"""A whole clip by `hfb video`: every step from the file to the motion, on all cores."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hfb.datasets.synthetic.clip_making import make_clip
from tests.bench import jobs
from tests.bench.conftest import Scale
from tests.bench.figures import Figures


def test_video(scale: Scale, figures: Figures, tmp_path: Path) -> None:
    """Windows of 2 frames.

    The first run in a new folder also creates Prefect's and MLflow's databases: a clip of two frames does that before.
    QUICK=1 has time for one clip of two small frames only, where the costs per clip dominate.
    """
    if not scale.measures:
        pytest.skip("make bench; tests/flows has whole clips")
    height = 480 if scale.clip_frames > 2 else 240
    if scale.clip_frames > 2:
        _run(tmp_path, 2, height)
    result, seconds = _run(tmp_path, scale.clip_frames, height)
    per_frame = result["seconds"] / result["frames"]
    figures.say(
        f"hfb video, {result['frames']} frames of {height} x {height * 4 // 3} px, {os.cpu_count()} workers: "
        f"{result['seconds']:.1f} s, the command {seconds:.1f} s; workers busy {result['workers_busy'] or 0:.0%}, "
        "the rest is orchestration, waiting for the last of a kind, and what is not shared out"
    )
    figures.set("video_seconds_per_frame", per_frame, f"{result['frames']} frames")


def _run(folder: Path, frames: int, height: int) -> tuple[dict, float]:
    clip = make_clip(folder / f"clip_{frames}", frames, height, height * 4 // 3, video=True)
    options = ["--background", clip.background, "--clip", clip.clip, "--out", folder / f"out_{frames}", "--json"]
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "hfb.flows.cli.cli", "video", str(clip.source), *map(str, options)],
        env=jobs.environment(folder),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), time.perf_counter() - began
