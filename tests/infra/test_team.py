"""Prefect and MLflow for a team, run for real: the settings of infra/ on PostgreSQL, behind the proxy.

Without credentials nothing answers but the login; with them a flow of infra/prefect.yaml runs end to end.
"""

import asyncio
import json
import re
import shutil
import subprocess
import sys
from base64 import b64encode
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest
import yaml

from tests.infra.asking import api, ended, filled, prefect_routes, started
from tests.infra.team import ROOT, Team, free_of, missing, pg_environment, psql, stop
from tests.orchestration import Problem

pytestmark = pytest.mark.skipif(missing() is not None, reason=missing() or "")
_TINY = {
    "init": {"method": "matte"},
    "fit": {"stages": [{"size_px": 32, "iterations": 3}], "subframes": 2, "texture_px": 16},
    "export": {"formats": [], "films": [], "report": False},
}
_OPEN = {("GET", "/api/health"), ("GET", "/api/ready")}
_NOT_ALLOWED = 1008  # RFC 6455: policy violation
_METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE")


def _mlflow_routes() -> list[tuple[str, str]]:
    """Every method and path of MLflow's two applications, those of accounts among them."""
    told = subprocess.run(
        [sys.executable, "-c", _TELL_ROUTES],
        capture_output=True,
        text=True,
        check=True,
        env={"PATH": "", "MLFLOW_DISABLE_TELEMETRY": "true"},
    )
    return [(method, filled(path)) for method, path in json.loads(told.stdout.splitlines()[-1])]


_TELL_ROUTES = """
import json
from mlflow.server import app
from mlflow.server.auth import routes
from mlflow.server.fastapi_app import create_fastapi_app
told = [(method, rule.rule) for rule in app.url_map.iter_rules() for method in rule.methods]
for one in create_fastapi_app(app).routes:
    told += [(method, one.path) for method in getattr(one, "methods", None) or ()]
told += [(method, path) for name, path in vars(routes).items() if name.isupper() for method in ("GET", "POST", "PATCH")]
print(json.dumps(sorted({one for one in told if one[0] in ("GET", "POST", "PUT", "PATCH", "DELETE")})))
"""


def _codes(anybody: httpx.Client, base: str, routes: list[tuple[str, str]]) -> dict[tuple[str, str], int]:
    def ask(route: tuple[str, str]) -> int:
        return anybody.request(route[0], base + route[1]).status_code

    with ThreadPoolExecutor(4) as threads:
        return dict(zip(routes, threads.map(ask, routes), strict=True))


def test_without_credentials_prefect_only_says_that_it_is_there(here: Team, anybody: httpx.Client) -> None:
    routes = prefect_routes(here)
    assert len(routes) > 150
    codes = _codes(anybody, here.url("prefect"), routes)
    # 403: what changes something asks for the page's own token before it asks who somebody is.
    assert {route for route, code in codes.items() if code != (401 if route[0] == "GET" else 403)} == _OPEN
    wrong = httpx.BasicAuth("hfb", "guess")
    assert anybody.get(f"{here.url('prefect')}/api/admin/version", auth=wrong).status_code == 401
    for listing in ("/docs", "/redoc", "/openapi.json", "/api/docs", "/api/openapi.json"):
        assert anybody.get(here.url("prefect") + listing).status_code in (401, 404)
    page = anybody.get(here.url("prefect"), follow_redirects=True)
    assert page.status_code == 200  # the login
    assert "<script" in page.text


@pytest.mark.parametrize("path", ["/api/task_runs/subscriptions/scheduled", "/api/work_pools/hfb/workers/connect"])
def test_sockets_of_workers_are_for_the_administrators_key(here: Team, deployed: dict[str, str], path: str) -> None:
    """A socket's login is in its first message, which the proxy does not see: a member's would do."""
    url = here.url("prefect").replace("https", "wss") + path
    said = {"type": "auth", "token": here.secret("prefect_auth")}
    for spelled in (path, path.replace("/api/", "/api//"), path.replace("_", "%5f")):
        assert asyncio.run(_refusal(here, url.replace(path, spelled), ["prefect"], said)) in (401, 403)
    key = {"Hfb-Administrator": b64encode(here.secret("prefect_admin").encode()).decode()}
    with pytest.raises(AssertionError, match="auth_success"):
        asyncio.run(_refusal(here, url, ["prefect"], said, key))


