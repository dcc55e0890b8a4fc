"""By hand: what a frame of a long clip costs Prefect, MLflow and the disk; both on a PostgreSQL of the test's own.

    python -m tests.infra.orchestration_cost DIR --frames 10000 [--workers 1] [--real] [-- options of hfb video]

It is the real command with its real tasks on a clip of 48 x 64 pixels, one iteration per window; first bodies between
key frames are their neighbours', whose search would take most of the time. A made clip of some hundred frames is played
back and forth. --real: 480 x 640 pixels, as `hfb video` is without any option. Prints one JSON object:

- `overhead_ms`: (wall time of the steps over many frames - time in which the workers computed) / frames,
- processor time per frame: of the command's own process, of it with all its workers, of Prefect's server, the database,
- rows and bytes of the databases and bytes of files per frame, and how long the server went on after the command,
- how many points a second MLflow's database takes from one client.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import asyncpg
import psutil

import hfb.flows  # noqa: F401 (its settings come before Prefect is imported)
from hfb.motion.static_pose import load_first_body
from hfb.tasks.core.video_handles import BodyFound
from hfb.tasks.task import task
from hfb.tasks.video.video_frames import BetweenCall, write_body
from tests.faults.servers import Postgres, PrefectProcess, postgres, prefect_server
from tests.small_clips import SMALL_OPTIONS

_MADE = 250
_POINTS = 20_000
_OWN = "own processor time [s]: "
_CHEAP = (
    *SMALL_OPTIONS,
    "--video.stages",
    '[{"size_px": 16, "iterations": 1}]',
    "--video.key-every",
    "250",
    "--video.settle",
    "0",
    "--fit.subframes",
    "2",
    "--export.formats",
    "csv",
)
_STEP = re.compile(r"^(frames|mattes|first bodies|first bodies between|who it is|windows|scores): ([0-9.]+) s", re.M)
_IDLE_SHARE, _LOOK_S = 0.1, 5.0


@task("first bodies between", where="worker")
def near_body(call: BetweenCall) -> BodyFound:
    """Instead of `hfb.tasks.video.video_frames.find_body_between`: the body of the key frame before."""
    found = load_first_body(call.known[0][1].path)
    return BodyFound(first=write_body(call.folder / f"first_body_{call.number:06d}.npz", found))


def command(arguments: list[str]) -> int:
    """The `hfb` command with that."""
    from hfb.flows.cli import cli

    if arguments[0] == "cheap":
        from hfb.tasks.chains import clip_steps

        clip_steps.find_body_between = near_body  # type: ignore[assignment]
    code = cli.main(arguments[1:])
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(f"{_OWN}{used.ru_utime + used.ru_stime}", file=sys.stderr)
    return code


def long_clip(place: Path, frames: int, real: bool) -> Path:
    """The folder of a clip of any length."""
    from hfb.datasets.synthetic.clip_making import make_clip

    size = (480, 640) if real else (48, 64)
    made, clip = place / f"made-{size[0]}", place / f"clip-{size[0]}-{frames}"
    if not (made / "truth.npz").exists():
        make_clip(made, min(frames, _MADE), *size, seed=1)
    if not clip.exists():
        (clip / "frames").mkdir(parents=True)
        pictures = sorted((made / "frames").iterdir())
        there_and_back = [*pictures, *pictures[-2:0:-1]]
        for number in range(frames):
            os.link(there_and_back[number % len(there_and_back)], clip / "frames" / f"{number:06d}.png")
        for name in ("background.png", "clip.toml"):
            shutil.copy(made / name, clip / name)
    return clip


def processor_s(process: psutil.Process) -> float:
    """Processor time of a process and of all that it started, those that have ended too [s]."""
    spent = 0.0
    for one in [process, *process.children(recursive=True)]:
        try:
            times = one.cpu_times()
            spent += times.user + times.system + times.children_user + times.children_system
        except psutil.NoSuchProcess:
            continue
    return spent


class Spent:
    """Processor time of the server and of the database's processes since this was made [s]."""

    def __init__(self, cluster: Postgres, server: PrefectProcess) -> None:
        self._processes = {"server": psutil.Process(server.pid), "database": psutil.Process(cluster.pid)}
        self._before = {name: processor_s(one) for name, one in self._processes.items()}

    def seconds(self) -> dict[str, float]:
        """So far."""
        return {name: processor_s(one) - self._before[name] for name, one in self._processes.items()}


def wait_until_idle(spent: Spent) -> float:
    """Seconds until server and database have nothing left to do: states of tasks are written a little later."""
    began, before = time.monotonic(), sum(spent.seconds().values())
    while True:
        time.sleep(_LOOK_S)
        now = sum(spent.seconds().values())
        if now - before < _IDLE_SHARE * _LOOK_S:
            return time.monotonic() - began - _LOOK_S
        before = now


def ask(cluster: Postgres, *queries: str, database: str = "postgres") -> list[Any]:
    """Answers of one value each."""

    async def all_of_them() -> list[Any]:
        there = await asyncpg.connect(host="127.0.0.1", port=cluster.port, user="hfb", database=database)
        try:
            return [await there.fetchval(one) for one in queries]
        finally:
            await there.close()

    return asyncio.run(all_of_them())


