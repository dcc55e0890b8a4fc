"""What a worker takes from a pool, a deployment and a run: nothing that could be run."""

import importlib
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from uuid import uuid4

import anyio
import pytest
import yaml
from prefect.client.schemas.objects import FlowRun

from hfb.flows.runtime import deployment_run, worker

_INFRA = Path(__file__).parents[2] / "infra"
_EVIL: dict[str, Any] = {
    "command": "touch /tmp/marker",
    "env": {"PYTHONPATH": "/evil", "PREFECT_API_URL": "http://evil"},
    "image": "evil",
    "env.LD_PRELOAD": "/evil.so",
    "working_dir": "/evil",
    "volumes": ["/:/host"],
    "privileged": True,
    "networks": ["host"],
    "name": "evil",
    "labels": {"evil": "1"},
}


def _configured(configuration: type[Any], template: dict[str, Any], values: dict[str, Any]) -> Any:
    async def made() -> Any:
        pool = {"job_configuration": template, "variables": {}}
        nobody: Any = object()  # no server is asked
        return await configuration.from_template_and_values(pool, values, client=nobody)

    config = anyio.run(made)
    config.prepare_for_flow_run(FlowRun(id=uuid4(), flow_id=uuid4(), name="run"))
    return config


def test_the_flows_that_are_started_are_those_that_are_deployed() -> None:
    deployed = yaml.safe_load((_INFRA / "prefect.yaml").read_text())["deployments"]
    assert {one["entrypoint"] for one in deployed} == deployment_run.ENTRYPOINTS
    for entrypoint in deployment_run.ENTRYPOINTS:
        module, _, name = entrypoint.rpartition(".")
        assert getattr(importlib.import_module(module), name)


def test_prefect_finds_the_worker_by_the_pools_type() -> None:
    (found,) = [one for one in entry_points(group="prefect.collections") if one.name == "hfb"]
    assert found.load() is worker
    assert worker.HfbWorker.type == "hfb"


@pytest.mark.parametrize("pool", [{}, _EVIL])
def test_a_process_is_started_as_the_worker_is(pool: dict[str, Any]) -> None:
    config = _configured(worker.FixedConfiguration, pool, _EVIL)
    plain = _configured(worker.FixedConfiguration, {}, {})
    assert config.env.keys() == plain.env.keys()
    assert not {"PYTHONPATH", "LD_PRELOAD"} & set(config.env)
    assert config.env.get("PREFECT_API_URL") == plain.env.get("PREFECT_API_URL")
    assert config.command == plain.command
    assert config.name == "run"


@pytest.mark.parametrize(
    ("beat", "taken"),
    [("30", True), ("300", True), ("29", False), ("-30", False), ("x", False), (30, False), ("", False)],
)
def test_the_pool_sets_how_often_a_run_is_heard_of(beat: Any, taken: bool) -> None:
    config = _configured(worker.FixedConfiguration, {"env": {worker.BEAT: beat}}, {"env": {worker.BEAT: "999999"}})
    assert (config.env.get(worker.BEAT) == beat) is taken


def test_a_container_has_the_pools_image_and_our_command(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("prefect_docker", reason="needs the extra team")
    monkeypatch.syspath_prepend(str(_INFRA))
    for name, value in {"HFB_IMAGE": "ours", "HFB_VOLUMES": "/srv:/data", worker.BEAT: "30"}.items():
        monkeypatch.setenv(name, value)
    deploy = importlib.import_module("deploy")
    try:
        template = deploy._container("docker")
    finally:
        del sys.modules["deploy"]
    assert "{{" not in str(template)  # nothing is left to be filled in
    config = _configured(worker.HfbDockerWorker.job_configuration, template, _EVIL)
    assert config.command == deployment_run.COMMAND
    assert (config.image, config.volumes, config.privileged) == ("ours", ["/srv:/data"], False)
    assert not {"PYTHONPATH", "LD_PRELOAD"} & set(config.env)
    assert config.env[worker.BEAT] == "30"
