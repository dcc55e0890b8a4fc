"""What an account at MLflow cannot reach: another's run and its files, by any route of which we know.

Ann records a run; Eve, who has an account and no permission, tries every door. The same run stays open to Ann.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest

from tests.infra.team import ROOT, Team, missing

pytestmark = pytest.mark.skipif(missing() is not None, reason=missing() or "")
_PASSWORD = "long enough to be one"
_SECRET = "only ann knows"
_API = "/api/2.0/mlflow"


@dataclass(frozen=True)
class Recorded:
    """A run of Ann's; `path` is that of its files below the store's root."""

    experiment: str
    run: str
    path: str


def _account(here: Team, name: str, password: str) -> httpx.Client:
    login = httpx.BasicAuth(name, password)
    return httpx.Client(base_url=here.url("mlflow"), auth=login, verify=here.tls(), timeout=60)


@pytest.fixture(scope="module")
def admin(here: Team, deployed: dict[str, str]) -> Iterator[httpx.Client]:
    with _account(here, "admin", here.secret("mlflow_admin")) as client:
        for name in ("ann", "eve"):
            made = client.post(f"{_API}/users/create", json={"username": name, "password": _PASSWORD})
            assert made.status_code == 200, made.text
        yield client


@pytest.fixture(scope="module")
def ann(here: Team, admin: httpx.Client) -> Iterator[httpx.Client]:
    with _account(here, "ann", _PASSWORD) as client:
        yield client


@pytest.fixture(scope="module")
def eve(here: Team, admin: httpx.Client) -> Iterator[httpx.Client]:
    with _account(here, "eve", _PASSWORD) as client:
        yield client


@pytest.fixture(scope="module")
def recorded(ann: httpx.Client) -> Recorded:
    made = ann.post(f"{_API}/experiments/create", json={"name": "ann's"})
    experiment = made.json()["experiment_id"]
    run = ann.post(f"{_API}/runs/create", json={"experiment_id": experiment, "start_time": 1}).json()["run"]["info"]
    path = run["artifact_uri"].removeprefix("mlflow-artifacts:/")
    sent = ann.put(f"/api/2.0/mlflow-artifacts/artifacts/{path}/secret.txt", content=_SECRET.encode())
    assert sent.status_code == 200, sent.text
    return Recorded(experiment, run["run_id"], path)


def test_an_account_reads_its_own_run(ann: httpx.Client, recorded: Recorded) -> None:
    run = {"run_id": recorded.run}
    assert ann.get(f"{_API}/runs/get", params=run).json()["run"]["info"]["run_id"] == recorded.run
    assert ann.get("/get-artifact", params=run | {"path": "secret.txt"}).text == _SECRET
    assert ann.get(f"/api/2.0/mlflow-artifacts/artifacts/{recorded.path}/secret.txt").text == _SECRET
    assert "secret.txt" in ann.get(f"{_API}/artifacts/list", params=run).text
    found = ann.post(f"{_API}/runs/search", json={"experiment_ids": [recorded.experiment]}).json()
    assert [one["info"]["run_id"] for one in found["runs"]] == [recorded.run]
    metric = {"run_id": recorded.run, "key": "loss", "value": 1.0, "timestamp": 1, "step": 0}
    assert ann.post(f"{_API}/runs/log-metric", json=metric).status_code == 200
    assert ann.get("/").status_code == 200
    assert recorded.run in ann.post("/graphql", json=_query(recorded)).text


def test_an_account_reads_what_the_administrator_grants(
    admin: httpx.Client, ann: httpx.Client, eve: httpx.Client
) -> None:
    """By the commands of infra/compose/README.md, and until it is taken back."""
    granted, taken_back = (f"/api/3.0/mlflow/users/permissions/{one}" for one in ("grant", "revoke"))
    assert f"https://HOST:5000{granted} " in (ROOT / "infra" / "compose" / "README.md").read_text()
    experiment = ann.post(f"{_API}/experiments/create", json={"name": "shown"}).json()["experiment_id"]
    info = ann.post(f"{_API}/runs/create", json={"experiment_id": experiment, "start_time": 1}).json()["run"]["info"]
    run, files = {"run_id": info["run_id"]}, "/api/2.0/mlflow-artifacts/artifacts"
    path = info["artifact_uri"].removeprefix("mlflow-artifacts:/")
    assert ann.put(f"{files}/{path}/shown.txt", content=b"shown").status_code == 200

    def codes() -> list[int]:
        return [
            eve.get(f"{_API}/runs/get", params=run).status_code,
            eve.get("/get-artifact", params=run | {"path": "shown.txt"}).status_code,
            eve.put(f"{files}/{path}/eves.txt", content=b"x").status_code,
            eve.post(f"{_API}/runs/delete", json=run).status_code,
        ]

    right = {"username": "eve", "resource_type": "experiment", "resource_id": experiment}
    for who in (ann, eve):
        assert who.post(granted, json=right | {"permission": "READ"}).status_code == 403
    assert codes() == [403] * 4
    assert admin.post(granted, json=right | {"permission": "READ"}).status_code == 200
    assert codes() == [200, 200, 403, 403]
    assert admin.post(taken_back, json=right).status_code == 200
    assert codes() == [403] * 4


def _query(recorded: Recorded) -> dict[str, Any]:
    text = "query($d: MlflowGetRunInput!) {mlflowGetRun(input: $d) {run {info {runId artifactUri}}}}"
    return {"query": text, "variables": {"d": {"runId": recorded.run}}}


def test_no_route_of_runs_shows_anothers(eve: httpx.Client, recorded: Recorded) -> None:
    run, files = {"run_id": recorded.run}, "/api/2.0/mlflow-artifacts/artifacts"
    first, _, rest = recorded.path.partition("/")
    answers = {
        "run": eve.get(f"{_API}/runs/get", params=run),
        "ajax": eve.get("/ajax-api/2.0/mlflow/runs/get", params=run),
        "list": eve.get(f"{_API}/artifacts/list", params=run),
        "file": eve.get("/get-artifact", params=run | {"path": "secret.txt"}),
        "proxied": eve.get(f"{files}/{recorded.path}/secret.txt"),
        "proxied, ajax": eve.get(f"/ajax-api/2.0/mlflow-artifacts/artifacts/{recorded.path}/secret.txt"),
        "proxied, encoded": eve.get(f"{files}/{recorded.path.replace('/', '%2F')}%2Fsecret.txt"),
        "proxied, dots": eve.get(f"{files}/0/%2e%2e/{recorded.path}/secret.txt"),
        "proxied, slashes": eve.get(f"{files}//{first}//{rest}/secret.txt"),
        "proxied, listed": eve.get(files, params={"path": recorded.path}),
        "proxied, all": eve.get(files),
        "history": eve.get(f"{_API}/metrics/get-history", params=run | {"metric_key": "loss"}),
        "bulk": eve.get("/ajax-api/2.0/mlflow/metrics/get-history-bulk", params=run | {"metric_key": "loss"}),
        "search": eve.post(f"{_API}/runs/search", json={"experiment_ids": [recorded.experiment]}),
        "experiment": eve.get(f"{_API}/experiments/get", params={"experiment_id": recorded.experiment}),
        "experiments": eve.post(f"{_API}/experiments/search", json={"max_results": 100}),
        "graphql": eve.post("/graphql", json=_query(recorded)),
    }
    for door, answer in answers.items():
        assert _SECRET not in answer.text, door
        assert recorded.path not in answer.text, door
        assert "secret.txt" not in answer.text, door
        assert "ann's" not in answer.text, door
    written = eve.put(f"{files}/{recorded.path}/eves.txt", content=b"x")
    assert written.status_code == 403
    assert eve.post(f"{_API}/runs/delete", json=run).status_code == 403


def test_no_experiment_has_its_files_in_anothers_place(eve: httpx.Client, recorded: Recorded) -> None:
    places = (
        f"s3://mlflow/{recorded.path}",
        f"s3://mlflow/{recorded.experiment}",
        f"mlflow-artifacts:/{recorded.path}",
        f"mlflow-artifacts:/{recorded.experiment}",
        "file:///etc",
        "/etc",
        "http://127.0.0.1/",
        "s3://mlflow",
        ".",
    )
    for number, place in enumerate(places):
        for key in ("artifact_location", "artifactLocation"):
            given = {"name": f"eve's {number} {key}", key: place}
            assert eve.post(f"{_API}/experiments/create", json=given).status_code == 400, place
    mine = eve.post(f"{_API}/experiments/create", json={"name": "eve's own"}).json()["experiment_id"]
    told = eve.get(f"{_API}/experiments/get", params={"experiment_id": mine}).json()["experiment"]
    assert told["artifact_location"] == f"mlflow-artifacts:/{mine}"


def test_no_model_names_anothers_files(eve: httpx.Client, admin: httpx.Client, here: Team, recorded: Recorded) -> None:
    """The proxy closes the registry to accounts; behind it the server takes no version's source from anybody."""
    for prefix in ("/api/2.0/mlflow", "/ajax-api/2.0/mlflow"):
        named = {"name": "model"}
        assert eve.post(f"{prefix}/registered-models/create", json=named).status_code == 403
        assert eve.post(f"{prefix}/model-versions/create", json=named | {"source": "s3://mlflow"}).status_code == 403
        asked = named | {"version": "1"}
        assert eve.get(f"{prefix}/model-versions/get-download-uri", params=asked).status_code == 403
    assert eve.get("/model-versions/get-artifact", params={"name": "model", "version": "1"}).status_code == 403
    inside = httpx.Client(base_url=f"http://{here.addresses['mlflow']}:5000", auth=eve.auth, timeout=60)
    with inside:
        assert inside.post(f"{_API}/registered-models/create", json={"name": "inside"}).status_code == 200
        for source in (f"s3://mlflow/{recorded.path}", f"mlflow-artifacts:/{recorded.path}", "s3://mlflow/", "x\n"):
            version = {"name": "inside", "source": source}
            assert inside.post(f"{_API}/model-versions/create", json=version).status_code == 400, source
    assert admin.get(f"{_API}/registered-models/search").status_code == 200  # who is asked to look may


