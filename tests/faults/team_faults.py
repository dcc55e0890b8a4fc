"""By hand: a batch on a started Prefect server, PostgreSQL and MLflow server that are taken away under it.

    python -m tests.faults.team_faults DIR [--only NAME] [--clips 2] [--frames 6]

Each fault begins with a fresh folder and ends with the same batch, whose results are compared byte by byte with an
undisturbed one's; then MLflow is asked for its runs and Prefect for flow runs that nobody ends. Prints one JSON object.
`postgres`: crashed and brought back twice. `server`: Prefect's server killed -9 and started again. `both`: the database
and the server. `mlflow`: the tracking server away for a while (--away seconds). `flow`: the batch itself killed -9.
`worker`: a process that computes killed -9, twice. `disk`: results on a tmpfs that is full half-way (needs the right to
mount). `clock`: the clock of the batch and its workers jumps two days ahead and four back (needs the Debian package
libfaketime); Prefect's server keeps the right time.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.faults.servers import Postgres, PrefectProcess, free_port, postgres, prefect_server
from tests.faults.test_video_faults import end, tracking_server
from tests.orchestration import migrated_store
from tests.small_clips import LONGER, SMALL_OPTIONS, computing, small_clip

COMPARED = ("motion.npz", "strip.png", "texture.png", "edges.json")
_TERMINAL = {"COMPLETED", "FAILED", "CRASHED", "CANCELLED"}


class Batch:
    """A folder of clips, the place of its results, and the command over them.

    Attributes:
        store: MLflow's database.
    """

    def __init__(self, folder: Path, clips: int, frames: int, api: str) -> None:
        self.folder, self.out, self.store = folder, folder / "out", folder / "mlflow.db"
        folder.mkdir(parents=True)
        shutil.copy(migrated_store(), self.store)
        made = small_clip(frames)
        for number in range(clips):
            place = folder / "clips" / f"clip{number}"
            shutil.copytree(made.truth.parent, place)
            # The same clip with the same clip.toml would be the same run in MLflow.
            (place / "clip.toml").write_text(made.clip.read_text().replace("fps = 30.0", f"fps = {30 + number}.0"))
            for path in place.rglob("*"):
                os.utime(path, (1_700_000_000, 1_700_000_000))
        self.environment = {
            **os.environ,
            "PREFECT_API_URL": api,
            "MLFLOW_TRACKING_URI": f"sqlite:///{self.store}",
            "XDG_STATE_HOME": str(folder / "state"),
            "PREFECT_HOME": str(folder / "home"),
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": str(Path(__file__).parents[2]),
            "PREFECT_LOGGING_TO_API_ENABLED": "false",
        }

    def start(self) -> subprocess.Popen[str]:
        """`hfb batch`; failures are tried again after a second."""
        words = ["batch", str(self.folder / "clips"), "--out", str(self.out), "--workers", "1", "--json"]
        pace = ["--wait", "1", "--attempts", "8"]
        with (self.folder / "shown").open("a") as shown:
            return subprocess.Popen(
                [sys.executable, "-m", "hfb.flows.cli.cli", *words, *pace, *SMALL_OPTIONS, *LONGER],
                stdout=subprocess.PIPE,
                stderr=shown,
                text=True,
                env=self.environment,
            )

    def finish(self, process: subprocess.Popen[str] | None = None) -> dict[str, Any]:
        """Wait for the command (or run it), again where it gave up; how it ended."""
        told: dict[str, Any] = {}
        for again in range(3):
            process = process or self.start()
            words, _ = process.communicate(timeout=900)
            lines = words.splitlines()
            told = json.loads(lines[-1]) if lines else {}
            if process.returncode == 0 and told.get("waiting") == 0:
                return told | {"starts": again + 1}
            process = None
        raise AssertionError(f"{told}: {(self.folder / 'shown').read_text()[-4000:]}")

    def until(self, pattern: str, process: subprocess.Popen[str], count: int = 1) -> None:
        """Wait for intermediate files of a name."""
        while len(list(self.out.glob(f"*/intermediate/{pattern}"))) < count:
            assert process.poll() is None, (self.folder / "shown").read_text()[-4000:]
            time.sleep(0.02)

    def bytes(self) -> dict[str, bytes]:
        """Every result."""
        return {
            f"{place.name}/{name}": (place / name).read_bytes()
            for place in sorted(self.out.iterdir())
            if place.is_dir() and place.name.startswith("clip")
            for name in COMPARED
        }

    def runs(self) -> list[tuple[str, str]]:
        """Name and status of each MLflow run."""
        with sqlite3.connect(self.store) as rows:
            return sorted(rows.execute("select name, status from runs").fetchall())


def unfinished(api: str) -> list[str]:
    """Flow runs of a server that have not ended, and their state."""
    from prefect.client.orchestration import SyncPrefectClient

    with SyncPrefectClient(api) as client:
        return sorted(
            f"{run.name}: {run.state_type.value if run.state_type else None}"
            for run in client.read_flow_runs()
            if run.state_type is None or run.state_type.value not in _TERMINAL
        )


def judged(batch: Batch, undisturbed: dict[str, bytes], ended: dict[str, Any], api: str) -> dict[str, Any]:
    """What a recovered batch must be."""
    found = batch.bytes()
    until = time.monotonic() + 20  # states are written a little later
    while unfinished(api) and time.monotonic() < until:
        time.sleep(0.5)
    return {
        "done": ended["done"],
        "starts": ended["starts"],
        "bytes_equal": found == undisturbed and bool(found),
        "one_run_per_clip": [status for _, status in batch.runs()] == ["FINISHED"] * ended["clips"],
        "runs": batch.runs(),
        "unfinished_flow_runs": unfinished(api),
    }


def crash_postgres(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """The database crashes in the middle of a clip, twice."""
    process = batch.start()
    for pattern in ("frame_*.png", "window_*.npz"):
        batch.until(pattern, process)
        cluster.crash()
        time.sleep(min(away_s, 3))
        cluster.start()
    return batch.finish(process)


def kill_server(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """The server is killed and comes back while the command gives it up, or before."""
    process = batch.start()
    batch.until("window_*.npz", process)
    server.kill()
    time.sleep(min(away_s, 3))
    server.start()
    return batch.finish(process)


def kill_both(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """The machine of the server has a power cut."""
    process = batch.start()
    batch.until("window_*.npz", process)
    server.kill()
    cluster.crash()
    process.wait(timeout=600)
    cluster.start()
    server.start()
    return batch.finish()


def kill_flow(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """The batch itself is killed."""
    process = batch.start()
    batch.until("window_*.npz", process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    return batch.finish()


def kill_worker(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """Who computes is killed."""
    process = batch.start()
    for pattern in ("frame_*.png", "window_*.npz"):
        batch.until(pattern, process)
        while not (found := computing(process.pid)):
            time.sleep(0.05)
        os.kill(found[0], signal.SIGKILL)
    return batch.finish(process)


def jump_clock(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """The clock jumps ahead while frames are looked at, and back while windows are fitted."""
    (library,) = Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1")
    told = batch.folder / "clock"
    told.write_text("+0")
    batch.environment |= {
        "LD_PRELOAD": str(library),
        "FAKETIME_TIMESTAMP_FILE": str(told),
        "FAKETIME_CACHE_DURATION": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "NO_FAKE_STAT": "1",
    }
    process = batch.start()
    for pattern, offset in (("frame_*.png", "+2d"), ("window_*.npz", "-2d")):
        batch.until(pattern, process)
        told.write_text(offset)
    return batch.finish(process)


def lose_mlflow(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """The tracking server goes away for a while, in which clips end; their records are completed."""
    port = free_port()
    batch.environment["MLFLOW_TRACKING_URI"] = f"http://127.0.0.1:{port}"
    tracking = tracking_server(batch.store, port)
    process = batch.start()
    try:
        batch.until("window_*.npz", process)
    finally:
        end(tracking)
    time.sleep(away_s)
    tracking = tracking_server(batch.store, port)
    try:
        return batch.finish(process)
    finally:
        end(tracking)


@contextmanager
def _small_disk(place: Path, megabytes: int) -> Iterator[None]:
    place.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(place)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=False)


def fill_disk(batch: Batch, cluster: Postgres, server: PrefectProcess, away_s: float) -> dict[str, Any]:
    """No room is left for results half-way; then there is again."""
    with _small_disk(batch.out, 64):
        process = batch.start()
        batch.until("frame_*.png", process)
        filler = batch.out / "filler"
        with filler.open("wb") as file:
            try:
                while True:
                    file.write(bytes(1 << 16))
                    file.flush()
            except OSError:
                pass
        time.sleep(5)
        filler.unlink()
        ended = batch.finish(process)
        shutil.copytree(batch.out, batch.folder / "kept", dirs_exist_ok=True)
    batch.out.rmdir()
    (batch.folder / "kept").rename(batch.out)
    return ended


FAULTS: dict[str, Callable[[Batch, Postgres, PrefectProcess, float], dict[str, Any]]] = {
    "postgres": crash_postgres,
    "server": kill_server,
    "both": kill_both,
    "flow": kill_flow,
    "worker": kill_worker,
    "mlflow": lose_mlflow,
    "disk": fill_disk,
    "clock": jump_clock,
}


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=FAULTS, action="append")
    parser.add_argument("--clips", type=int, default=2)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--away", type=float, default=120.0)
    given = parser.parse_args()
    place = given.folder.resolve()
    told: dict[str, Any] = {}
    with postgres(place / "database") as cluster, prefect_server(place, cluster.url) as server:
        quiet = Batch(place / "undisturbed", given.clips, given.frames, server.api)
        quiet.finish()
        for name in given.only or FAULTS:
            began = time.monotonic()
            batch = Batch(place / name, given.clips, given.frames, server.api)
            ended = FAULTS[name](batch, cluster, server, given.away)
            told[name] = judged(batch, quiet.bytes(), ended, server.api) | {"seconds": round(time.monotonic() - began)}
            print(json.dumps({name: told[name]}), file=sys.stderr)
    print(json.dumps(told, indent=1))
    good = ("bytes_equal", "one_run_per_clip")
    return 0 if all(all(one[key] for key in good) and not one["unfinished_flow_runs"] for one in told.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