@pytest.mark.parametrize("path", ["/api/events/in", "/api/events/out", "/api/logs/out"])
def test_without_credentials_no_socket_says_a_word(here: Team, path: str) -> None:
    url = here.url("prefect").replace("https", "wss") + path
    assert asyncio.run(_refusal(here, url, None, None)) == 403
    assert asyncio.run(_refusal(here, url, ["prefect"], None)) == _NOT_ALLOWED
    assert asyncio.run(_refusal(here, url, ["prefect"], {"type": "auth", "token": "guess"})) == _NOT_ALLOWED


async def _refusal(
    here: Team,
    url: str,
    protocols: list[str] | None,
    said: dict[str, str] | None,
    headers: dict[str, str] | None = None,
) -> int:
    """The code with which a socket refuses. Not by threads: under Python 3.11 they now and then hang in TLS."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed, InvalidStatus

    try:
        async with connect(
            url, ssl=here.tls(), subprotocols=protocols, additional_headers=headers, open_timeout=60
        ) as socket:
            await socket.send(json.dumps(said or {"type": "subscribe", "keys": ["x"], "filter": {}}))
            raise AssertionError(f"it answered {await asyncio.wait_for(socket.recv(), 60)!r}")
    except InvalidStatus as error:
        return error.response.status_code
    except ConnectionClosed as error:
        return error.rcvd.code if error.rcvd else 0


def test_without_credentials_mlflow_only_says_that_it_is_there(here: Team, anybody: httpx.Client) -> None:
    routes = _mlflow_routes()
    assert len(routes) > 200
    codes = _codes(anybody, here.url("mlflow"), [*routes, ("GET", "/static-files/index.html"), ("GET", "/")])
    assert {route for route, code in codes.items() if code != 401} == {("GET", "/health")}
    wrong = anybody.get(f"{here.url('mlflow')}/version", auth=httpx.BasicAuth("admin", "guess"))
    assert wrong.status_code == 401
    assert wrong.headers["www-authenticate"].startswith("Basic")


def test_only_under_its_own_name_and_only_encrypted(here: Team, anybody: httpx.Client) -> None:
    for service, port in (("prefect", 4200), ("mlflow", 5000)):
        assert anybody.get(f"{here.url(service)}/health", headers={"Host": "evil.example"}).status_code == 421
        plain = anybody.get(f"http://{here.addresses['proxy']}:{port}/")
        assert plain.status_code == 400
    admin = httpx.BasicAuth("admin", here.secret("mlflow_admin"))
    inside = f"http://{here.addresses['mlflow']}:5000/api/2.0/mlflow/users/current"
    assert anybody.get(inside, auth=admin).status_code == 200
    assert anybody.get(inside, auth=admin, headers={"Host": "evil.example"}).status_code == 403
    assert free_of(here.addresses["proxy"], 5432)
    assert free_of(here.addresses["proxy"], 8333)


def test_with_credentials_a_flow_runs_end_to_end(here: Team, deployed: dict[str, str], problem: Problem) -> None:
    out = here.folder / "data" / "result"
    command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "hfb", "--work-queue", "default"]
    worker = here.run(command, deployed, "worker")
    try:
        with api(here) as client:
            refused = client.post(
                f"/deployments/{client.get('/deployments/name/fit/fit').json()['id']}/create_flow_run",
                json={"parameters": {"frames": 3}},
            )
            assert refused.status_code == 409
            frame, plate = (shutil.copy(one, here.folder / "data") for one in (problem.frame, problem.background))
            given = {"frames": [str(frame)], "background": str(plate), "out": str(out)}
            run = started(client, "fit/fit", given | {"options": _TINY})
            state = ended(client, run, 240)
            assert state["type"] == "COMPLETED", (state, here.log("worker"))
            watched = {"deployments": {"name": {"any_": ["watched-folder"]}}}
            looks = client.post("/flow_runs/filter", json=watched).json()
            assert len(looks) > 1  # the schedule made them
            automations = [one["name"] for one in client.post("/automations/filter", json={}).json()]
            assert automations == ["hfb: end runs that died"]
            queue = client.get("/work_pools/hfb/queues/gpu").json()
            assert queue["concurrency_limit"] == 1
    finally:
        stop(worker)
    with np.load(out / "motion.npz", allow_pickle=False) as motion:
        assert motion["poses"].shape == (2, 72)
    result = json.loads((out / "result.json").read_text())
    assert result["mlflow_link"].startswith(here.url("mlflow"))
    _is_recorded(here, result["mlflow_run_id"])


def _is_recorded(here: Team, run: str) -> None:
    """FINISHED in MLflow, its files in the store; whoever has no permission does not see it."""
    worker = httpx.BasicAuth("worker", here.secret("mlflow_worker"))
    with httpx.Client(base_url=here.url("mlflow"), auth=worker, verify=here.tls(), timeout=60) as mlflow:
        told = mlflow.get("/api/2.0/mlflow/runs/get", params={"run_id": run}).json()["run"]
        assert told["info"]["status"] == "FINISHED"
        assert told["info"]["artifact_uri"].startswith("mlflow-artifacts:/")
        files = mlflow.get("/api/2.0/mlflow/artifacts/list", params={"run_id": run}).json()["files"]
        assert any("motion.npz" in one["path"] or one["is_dir"] for one in files)
        shown = mlflow.get("/get-artifact", params={"run_id": run, "path": "result.json"})
        assert shown.status_code == 200
        admin = httpx.BasicAuth("admin", here.secret("mlflow_admin"))
        person = {"username": "somebody", "password": "long enough to be one"}
        assert mlflow.post("/api/2.0/mlflow/users/create", json=person, auth=admin).status_code == 200
        strange = httpx.BasicAuth(*person.values())
        assert mlflow.get("/api/2.0/mlflow/runs/get", params={"run_id": run}, auth=strange).status_code == 403
        assert mlflow.post("/api/2.0/mlflow/users/create", json=person, auth=worker).status_code == 403


def test_a_backup_brings_everything_back(here: Team, deployed: dict[str, str], tmp_path: Path) -> None:
    """The store is moto's here, which keeps all in memory: a folder stands for its files."""
    (here.folder / "files").mkdir()
    (here.folder / "files" / "one").write_text("kept")
    environment = pg_environment(here) | {
        "IN_POSTGRES": "env",
        "IN_STORE": "env",
        "STORE_FOLDER": str(here.folder / "files"),
    }

    def script(name: str, folder: Path) -> subprocess.CompletedProcess[str]:
        command = [str(ROOT / "infra" / "compose" / name), str(folder)]
        return subprocess.run(command, env=environment, capture_output=True, text=True)

    def counted() -> list[str]:
        queries = {"prefect": "select count(*) from deployment", "mlflow_auth": "select count(*) from users"}
        asked = [psql(here, "--tuples-only", "--command", query, database=name) for name, query in queries.items()]
        return [
            subprocess.run(one, env=environment, capture_output=True, text=True, check=True).stdout for one in asked
        ]

    before = counted()
    done = script("backup.sh", tmp_path / "backup")
    assert done.returncode == 0, done.stderr
    assert script("backup.sh", tmp_path / "backup").returncode == 2  # never over another
    assert script("restore.sh", tmp_path).returncode == 2  # no backup
    assert counted() == before
    subprocess.run(psql(here, "--command", "delete from deployment", database="prefect"), env=environment, check=True)
    shutil.rmtree(here.folder / "files")
    (here.folder / "files").mkdir()
    assert counted() != before
    done = script("restore.sh", tmp_path / "backup")
    assert done.returncode == 0, done.stderr
    assert counted() == before
    assert (here.folder / "files" / "one").read_text() == "kept"


