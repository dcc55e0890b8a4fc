"""By hand: README's steps for a Prefect server of one's own, and a run of more than three minutes.

    python -m tests.faults.readme_server DIR [--seconds 220]

`prefect server start`, `python infra/deploy.py`, `prefect worker start --pool hfb`, with no setting but where the
server is. The run is a batch whose one clip cannot be written: it waits before the second attempt. Prints one JSON
object: every state the run was seen in, and the seconds between its signs of life. Exit code 0: Running until the end.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx

from tests.faults.servers import prefect_server
from tests.infra.asking import started
from tests.infra.team import stop
from tests.small_clips import small_clip

_ROOT = Path(__file__).parents[2]
_PATIENCE_S = 240


def waiting_clip(data: Path) -> None:
    """A clip whose results' place is taken by a file: it is tried again after the wait of the batch."""
    made = small_clip(2)
    shutil.copytree(made.truth.parent, data / "clips" / "one")
    shutil.copy(made.clip, data / "clips" / "one" / "clip.toml")
    (data / "out").mkdir()
    (data / "out" / "one").write_text("in the way")


def watch(api: httpx.Client, run: str, seconds: float) -> list[str]:
    """The states of a run, in their order, until it ends."""
    seen: list[str] = []
    until = time.monotonic() + seconds + _PATIENCE_S
    while time.monotonic() < until:
        state = api.get(f"/flow_runs/{run}").json()["state"]
        if not seen or seen[-1] != state["name"]:
            seen.append(state["name"])
        if state["type"] in ("COMPLETED", "FAILED", "CRASHED", "CANCELLED"):
            break
        time.sleep(1)
    return seen


def beats(database: Path, run: str) -> list[float]:
    """Seconds between the signs of life of a run."""
    with sqlite3.connect(database) as rows:
        query = "select strftime('%s', occurred) from events where event = ? and resource_id = ? order by occurred"
        found = rows.execute(query, ("prefect.flow-run.heartbeat", f"prefect.flow-run.{run}")).fetchall()
    times = [float(one[0]) for one in found]
    return [after - before for before, after in pairwise(times)]


def measure(place: Path, seconds: float) -> dict[str, Any]:
    """See the module."""
    clips = place / "data" / "clips"
    waiting_clip(place / "data")
    ours = ("PREFECT_", "HFB_", "MLFLOW_")
    settings = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    settings |= {"PREFECT_HOME": str(place / "home"), "PYTHONPATH": str(_ROOT), "HFB_DATA": str(place / "data")}
    settings |= {"MLFLOW_TRACKING_URI": f"sqlite:///{place / 'mlflow.db'}", "XDG_STATE_HOME": str(place / "state")}
    database = place / "prefect.db"
    with ExitStack() as stack:
        server = stack.enter_context(prefect_server(place, f"sqlite+aiosqlite:///{database}"))
        settings["PREFECT_API_URL"] = server.api
        deploy = [sys.executable, str(_ROOT / "infra" / "deploy.py")]
        subprocess.run(deploy, env=settings, check=True, stdout=sys.stderr)
        command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "hfb"]
        worker = subprocess.Popen(command, env=settings, stdout=sys.stderr, cwd=place, start_new_session=True)
        stack.callback(stop, worker)
        with httpx.Client(base_url=server.api, timeout=60) as api:
            given = {"folder": str(clips), "out": str(place / "data" / "out"), "attempts": 2, "wait_s": seconds}
            began = time.monotonic()
            run = started(api, "batch/nightly-batch", given)
            states = watch(api, run, seconds)
        lasted_s = round(time.monotonic() - began)
        time.sleep(5)  # the server writes events in batches
        between = beats(database, run)
    return {"states": states, "lasted_s": lasted_s, "seconds_between_beats": between}


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=220.0)
    given = parser.parse_args()
    place = given.folder.resolve()
    place.mkdir(parents=True)
    told = measure(place, given.seconds)
    print(json.dumps(told, indent=1))
    return 0 if told["states"][-2:] == ["Running", "Completed"] and told["lasted_s"] > given.seconds else 1


if __name__ == "__main__":
    sys.exit(main())
