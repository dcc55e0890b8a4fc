"""What a login at Prefect cannot do: run code of its own on a worker, by any door of which we know.

Every door is tried with a harmless marker: a file that appears where something was run.
"""

import json
import os
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from http.client import HTTPSConnection
from pathlib import Path
from typing import Any

import httpx
import pytest
from prefect.results import ResultRecord, ResultRecordMetadata
from prefect.serializers import PickleSerializer

from hfb.flows.runtime.deployment_run import COMMAND
from tests.infra.asking import api, ended, prefect_routes, started
from tests.infra.team import Team, missing, stop
from tests.orchestration import Problem

pytestmark = pytest.mark.skipif(missing() is not None, reason=missing() or "")
_ENDED_S = 240
_NOWHERE = {"frames": ["/nowhere/a.png"], "background": "/nowhere/b.png", "out": "/nowhere/out"}  # our flow says so


@pytest.fixture(scope="module")
def worker(here: Team, deployed: dict[str, str]) -> Iterator[None]:
    """The README's own command."""
    command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "hfb"]
    process = here.run(command, deployed | {"PREFECT_WORKER_QUERY_SECONDS": "1"}, "worker-of-doors")
    yield
    stop(process)


@pytest.fixture
def marker(here: Team, request: pytest.FixtureRequest) -> Path:
    return here.folder / f"marker-{abs(hash(request.node.name))}"


def _flow_of(client: httpx.Client, name: str) -> dict[str, Any]:
    return client.get(f"/deployments/name/{name}").json()


def _deployment(client: httpx.Client, name: str, **row: Any) -> str:
    """A deployment of the flow `fit`, whose row says what is wanted."""
    flow = _flow_of(client, "fit/fit")["flow_id"]
    made = client.post("/deployments/", json={"name": name, "flow_id": flow, "work_pool_name": "hfb", **row})
    assert made.status_code in (200, 201), made.text
    return made.json()["id"]


def _run(client: httpx.Client, deployment: str, **more: Any) -> str:
    made = client.post(f"/deployments/{deployment}/create_flow_run", json={"state": {"type": "SCHEDULED"}, **more})
    assert made.status_code == 201, made.text
    return made.json()["id"]


_EVIL = """
from pathlib import Path
from prefect import flow
Path({marker!r}).touch()
@flow
def fit():
    Path({marker!r}).touch()
"""


@pytest.mark.parametrize("door", ["steps", "file", "module", "function"])
def test_a_deployment_with_other_code_runs_nothing(door: str, here: Team, worker: None, marker: Path) -> None:
    """Put there by whoever can: the worker does not believe the row."""
    evil = here.folder / "data" / f"evil_{door}.py"
    evil.write_text(_EVIL.format(marker=str(marker)))
    steps = [{"prefect.deployments.steps.run_shell_script": {"script": f"touch {marker}"}}]
    rows: dict[str, dict[str, Any]] = {
        "steps": {"entrypoint": "hfb.flows.deployed.fit", "pull_steps": steps},
        "file": {"entrypoint": f"{evil}:fit", "path": str(evil.parent)},
        "module": {
            "entrypoint": f"{evil.stem}.fit",
            "pull_steps": [{"prefect.deployments.steps.set_working_directory": {"directory": str(evil.parent)}}],
        },
        "function": {"entrypoint": "os.system", "parameters": {"command": f"touch {marker}"}},
    }
    with api(here, "prefect_admin") as client:
        state = ended(client, _run(client, _deployment(client, f"evil-{door}", **rows[door])), _ENDED_S)
    assert state["type"] == "CRASHED"
    assert "workers of hfb start its own flows alone" in state["message"]
    assert not marker.exists()


def test_hooks_of_a_cancelled_run_are_ours_too(here: Team, worker: None, marker: Path) -> None:
    """Prefect's own worker loads a flow, steps first, to run its hooks when the run is cancelled or crashes."""
    steps = [{"prefect.deployments.steps.run_shell_script": {"script": f"touch {marker}"}}]
    with api(here, "prefect_admin") as client:
        deployment = _deployment(client, "evil-hooks", entrypoint="hfb.flows.deployed.fit", pull_steps=steps)
        run = _run(client, deployment)
        client.post(f"/flow_runs/{run}/set_state", json={"state": {"type": "CANCELLING"}, "force": True})
        assert ended(client, run, _ENDED_S)["type"] in ("CANCELLED", "CRASHED")
    assert not marker.exists()


