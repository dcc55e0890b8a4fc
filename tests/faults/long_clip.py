"""By hand: a long clip, killed at random moments, against an undisturbed run of the same; too long for `make test`.

    python -m tests.faults.long_clip DIR --frames 300 --kills 4 [--height 480 --width 640] [-- options of hfb video]

Makes the clip in DIR (once), runs it undisturbed (once), then with kills of the flow and of a worker in turn, and
prints one JSON object: are the bytes the same, which files were made twice, what MLflow and Prefect say, seconds per
frame, how busy the workers were, and the highest memory of the command and of a worker. With --kills 0 it only
measures: compare --frames 300 and 1200. PREFECT_API_URL chooses a started server; everything else stays in DIR.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from tests.small_clips import computing

_COMPARED = ("motion.npz", "strip.png", "texture.png", "edges.json")
_MADE_ONCE = ("frame_*", "matte_*", "key_body_*", "first_body_*", "window_*", "person_window_*")


def main() -> None:
    """See the module."""
    given = _arguments()
    given.folder.mkdir(parents=True, exist_ok=True)
    place = given.folder.resolve()
    os.environ |= {
        "OMP_NUM_THREADS": "1",
        "MLFLOW_TRACKING_URI": f"sqlite:///{place}/mlflow.db",
        "XDG_STATE_HOME": str(place / "state"),
        "PREFECT_HOME": str(place / "prefect"),
    }
    clip = given.folder / f"clip-{given.frames}"
    if not (clip / "truth.npz").exists():
        from hfb.datasets.synthetic.clip_making import make_clip

        make_clip(clip, given.frames, given.height, given.width, seed=1)
    command = [
        sys.executable,
        "-m",
        "hfb.flows.cli.cli",
        "video",
        str(clip),
        "--truth",
        str(clip / "truth.npz"),
        "--json",
        "--workers",
        str(given.workers),
        *given.options,
    ]
    quiet = given.folder / f"undisturbed-{given.frames}"
    told: dict[str, Any] = {"frames": given.frames}
    if not (quiet / "result.json").exists():
        told["undisturbed"] = _watched(command, quiet)
    if given.kills:
        # a store of its own: the same problem's finished record would be found again, and nothing be written
        os.environ["MLFLOW_TRACKING_URI"] = f"sqlite:///{place}/mlflow-killed-{given.seed}.db"
        told["killed"] = _killed(command, given.folder / f"killed-{given.frames}-{given.seed}", given, quiet)
    print(json.dumps(told, indent=2))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, default in (("frames", 300), ("kills", 4), ("height", 480), ("width", 640), ("workers", 2), ("seed", 0)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--within", type=float, default=120, help="seconds until a kill, at most")
    words = sys.argv[1:]
    at = words.index("--") if "--" in words else len(words)
    return parser.parse_args(words[:at], argparse.Namespace(options=words[at + 1 :]))


def _start(command: list[str], out: Path) -> subprocess.Popen[str]:
    with out.with_suffix(".shown").open("a") as shown:
        return subprocess.Popen([*command, "--out", str(out)], stdout=subprocess.PIPE, stderr=shown, text=True)


def _watched(command: list[str], out: Path) -> dict[str, Any]:
    """Run to the end; the result's figures and the highest memory."""
    out.parent.mkdir(parents=True, exist_ok=True)
    process = _start(command, out)
    peak = {"command_mb": 0.0, "worker_mb": 0.0}
    watcher = threading.Thread(target=_watch, args=(process, peak))
    watcher.start()
    text, _ = process.communicate()
    watcher.join()
    if process.returncode != 0:
        raise SystemExit(out.with_suffix(".shown").read_text())
    result = json.loads(text.splitlines()[-1])
    names = ("seconds", "total_seconds", "workers_busy", "resumed_frames", "matte_iou", "mpjpe_mm", "worst_jump_mm")
    figures = {name: result[name] for name in (*names, "worst_velocity_share")}
    return figures | {"seconds_per_frame": result["seconds"] / result["frames"], **peak}


def _watch(process: subprocess.Popen[str], peak: dict[str, float]) -> None:
    while process.poll() is None:
        peak["command_mb"] = max(peak["command_mb"], _highest_mb(process.pid))
        for worker in computing(process.pid):
            peak["worker_mb"] = max(peak["worker_mb"], _highest_mb(worker))
        time.sleep(1)


def _highest_mb(process: int) -> float:
    for line in _read(process, "status").splitlines():
        if line.startswith(b"VmHWM:"):
            return int(line.split()[1]) / 1024
    return 0.0


def _read(process: int, name: str) -> bytes:
    try:
        return Path(f"/proc/{process}/{name}").read_bytes()
    except OSError:
        return b""


def _killed(command: list[str], out: Path, given: argparse.Namespace, quiet: Path) -> dict[str, Any]:
    """Kill the flow and a worker in turn at random moments, then let it end."""
    rng = random.Random(given.seed)
    seen: dict[str, int] = {}
    twice: list[str] = []
    process = _start(command, out)
    for number in range(given.kills):
        time.sleep(rng.uniform(20, given.within))
        if process.poll() is not None:
            break
        workers = computing(process.pid)
        if number % 2 and workers:
            os.kill(rng.choice(workers), signal.SIGKILL)
            continue
        process.kill()
        process.wait()
        time.sleep(3)
        _count(out, seen, twice)
        process = _start(command, out)
    text, _ = process.communicate()
    if process.returncode != 0:
        raise SystemExit(out.with_suffix(".shown").read_text())
    _count(out, seen, twice)
    result = json.loads(text.splitlines()[-1])
    same = {name: (out / name).read_bytes() == (quiet / name).read_bytes() for name in _COMPARED}
    return {
        "same_bytes": same,
        "made_twice": twice,
        "resumed_frames": result["resumed_frames"],
        "mlflow": _mlflow(given.folder / f"mlflow-killed-{given.seed}.db", result["mlflow_run_id"], given.frames),
        "flow_runs": _flow_runs(next((given.folder / "prefect" / "hfb").glob("prefect-*.db"))),
    }


def _count(out: Path, seen: dict[str, int], twice: list[str]) -> None:
    """Which files were written again since the last look."""
    for pattern in _MADE_ONCE:
        for path in (out / "intermediate").glob(pattern):
            stamp = path.stat().st_mtime_ns
            if seen.setdefault(path.name, stamp) != stamp:
                twice.append(path.name)
                seen[path.name] = stamp


def _mlflow(database: Path, run: str, frames: int) -> dict[str, Any]:
    with sqlite3.connect(database) as rows:
        states = dict(rows.execute("select status, count(*) from runs group by status").fetchall())
        query = "select key, count(*), count(distinct step) from metrics where run_uuid = ? group by key"
        counts = {key: (n, steps) for key, n, steps in rows.execute(query, (run,)) if key.startswith(("frame", "eval"))}
    return {"states": states, "one_point_per_frame": all(n == steps == frames for n, steps in counts.values())}


def _flow_runs(database: Path) -> dict[str, int]:
    if not database.exists():  # a started server has its own
        return {}
    with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as rows:
        return dict(rows.execute("select state_name, count(*) from flow_run group by state_name").fetchall())


if __name__ == "__main__":
    main()