_WRITES = """
import itertools, sys
from pathlib import Path
for number in itertools.count():
    Path(sys.argv[1], f"new-{number}").touch()
    Path(sys.argv[1], f"new-{number}").unlink()
"""


def test_a_store_that_stops_in_the_middle_is_no_backup(here: Team, tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "one").write_bytes(bytes(range(256)) * 400)
    (tmp_path / "cut").write_text('#!/bin/sh\n"$@" | head -c 50000\nexit 1\n')
    (tmp_path / "cut").chmod(0o755)
    environment = pg_environment(here) | {
        "IN_POSTGRES": "env",
        "IN_STORE": str(tmp_path / "cut"),
        "STORE_FOLDER": str(tmp_path / "store"),
    }
    command = [str(ROOT / "infra" / "compose" / "backup.sh"), str(tmp_path / "backup")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert "could not be read to their end" in done.stderr
    assert not (tmp_path / "backup").exists()


def test_the_nightly_job_of_kubernetes_makes_a_backup(here: Team, deployed: dict[str, str], tmp_path: Path) -> None:
    """Its own command line, with this machine's folders in place of its mounts."""
    (job,) = [
        one
        for one in yaml.safe_load_all((ROOT / "infra" / "kubernetes" / "backup.yaml").read_text())
        if one["kind"] == "CronJob"
    ]
    (container,) = job["spec"]["jobTemplate"]["spec"]["template"]["spec"]["containers"]
    (tmp_path / "store").mkdir()
    for number in range(300):
        (tmp_path / "store" / str(number)).write_bytes(bytes(200_000))
    old = [tmp_path / "backups" / f"20{number:02d}-01-01T023000" for number in range(15)]
    for folder in (*old, tmp_path / "backups" / "2020-01-01T023000.part"):
        folder.mkdir(parents=True)
    places = {
        "/etc/hfb/": f"{ROOT}/infra/settings/",
        "/etc/backup/": f"{ROOT}/infra/compose/",
        "/backups": f"{tmp_path}/backups",
        "/run/secrets": f"{here.folder}/secrets",
        "/store": f"{tmp_path}/store",
    }

    def here_of(text: str) -> str:
        return re.sub("|".join(places), lambda found: places[found[0]], text)

    environment = pg_environment(here) | {one["name"]: here_of(one["value"]) for one in container["env"]}
    environment |= {"PGHOST": here.addresses["postgres"], "HFB_SECRETS": f"{here.folder}/secrets"}
    del environment["PGPASSWORD"]  # it comes from its file
    command = [here_of(word) for word in (*container["command"], *container["args"])]
    with subprocess.Popen([sys.executable, "-c", _WRITES, str(tmp_path / "store")]) as runs:  # meanwhile
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        runs.kill()
    assert done.returncode == 0, done.stderr
    *kept, made = sorted((tmp_path / "backups").iterdir())
    assert [one.name for one in kept] == [one.name for one in old[2:]]  # fourteen with the new one
    assert {one.name for one in made.iterdir()} == {"prefect.dump", "mlflow.dump", "mlflow_auth.dump", "store.tar"}
    assert all(one.stat().st_size for one in made.iterdir())


def test_the_key_of_the_proxy_is_no_secret_of_the_world(here: Team) -> None:
    token = b64encode(here.secret("prefect_auth").encode()).decode()
    for name in ("prefect", "mlflow", "proxy", "setup", "worker", "store"):
        said = here.log(name)
        for secret in ("postgres_password", "mlflow_admin", "mlflow_worker", "mlflow_flask_key", "store_key"):
            assert here.secret(secret) not in said, name
        assert token not in said, name