def test_the_program_of_a_container_refuses_too(here: Team, deployed: dict[str, str], marker: Path) -> None:
    """What a pool of type docker or kubernetes starts; here without a pool, so that no worker takes the run."""
    steps = [{"prefect.deployments.steps.run_shell_script": {"script": f"touch {marker}"}}]
    with api(here, "prefect_admin") as client:
        flow = _flow_of(client, "fit/fit")["flow_id"]
        row = {"name": "evil-container", "flow_id": flow, "entrypoint": "hfb.flows.deployed.fit", "pull_steps": steps}
        made = client.post("/deployments/", json=row)
        run = _run(client, made.json()["id"])
        command = [sys.executable, *COMMAND.split()[1:]]
        program = here.run(command, deployed | {"PREFECT__FLOW_RUN_ID": run}, "container")
        assert program.wait(_ENDED_S) == 2, here.log("container")
        state = client.get(f"/flow_runs/{run}").json()["state"]
    assert state["type"] == "CRASHED"
    assert "workers of hfb start its own flows alone" in state["message"]
    assert not marker.exists()


def _variables(here: Team, marker: Path) -> dict[str, Any]:
    place = here.folder / "data" / "on-the-path"
    place.mkdir(exist_ok=True)
    (place / "sitecustomize.py").write_text(f"open({str(marker)!r}, 'w')")
    return {
        "command": f"touch {marker}",
        "env": {"PYTHONPATH": str(place), "PREFECT__FLOW_ENTRYPOINT": "os.system", "PREFECT_API_URL": "http://x"},
        "working_dir": str(place),
        "image": "evil",
    }


def test_variables_of_a_run_change_nothing(here: Team, worker: None, marker: Path) -> None:
    """Refused by the server where it looks; where it does not (a run made by itself), the worker does not read them."""
    variables = _variables(here, marker)
    with api(here) as client:
        fit = _flow_of(client, "fit/fit")
        loose = {"enforce_parameter_schema": False}
        for name, value in {**variables, "env.PYTHONPATH": variables["env"]["PYTHONPATH"]}.items():
            made = client.post(
                f"/deployments/{fit['id']}/create_flow_run", json={"job_variables": {name: value}, **loose}
            )
            assert made.status_code == 422, name
        of = {"flow_id": fit["flow_id"], "job_variables": variables, "work_pool_name": "hfb", "parameters": _NOWHERE}
        runs = []
        for more in ({"deployment_id": fit["id"]}, {}):
            made = client.post("/flow_runs/", json={**of, **more, "state": {"type": "SCHEDULED"}})
            assert made.status_code == 201, made.text
            runs.append(made.json()["id"])
        states = [ended(client, run, _ENDED_S)["type"] for run in runs]
    assert states == ["FAILED", "CRASHED"]
    assert not marker.exists()


def test_a_changed_pool_changes_nothing(here: Team, worker: None, marker: Path) -> None:
    variables = _variables(here, marker)
    with api(here, "prefect_admin") as client:
        before = client.get("/work_pools/hfb").json()["base_job_template"]
        template = {"job_configuration": variables, "variables": {"type": "object", "properties": {}}}
        assert client.patch("/work_pools/hfb", json={"base_job_template": template}).status_code == 204
        try:
            run = _run(client, _flow_of(client, "fit/fit")["id"], parameters=_NOWHERE)
            assert ended(client, run, _ENDED_S)["type"] == "FAILED"
        finally:
            client.patch("/work_pools/hfb", json={"base_job_template": before})
    assert not marker.exists()


class _Marks:
    """Opened by pickle, it writes a file."""

    def __init__(self, marker: Path) -> None:
        self._marker = marker

    def __reduce__(self) -> Any:
        return Path.touch, (self._marker,)


def test_the_result_that_a_state_names_is_not_read(here: Team, worker: None, marker: Path) -> None:
    """Members set states; Prefect would read the file that one names, and how the file says."""
    pickled = PickleSerializer(picklelib="pickle")
    record: ResultRecord[Any] = ResultRecord(metadata=ResultRecordMetadata(serializer=pickled), result=_Marks(marker))
    file = here.folder / "data" / "result-of-a-member"
    file.write_bytes(record.serialize())
    named = {"storage_key": str(file), "serializer": {"type": "pickle"}}
    with api(here) as client:
        run = started(client, "fit/fit", _NOWHERE)
        until = time.monotonic() + _ENDED_S
        while client.get(f"/flow_runs/{run}").json()["state"]["type"] == "SCHEDULED":
            assert time.monotonic() < until
            time.sleep(0.1)
        done = {"state": {"type": "COMPLETED", "data": named}, "force": True}  # before its process begins
        assert client.post(f"/flow_runs/{run}/set_state", json=done).status_code == 201
    while "no record of hfb's" not in here.log("worker-of-doors"):
        assert not marker.exists()
        assert time.monotonic() < until, here.log("worker-of-doors")
        time.sleep(0.2)
    assert not marker.exists()


