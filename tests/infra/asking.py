"""How tests ask Prefect's server through the proxy."""

import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx

from tests.infra.team import Team


@contextmanager
def api(here: Team, login: str = "prefect_auth") -> Iterator[httpx.Client]:
    """Somebody with a login, from outside."""
    known = httpx.BasicAuth(*here.secret(login).split(":"))
    with httpx.Client(base_url=f"{here.url('prefect')}/api", auth=known, verify=here.tls(), timeout=60) as client:
        name = str(uuid.uuid4())  # a second token of one name ends the first
        token = client.get("/csrf-token", params={"client": name}).json()["token"]
        client.headers.update({"Prefect-Csrf-Token": token, "Prefect-Csrf-Client": name})
        yield client


def started(api: httpx.Client, name: str, parameters: dict[str, Any]) -> str:
    """A run of a deployment; its id."""
    deployment = api.get(f"/deployments/name/{name}").json()["id"]
    made = api.post(
        f"/deployments/{deployment}/create_flow_run", json={"parameters": parameters, "state": {"type": "SCHEDULED"}}
    )
    assert made.status_code == 201, made.text
    return made.json()["id"]


def ended(api: httpx.Client, run: str, patience_s: float) -> dict[str, Any]:
    """The last state of a run."""
    until = time.monotonic() + patience_s
    while (state := api.get(f"/flow_runs/{run}").json()["state"])["type"] not in (
        "COMPLETED",
        "FAILED",
        "CRASHED",
        "CANCELLED",
    ):
        assert time.monotonic() < until, state
        time.sleep(0.5)
    return state


def prefect_routes(here: Team) -> list[tuple[str, str]]:
    """Every method and path that the server itself knows, with made-up names in them."""
    inside = f"http://{here.addresses['prefect']}:4200"
    login = httpx.BasicAuth(*here.secret("prefect_auth").split(":"))
    paths = httpx.get(f"{inside}/api/openapi.json", auth=login, timeout=60).json()["paths"]
    return [(method.upper(), "/api" + filled(path)) for path, methods in paths.items() for method in methods]


def filled(path: str) -> str:
    """A route with a made-up name for each of its variables."""
    return "/".join(str(uuid.UUID(int=7)) if "{" in part or "<" in part else part for part in path.split("/"))
