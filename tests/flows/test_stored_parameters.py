"""What Prefect's server stores of parameters, of runs and of deployments, holds no secrets; a real server says so."""

import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import pytest
import yaml
from prefect.blocks.system import Secret
from prefect.variables import Variable

from hfb.errors import InputError
from hfb.flows.batch import batch
from tests.orchestration import prefect_api

_INFRA = Path(__file__).parents[2] / "infra"
_SECRET = "s3cr3t-of-a-store"
_STORE = f"s3://AKIA:{_SECRET}@bucket/prefix"


def _asked(route: str, **content: Any) -> Any:
    return httpx.post(f"{prefect_api()}/{route}", json=content, timeout=60).raise_for_status().json()


def test_a_flow_that_is_called(store: Path, tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    known = {run["id"] for run in _asked("flow_runs/filter")}
    with pytest.raises(InputError, match="--store is for workers elsewhere"):
        batch(tmp_path / "clips", tmp_path / "out", {"init": {"person": f"token={_SECRET}"}}, store=_STORE)
    (run,) = [one for one in _asked("flow_runs/filter") if one["id"] not in known]
    assert run["parameters"]["folder"] == str(tmp_path / "clips")
    assert run["parameters"]["store"] == "s3://AKIA:***@bucket/prefix"
    assert _SECRET not in str(run)


Deploy = Callable[..., None]


@pytest.fixture
def deploy(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Deploy]:
    """infra/deploy.py with a file of one deployment, to a pool of its name."""
    monkeypatch.syspath_prepend(str(_INFRA))
    for name in [one for one in os.environ if one.startswith("MLFLOW_")]:
        monkeypatch.delenv(name)
    module = importlib.import_module("deploy")
    monkeypatch.setattr(module, "_FILE", tmp_path / "prefect.yaml")

    def put(name: str, parameters: dict[str, Any], **settings: str) -> None:
        row = {"name": name, "entrypoint": "hfb.flows.deployed.batch", "parameters": parameters}
        content = {**yaml.safe_load((_INFRA / "prefect.yaml").read_text()), "deployments": [row]}
        row |= {"work_pool": {"name": name}, "schedules": parameters.pop("schedules", [])}
        (tmp_path / "prefect.yaml").write_text(yaml.safe_dump(content))
        for setting, value in {"HFB_POOL": name, "HFB_DATA": str(tmp_path), **settings}.items():
            monkeypatch.setenv(setting, value)
        module.main()

    yield put
    del sys.modules["deploy"]


_GIVEN: dict[str, Any] = {
    "written": {"store": _STORE},
    "called so": {"options": {"init": {"api_key": _SECRET}}},
    "variable of the environment": {"store": "{{ $STORE_OF_MINE }}"},
    "secret of the environment": {"folder": "{{ $STORE_TOKEN }}"},
    "schedule": {"schedules": [{"interval": 300, "slug": "often", "parameters": {"store": _STORE}}]},
    "block": {"workers": "{{ prefect.blocks.secret.hfb-test-secret }}"},
    "variable of Prefect": {"workers": "dask:{{ prefect.variables.hfb_test_variable }}"},
}


@pytest.mark.parametrize("how", _GIVEN)
def test_a_deployment_is_refused_before_anything_is_stored(how: str, deploy: Deploy) -> None:
    Variable.set("hfb_test_variable", f"tls://me:{_SECRET}@host:8786", overwrite=True)
    Secret(value=_SECRET).save("hfb-test-secret", overwrite=True)
    pool, (name,) = f"pool-{uuid4()}", _GIVEN[how]
    given = {"folder": "/data/clips", "out": "/data/results", **_GIVEN[how]}
    with pytest.raises(SystemExit) as told:
        deploy(pool, given, STORE_OF_MINE=_STORE, STORE_TOKEN=_SECRET)
    assert told.value.code == (
        f"deployment {pool}: {name} holds a secret, which Prefect would store and show: leave it out, and put it into "
        "the environment of the workers (infra/settings)"
    )
    assert _asked("work_pools/filter", work_pools={"name": {"any_": [pool]}}) == []
    assert _SECRET not in str(_asked("deployments/filter"))


def test_a_pool_of_containers_keeps_no_login(deploy: Deploy) -> None:
    with pytest.raises(SystemExit, match="work pool: MLFLOW_TRACKING_URI holds a secret"):
        deploy(f"pool-{uuid4()}", {}, HFB_POOL_TYPE="docker", MLFLOW_TRACKING_URI=f"http://me:{_SECRET}@mlflow:5000")
    assert _SECRET not in str(_asked("work_pools/filter"))


def test_a_run_is_refused_by_the_worker_and_its_secret_hidden(deploy: Deploy) -> None:
    pool = f"pool-{uuid4()}"
    deploy(pool, {"folder": "/data/clips", "out": "/data/results"})
    (deployment,) = _asked("deployments/filter", deployments={"name": {"any_": [pool]}})
    asked = {"parameters": {"store": _STORE, "again": True}, "state": {"type": "SCHEDULED"}}
    run = _asked(f"deployments/{deployment['id']}/create_flow_run", **asked)["id"]
    command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", pool, "--run-once"]
    worker = subprocess.run(command, capture_output=True, text=True, timeout=300)
    ended = httpx.get(f"{prefect_api()}/flow_runs/{run}").json()
    assert ended["state"]["type"] == "CRASHED", worker.stdout + worker.stderr
    assert "the parameter store holds a secret" in ended["state"]["message"]
    assert ended["parameters"]["store"] == "s3://AKIA:***@bucket/prefix"
    assert ended["parameters"]["again"] is True
    assert _SECRET not in str(ended) + worker.stdout + worker.stderr