_MEMBERS = {
    ("POST", "/api/deployments/{id}/create_flow_run"),
    ("POST", "/api/flows/"),
    ("POST", "/api/flow_runs/"),
    ("POST", "/api/task_runs/"),
    ("POST", "/api/logs/"),
    ("POST", "/api/artifacts/"),
    ("POST", "/api/events"),
    ("POST", "/api/flow_runs/{id}/set_state"),
    ("POST", "/api/task_runs/{id}/set_state"),
    ("PATCH", "/api/flow_runs/{id}/labels"),
    ("PATCH", "/api/task_runs/{id}"),
    ("PATCH", "/api/artifacts/{id}"),
}
_LOOKS = ("filter", "count", "paginate", "history", "lateness", "concurrency_status")
_ID = "00000000-0000-0000-0000-000000000007"


def test_a_member_reaches_what_members_need_and_no_more(here: Team, deployed: dict[str, str]) -> None:
    """All routes of the server, also those of versions to come: what is not for members is the administrator's."""
    routes = prefect_routes(here)
    with api(here) as member, api(here, "prefect_admin") as administrator:
        codes = {route: member.request(route[0], here.url("prefect") + route[1]).status_code for route in routes}
        opened = {(method, path.replace(_ID, "{id}")) for (method, path), code in codes.items() if code != 403}
        changing = {(method, path) for method, path in opened if method != "GET"}
        looking = {(method, path) for method, path in changing if path.split("/")[-1] in _LOOKS or "/ui/" in path}
        looking |= {(method, path) for method, path in changing if "/count-by/" in path}
        assert changing - looking == _MEMBERS
        assert not any("block" in path for _, path in opened)
        told = member.get("/admin/settings").text
        assert not any(here.secret(name).split(":")[-1] in told for name in ("prefect_auth", "postgres_password"))
        for method, path in (("POST", "/deployments/"), ("PATCH", "/work_pools/hfb"), ("POST", "/automations/")):
            assert administrator.request(method, path, json={}).status_code not in (401, 403)


_SPELLINGS = (
    "/api/deployments",
    "/api//deployments/",
    "//api/deployments/",
    "/api/%64eployments/",
    "/api/deployments/%3f/filter",
    "/api/flow_runs/../deployments/",
    "/api/./deployments/",
    "/%61pi/deployments/",
    "/api/deployments/?x=/filter",
    "/api/deployments/#/filter",
    "/api/ui/../deployments/",
    "/api/ui/..%2fdeployments/",
    "/API/deployments/",
    "/api/deployments/;/filter",
    "/x/../api/deployments/",
)


@pytest.mark.parametrize("login", ["member", "member, otherwise spelled"])
def test_no_spelling_of_a_route_opens_it(login: str, here: Team, deployed: dict[str, str]) -> None:
    with api(here) as client:
        flow = _flow_of(client, "fit/fit")["flow_id"]
        headers = dict(client.headers) | {"Content-Type": "application/json"}
        headers["Authorization"] = _basic(here)
        before = client.post("/deployments/count", json={}).json()
        if login != "member":
            headers["Authorization"] = headers["Authorization"].replace("Basic ", "basic ") + "="
        row = json.dumps({"name": "spelled", "flow_id": flow})
        for path in _SPELLINGS:
            assert _raw(here, "POST", path, row, headers)[0] not in (200, 201, 307), path
            code, kind = _raw(here, "GET", path.replace("deployments", "block_documents"), "", headers)
            assert code != 200 or "json" not in kind, path  # a page, which asks for its data itself
        assert client.post("/deployments/count", json={}).json() == before


def _basic(here: Team) -> str:
    request = next(httpx.BasicAuth(*here.secret("prefect_auth").split(":")).auth_flow(httpx.Request("GET", "http://x")))
    return request.headers["Authorization"]