_CLOSED = (
    "registered-models",
    "model-versions",
    "logged-models",
    "traces",
    "prompts",
    "gateway",
    "jobs",
    "webhooks",
    "scorers",
    "datasets",
    "presigned",
    "workspaces",
    "roles",
    "get-trace-artifact",
    "review-queues",
    "label-schemas",
    "issues",
    "promptlab",
    "unified-traces",
    "demo",
    "genai",
    "log-model",
    "runs/outputs",
    "users/create",
)


def test_what_hfb_does_not_use_is_closed(eve: httpx.Client, admin: httpx.Client) -> None:
    """By the list of routes that MLflow itself has: only what runs need is open, in every version of its API."""
    from tests.infra.test_team import _mlflow_routes

    routes = [(method, path) for method, path in _mlflow_routes() if "/static" not in path]
    codes = {(method, path): eve.request(method, path).status_code for method, path in routes}
    opened = {path for (_, path), code in codes.items() if code != 403}
    assert [path for path in opened if any(word in path for word in _CLOSED)] == []
    used = re.compile(
        r"/|/health|/version|/graphql|/get-artifact|/(ajax-)?api/2\.0/mlflow/(experiments|runs|metrics|artifacts|users)/.*"
        r"|/(ajax-)?api/2\.0/mlflow-artifacts/.*|/(ajax-)?api/3\.0/mlflow/(server-info|ui-telemetry)"
    )
    assert [path for path in opened if not used.fullmatch(path)] == []


_SPELLED = (
    "/api/2.0/mlflow//registered-models/create",
    "//api/2.0/mlflow/registered-models/create",
    "/api/2.0/mlflow/%72egistered-models/create",
    "/api/2.0/mlflow/runs/../registered-models/create",
    "/api/2.0/mlflow/registered-models/create/",
    "/api/2.0/mlflow/registered-models/create?x=/runs/search",
    "/AJAX-API/2.0/mlflow/registered-models/create",
    "/static-files/../api/2.0/mlflow/registered-models/create",
    "/api/2.0/mlflow-artifacts/mpu/create/../../../mlflow/registered-models/create",
)


def test_no_spelling_of_a_route_opens_it(eve: httpx.Client, admin: httpx.Client) -> None:
    for path in _SPELLED:
        asked = eve.base_url.copy_with(raw_path=path.encode())
        answer = eve.post(asked, json={"name": "m"})
        assert answer.status_code in (400, 403, 404, 405), path
    found = admin.get(f"{_API}/registered-models/search").json().get("registered_models", [])
    assert "m" not in [one["name"] for one in found]