def held(cluster: Postgres, database: str = "postgres") -> tuple[int, dict[str, int]]:
    """Bytes of a database, and rows per table."""
    listed = "select coalesce(string_agg(relname, ' '), '') from pg_stat_user_tables"
    size, names = ask(cluster, f"select pg_database_size('{database}')", listed, database=database)
    counts = ask(cluster, *(f'select count(*) from "{name}"' for name in names.split()), database=database)
    return size, dict(zip(names.split(), counts, strict=True))


def points_per_second(uri: str) -> float:
    """How fast one client writes points of metrics."""
    from mlflow import MlflowClient
    from mlflow.entities import Metric

    client = MlflowClient(uri)
    run = client.create_run(client.create_experiment("points")).info.run_id
    began = time.monotonic()
    for batch in range(_POINTS // 1000):
        points = [Metric(f"m{number % 4}", 0.5, batch, 250 * batch + number // 4) for number in range(1000)]
        client.log_batch(run, metrics=points)
    return _POINTS / (time.monotonic() - began)


def bytes_in(folder: Path) -> int:
    """Of all files in it."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def measure(given: argparse.Namespace, options: list[str]) -> dict[str, Any]:
    """Run the command; see the module."""
    place, frames = given.folder.resolve(), given.frames
    clip, run = long_clip(place, frames, given.real), place / f"run-{int(time.time())}"
    run.mkdir()
    with postgres(run / "database") as cluster, prefect_server(run, cluster.url) as server:
        ask(cluster, "create database mlflow")
        store = f"postgresql+psycopg2://hfb@127.0.0.1:{cluster.port}/mlflow"
        environment = {
            **os.environ,
            "PREFECT_API_URL": server.api,
            "MLFLOW_TRACKING_URI": store,
            "OMP_NUM_THREADS": "1",
            "XDG_STATE_HOME": str(run / "state"),
            "PREFECT_HOME": str(run / "home"),
        }
        command = [
            sys.executable,
            "-m",
            "tests.infra.orchestration_cost",
            "hfb",
            "real" if given.real else "cheap",
            "video",
            str(clip),
            "--out",
            "out",
            "--json",
            "--workers",
            given.workers,
            *(() if given.real else _CHEAP),
            *options,
        ]
        environment["PYTHONPATH"] = str(Path(__file__).parents[2])
        before, spent, used, began = held(cluster), Spent(cluster, server), os.times(), time.monotonic()
        with (run / "shown").open("w") as shown:
            ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=shown, env=environment, text=True, cwd=run)
        told = {"frames": frames, "workers": given.workers, "wall_s": round(time.monotonic() - began, 1)}
        used_s = sum(os.times()[2:4]) - sum(used[2:4])
        said = (run / "shown").read_text()
        if ended.returncode:
            raise SystemExit(said)
        told["late_s"] = round(wait_until_idle(spent), 1)
        servers, after, recorded = spent.seconds(), held(cluster), held(cluster, "mlflow")
        told["mlflow_points_per_second"] = round(points_per_second(store))
        told["mlflow_point_bytes"] = round((held(cluster, "mlflow")[0] - recorded[0]) / _POINTS)
    steps = {name: float(seconds) for name, seconds in _STEP.findall(said)}
    busy, many_s = json.loads(ended.stdout.splitlines()[-1])["workers_busy"], sum(steps.values())
    own_s = float(said.rpartition(_OWN)[2].split()[0])
    per_frame_ms = {
        "overhead": many_s * (1 - busy),
        "wall": many_s,
        "command_cpu": own_s,
        "command_and_workers_cpu": used_s,
        **{f"{name}_cpu": seconds for name, seconds in servers.items()},
    }
    files = {"results": bytes_in(run / "out") - bytes_in(run / "out" / "intermediate")}
    files["intermediate"] = bytes_in(run / "out" / "intermediate")
    grown = {name: count - before[1].get(name, 0) for name, count in after[1].items()}
    return {
        **told,
        "steps_s": steps,
        "workers_busy": busy,
        **{f"{name}_ms": round(1000 * seconds / frames, 2) for name, seconds in per_frame_ms.items()},
        "prefect_bytes": round((after[0] - before[0]) / frames),
        "prefect_rows": {name: round(n / frames, 3) for name, n in sorted(grown.items()) if n > frames / 100},
        "mlflow_rows": {name: n for name, n in sorted(recorded[1].items()) if n},
        **{f"{name}_bytes": round(size / frames) for name, size in files.items()},
    }


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--workers", default="1")
    parser.add_argument("--real", action="store_true")
    words = sys.argv[1:]
    if words[:1] == ["hfb"]:
        sys.exit(command(words[1:]))
    at = words.index("--") if "--" in words else len(words)
    given = parser.parse_args(words[:at])
    given.folder.mkdir(parents=True, exist_ok=True)
    print(json.dumps(measure(given, words[at + 1 :]), indent=1))


if __name__ == "__main__":
    main()