def _raw(here: Team, method: str, path: str, body: str, headers: dict[str, str]) -> tuple[int, str]:
    """Code and kind of the answer to a request whose path nobody has tidied up."""
    tls: ssl.SSLContext = here.tls()
    connection = HTTPSConnection(here.addresses["proxy"], 4200, context=tls, timeout=60)
    connection.putrequest(method, path, skip_accept_encoding=True)
    for name, value in headers.items():
        if name.lower() not in ("host", "connection", "accept-encoding", "content-length"):
            connection.putheader(name, value)
    connection.putheader("Content-Length", str(len(body)))
    connection.endheaders(body.encode())
    answer = connection.getresponse()
    connection.close()
    return answer.status, answer.getheader("Content-Type", "")


def test_parameters_point_into_the_folder_of_the_data(here: Team, worker: None, problem: Problem) -> None:
    """Files elsewhere, links out, stores, networks; tests/flows/test_places.py has all spellings."""
    data = here.folder / "data"
    (data / "out-of-it").symlink_to(here.folder / "secrets")
    (data / "net.pt").write_text("no network")
    (data / "method.toml").write_text("seed = 1")
    (data / "method.py").write_text("def f(observation, starts): ...\n1 / 0\n")
    (data / "method-out").symlink_to(here.folder / "secrets" / "prefect_admin")
    good = {"source": str(data), "out": str(data / "out")}
    compared = {"out": str(data / "compared"), "count": 1}
    fit = {"frames": [str(data / "a.png")], "background": str(data / "b.png"), "out": str(data / "out")}
    asked: dict[str, tuple[str, dict[str, Any]]] = {
        "frames: ": ("fit/fit", fit | {"frames": [str(problem.frame)]}),
        "source: ": ("clip/video", good | {"source": str(data / "out-of-it" / "prefect_auth")}),
        "store: ": ("clip/video", good | {"store": "s3://mlflow/1"}),
        "methods: ": ("methods/benchmark", compared | {"methods": [f"a={data}/method.toml,b=/etc/passwd"]}),
        "methods: b": ("methods/benchmark", compared | {"methods": [f"b={data}/method-out "]}),
        "methods: function": ("methods/benchmark", compared | {"methods": [f"static,c={data}/method.py:f"]}),
        "options.matting.weights: ": (
            "fit/fit",
            fit | {"options": {"matting": {"method": "bgmv2", "weights": str(data / "net.pt")}}},
        ),
    }
    with api(here) as client:
        runs = {words: started(client, name, given) for words, (name, given) in asked.items()}
        states = {words: ended(client, run, _ENDED_S) for words, run in runs.items()}
    for words, state in states.items():
        assert state["type"] == "FAILED", words
        assert words.partition(":")[0] in state["message"], state["message"]
        assert "HFB_ALLOWED" in state["message"], state["message"]


def test_commands_on_a_members_machine_are_recorded(here: Team, deployed: dict[str, str], problem: Problem) -> None:
    """README's steps for another machine, with the login of a member."""
    certificate = str(here.folder / "secrets" / "tls.crt")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "MLFLOW_"))}
    environment |= {
        "PREFECT_API_URL": f"{here.url('prefect')}/api",
        "PREFECT_API_AUTH_STRING": here.secret("prefect_auth"),
        "PREFECT_API_SSL_CERT_FILE": certificate,
        "SSL_CERT_FILE": certificate,
        "REQUESTS_CA_BUNDLE": certificate,
        "MLFLOW_TRACKING_URI": here.url("mlflow"),
        "MLFLOW_TRACKING_USERNAME": "worker",
        "OMP_NUM_THREADS": "1",
        "MLFLOW_TRACKING_PASSWORD": here.secret("mlflow_worker"),
        "HOME": str(here.folder / "member"),
        "XDG_CACHE_HOME": deployed["XDG_CACHE_HOME"],
        "PYTHONPATH": deployed["PYTHONPATH"],
    }
    words = [
        "fit",
        str(problem.frame),
        "--background",
        str(problem.background),
        "--out",
        str(here.folder / "mine"),
        "--json",
        "--init.method",
        "matte",
        "--fit.stages",
        '[{"size_px": 32, "iterations": 3}]',
        "--fit.subframes",
        "2",
        "--fit.texture-px",
        "16",
        "--export.formats",
        "none",
        "--export.films",
        "none",
        "--export.report",
        "false",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "hfb.flows.cli.cli", *words],
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["mlflow_run_id"]
    finished = {"deployment_id": {"is_null_": True}, "state": {"type": {"any_": ["COMPLETED"]}}}
    with api(here) as client:
        runs = client.post("/flow_runs/filter", json={"flow_runs": finished}).json()
    assert len(runs) == 1, done.stderr
    assert "403" not in done.stderr
