"""infra/prefect.yaml against the flows it deploys: entrypoints, parameters, and descriptions of the form's fields."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from prefect.flows import Flow, load_flow_from_entrypoint
from prefect.utilities.callables import parameter_schema

from hfb.config import RunConfig, VideoConfig, preset
from hfb.errors import InputError
from hfb.flows.deployed import Options

_FILE = yaml.safe_load((Path(__file__).parents[2] / "infra" / "prefect.yaml").read_text())
_DEPLOYMENTS = {one["name"]: one for one in _FILE["deployments"]}


def _flow(deployment: dict[str, Any]) -> Flow:
    return load_flow_from_entrypoint(deployment["entrypoint"], use_placeholder_flow=False)


@pytest.mark.parametrize("name", _DEPLOYMENTS)
def test_a_deployment_sets_what_its_flow_takes(name: str) -> None:
    deployment = _DEPLOYMENTS[name]
    schema = parameter_schema(_flow(deployment)).model_dump()
    given = json.loads(json.dumps(deployment.get("parameters", {})).replace("{{ $HFB_DATA }}", "/data"))
    assert set(given) <= set(schema["properties"])
    # What a person still has to fill in is asked for by the form; what is given has to be right.
    jsonschema.validate(given, schema | {"required": []})
    scheduled = [one for one in deployment.get("schedules", ()) if one.get("active", True)]
    if scheduled:  # nobody is there to fill in anything
        assert set(schema["required"]) <= set(given)


@pytest.mark.parametrize("entrypoint", sorted({one["entrypoint"] for one in _DEPLOYMENTS.values()}))
def test_a_form_says_what_every_field_means(entrypoint: str) -> None:
    flow = load_flow_from_entrypoint(entrypoint, use_placeholder_flow=False)
    assert flow.description
    for name, field in parameter_schema(flow).model_dump()["properties"].items():
        assert field.get("description"), f"{entrypoint}: {name}"


def test_a_form_keeps_the_order_in_which_options_are_written() -> None:
    # PostgreSQL keeps the keys of a schema by their length; the page goes by this number.
    flow = load_flow_from_entrypoint("hfb.flows.deployed.fit", use_placeholder_flow=False)
    records = parameter_schema(flow).model_dump()["definitions"]
    for record in (Options, VideoConfig):
        fields = records[record.__name__]["properties"]
        assert sorted(fields, key=lambda name: fields[name]["position"]) == list(record.model_fields)


def test_folders_are_looked_at_one_at_a_time() -> None:
    looks = [one for one in _DEPLOYMENTS.values() if one["entrypoint"].endswith(".batch")]
    assert looks
    for one in looks:
        assert one["concurrency_limit"] == {"limit": 1, "collision_strategy": "CANCEL_NEW"}


def test_what_draws_on_a_gpu_waits_in_the_queue_of_the_gpus() -> None:
    for name, one in _DEPLOYMENTS.items():
        on_gpu = one.get("parameters", {}).get("options", {}).get("fit", {}).get("rasterizer") == "cuda"
        assert (one["work_pool"]["work_queue_name"] == "gpu") == on_gpu, name


def test_options_are_those_of_the_command() -> None:
    assert Options().config() == preset("best")
    assert Options(preset="paper").config() == preset("paper")
    given = Options(seed=3, fit={"subframes": 4, "weights": {"pose": 0.5}})
    config = given.config()
    assert (config.seed, config.fit.subframes, config.fit.weights.pose) == (3, 4, 0.5)
    assert config.fit.weights.image == preset("best").fit.weights.image
    assert set(Options.model_fields) == set(RunConfig.model_fields)
    with pytest.raises(InputError, match=r"did you mean fit\.subframes"):
        Options(fit={"subframe": 4}).config()
