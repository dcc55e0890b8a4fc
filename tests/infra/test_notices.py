"""README's own steps for a server of one's own: healthy runs stay Running, and somebody is told of one that crashed.

The worker has no setting but where the server is, as README says: how often a run is heard of comes with the pool.
"""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import httpx
import psutil
import pytest

from tests.faults.readme_server import waiting_clip
from tests.infra.asking import api, ended, started
from tests.infra.team import ROOT, Team, missing, stop

pytestmark = pytest.mark.skipif(missing() is not None, reason=missing() or "")
_BEAT = "PREFECT_FLOWS_HEARTBEAT_FREQUENCY"


@pytest.fixture
def told(here: Team) -> Iterator[list[dict[str, Any]]]:
    """What is sent to a receiver that listens on the proxy's address."""
    messages: list[dict[str, Any]] = []

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            messages.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer((here.addresses["proxy"], 8080), Receiver) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield messages
        server.shutdown()


def _deploy(here: Team, settings: dict[str, str]) -> int:
    return here.run([sys.executable, str(ROOT / "infra" / "deploy.py")], settings, "setup").wait(240)


def test_a_run_is_heard_of_and_a_crash_is_told(
    here: Team, deployed: dict[str, str], told: list[dict[str, Any]]
) -> None:
    address = f"http://{here.addresses['proxy']}:8080/crashed?token=of-the-receiver"
    plain = {name: value for name, value in deployed.items() if name != _BEAT}
    assert _deploy(here, plain | {"HFB_NOTIFY": address}) == 0, here.log("setup")
    assert "of-the-receiver" not in here.log("setup")
    data = here.folder / "data" / "waits"
    waiting_clip(data)
    command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "hfb"]
    worker = here.run(command, plain | {"PREFECT_WORKER_QUERY_SECONDS": "1"}, "worker-of-notices")
    try:
        with api(here) as client:
            automations = {one["name"]: one for one in client.post("/automations/filter", json={}).json()}
            assert set(automations) == {"hfb: end runs that died", "hfb: tell of crashed runs"}
            patience_s = automations["hfb: end runs that died"]["trigger"]["within"]
            given = {"folder": str(data / "clips"), "out": str(data / "out"), "attempts": 2, "wait_s": 600}
            run = started(client, "batch/nightly-batch", given)  # waits ten minutes before its second attempt
            beats = _beats(client, run, 2)
            assert 2 * (beats[1] - beats[0]) < patience_s
            assert client.get(f"/flow_runs/{run}").json()["state"]["type"] == "RUNNING"
            os.kill(_process_of(run), signal.SIGKILL)
            assert ended(client, run, 60)["type"] == "CRASHED"
            name = client.get(f"/flow_runs/{run}").json()["name"]
            until = time.monotonic() + 60
            while not told:
                assert time.monotonic() < until, here.log("prefect")
                time.sleep(0.2)
        message = told[0]
        assert message["subject"] == f"hfb: {name} crashed"
        assert "started again with the same parameters" in message["text"]
    finally:
        stop(worker)
        assert _deploy(here, deployed) == 0
    with api(here) as client:
        assert [one["name"] for one in client.post("/automations/filter", json={}).json()] == [
            "hfb: end runs that died"
        ]


def _beats(client: httpx.Client, run: str, count: int) -> list[float]:
    """When a run was heard of [s]."""
    from datetime import datetime

    wanted = {"event": {"name": ["prefect.flow-run.heartbeat"]}, "resource": {"id": [f"prefect.flow-run.{run}"]}}
    until = time.monotonic() + 150
    while True:
        found = client.post("/events/filter", json={"filter": wanted}).json()["events"]
        if len(found) >= count:
            return sorted(datetime.fromisoformat(one["occurred"]).timestamp() for one in found)
        assert time.monotonic() < until, found
        time.sleep(1)


def _process_of(run: str) -> int:
    for process in psutil.process_iter():
        try:
            if (
                process.environ().get("PREFECT__FLOW_RUN_ID") == run
                and "hfb.flows.runtime.flow_process" in process.cmdline()
            ):
                return process.pid
        except psutil.Error:
            continue
    raise AssertionError(f"nothing runs {run}")
