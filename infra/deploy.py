"""Put hfb on a Prefect server: work pool, queues, the deployments of prefect.yaml, and an end for runs that died.

Done again it changes what is there to what is written here, and adds nothing. What it looks at:

    PREFECT_API_URL, PREFECT_API_AUTH_STRING     the server
    HFB_POOL [hfb], HFB_POOL_TYPE [process]      process, docker or kubernetes: how a worker starts a flow run
    HFB_IMAGE, HFB_VOLUMES, HFB_NETWORK          of docker: what a run is started in; HFB_VOLUMES is A:B,C:D
    HFB_NAMESPACE [hfb]                          of kubernetes: where jobs are made
    HFB_DATA [/data]                             where workers see clips and results
    HFB_ALLOWED                                  of docker, kubernetes: what else runs may use (flows/runtime/places.py)
    PREFECT_FLOWS_HEARTBEAT_FREQUENCY [30]       seconds between two signs of life of a run; after three it is Crashed
    HFB_NOTIFY                                   who is told of crashed runs: webhooks, Slack's, mailtos:// and others
    HFB_GPUS [1]                                 GPUs of all workers together: so many runs of the queue `gpu` at once
    MLFLOW_AUTH_ADMIN_PASSWORD                   where it is given: MLFLOW_TRACKING_USERNAME gets an account there
    MLFLOW_S3_ENDPOINT_URL, AWS_...              where they are given: the bucket `mlflow` is made there
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import anyio
import yaml
from automations import addresses_of, end_dead_runs, tell_of_crashes
from prefect.client.orchestration import SyncPrefectClient, get_client
from prefect.client.schemas.actions import WorkPoolCreate
from prefect.exceptions import ObjectNotFound
from prefect.utilities.templating import apply_values, resolve_variables
from prefect.workers.utilities import get_default_base_job_template_for_infrastructure_type

from hfb.errors import install_advice
from hfb.tasks.telemetry.secrets import secret_entry, without_secrets

_FILE = Path(__file__).parent / "prefect.yaml"
_BEAT = "PREFECT_FLOWS_HEARTBEAT_FREQUENCY"
_PATIENCE_S = 180
_BUCKET = "mlflow"
_PASSED_ON = ("MLFLOW_TRACKING_URI", "MLFLOW_TRACKING_USERNAME", "MLFLOW_TRACKING_PASSWORD_FILE")
_PASSED_ON += (_BEAT, "HFB_DATA", "HFB_ALLOWED", "HFB_MLFLOW_PAGES")
_TYPES = {"process": "hfb", "docker": "hfb-docker", "kubernetes": "hfb-kubernetes"}  # of flows/runtime/worker.py
_NO_VARIABLES = {"type": "object", "properties": {}, "additionalProperties": False}


def main() -> None:
    """Everything, in the order in which one needs the other."""
    os.environ.setdefault("HFB_POOL", "hfb")
    os.environ.setdefault(_BEAT, "30")
    told = addresses_of(os.environ.get("HFB_NOTIFY", ""))
    data = Path(os.environ.setdefault("HFB_DATA", "/data"))
    if data.is_dir():  # the watched folder is looked at from now on
        (data / "clips").mkdir(exist_ok=True)
    with get_client(sync_client=True) as client:
        _wait_for(client)
        for deployment in yaml.safe_load(_FILE.read_text())["deployments"]:
            row = anyio.run(resolve_variables, deployment | (deployment.pop("parameters", None) or {}))
            _refuse_secrets(f"deployment {row['name']}", apply_values(row, os.environ, remove_notset=False))
        _make_pool(client, os.environ["HFB_POOL"], os.environ.get("HFB_POOL_TYPE", "process"))
        _limit_gpus(client, os.environ["HFB_POOL"], int(os.environ.get("HFB_GPUS", "1")))
        end_dead_runs(client, int(os.environ[_BEAT]))
        tell_of_crashes(client, told)
    prefect = [sys.executable, "-P", "-m", "prefect", "--no-prompt"]
    subprocess.run([*prefect, "deploy", "--prefect-file", str(_FILE), "--all"], check=True)
    if os.environ.get("MLFLOW_S3_ENDPOINT_URL"):
        _make_bucket(os.environ["MLFLOW_S3_ENDPOINT_URL"])
    if os.environ.get("MLFLOW_AUTH_ADMIN_PASSWORD"):
        _make_account(os.environ["MLFLOW_TRACKING_URI"])


def _wait_for(client: SyncPrefectClient) -> None:
    began = time.monotonic()
    while (trouble := client.api_healthcheck()) is not None:
        if time.monotonic() - began > _PATIENCE_S:
            sys.exit(without_secrets(f"the Prefect server at {client.api_url} does not answer: {trouble}"))
        time.sleep(2)


def _refuse_secrets(place: str, given: dict[str, Any]) -> None:
    """Prefect stores what is given here and shows it to every member, the content of secret blocks too."""
    named = next((name for name, value in given.items() if "prefect.blocks." in str(value)), None)
    if name := named or secret_entry(given):
        sys.exit(
            f"{place}: {name} holds a secret, which Prefect would store and show: leave it out, and put it into the "
            "environment of the workers (infra/settings)"
        )


def _make_pool(client: SyncPrefectClient, name: str, kind: str) -> None:
    """A pool whose workers start what is written here: nothing of it is filled in by a run or a deployment."""
    if kind not in _TYPES:
        sys.exit(f"there is no work pool of type {kind} here: HFB_POOL_TYPE is one of {', '.join(_TYPES)}")
    job: dict[str, Any] = {"env": {_BEAT: os.environ[_BEAT]}} if kind == "process" else _container(kind)
    template = {"job_configuration": job, "variables": _NO_VARIABLES}
    pool = WorkPoolCreate(name=name, type=_TYPES[kind], base_job_template=template, description="flow runs of hfb")
    try:
        if client.read_work_pool(name).type != pool.type:  # it cannot be changed
            client.delete_work_pool(name)
    except ObjectNotFound:
        pass
    client.create_work_pool(pool, overwrite=True)


def _container(kind: str) -> dict[str, Any]:
    """How a container starts: image, settings (secrets come from files in it), and the folder with the clips."""
    env = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
    _refuse_secrets("work pool", env)
    template: dict[str, Any] | None = anyio.run(get_default_base_job_template_for_infrastructure_type, kind)
    if template is None:
        sys.exit(f"Prefect knows no work pool of type {kind}: {install_advice('team')}")
    job = template["job_configuration"]
    given: dict[str, Any] = {
        name: field["default"]
        for name, field in template["variables"]["properties"].items()
        if field.get("default") is not None
    }
    given |= {
        "image": os.environ["HFB_IMAGE"],
        "image_pull_policy": "IfNotPresent",
        "env": env,
        "command": "python -P -m hfb.flows.runtime.deployment_run",
    }
    if kind == "docker":
        given["volumes"] = [one for one in os.environ.get("HFB_VOLUMES", "").split(",") if one]
        given["networks"] = [one for one in os.environ.get("HFB_NETWORK", "").split(",") if one]
        given["auto_remove"] = True
    else:
        pod = job["job_manifest"]["spec"]["template"]["spec"]
        _mount(pod, "data", "/data", {"persistentVolumeClaim": {"claimName": "data"}})
        read = [{"key": one, "path": one} for one in ("prefect_auth", "mlflow_worker")]
        _mount(pod, "secrets", "/run/secrets", {"secret": {"secretName": "hfb", "items": read}})
        given["namespace"] = os.environ.get("HFB_NAMESPACE", "hfb")
        pod["securityContext"] = {"runAsNonRoot": True, "runAsUser": 1000, "fsGroup": 1000}
    return dict(apply_values(job, given, remove_notset=True))


def _mount(pod: dict[str, Any], name: str, path: str, source: dict[str, Any]) -> None:
    pod.setdefault("volumes", []).append({"name": name, **source})
    pod["containers"][0].setdefault("volumeMounts", []).append({"name": name, "mountPath": path})


def _limit_gpus(client: SyncPrefectClient, pool: str, gpus: int) -> None:
    """One fit per GPU: the queue gives out no more runs than there are GPUs, and each GPU's worker takes one."""
    try:
        queue = client.read_work_queue_by_name("gpu", work_pool_name=pool)
    except ObjectNotFound:
        queue = client.create_work_queue("gpu", work_pool_name=pool, description="runs that draw on a GPU")
    client.update_work_queue(queue.id, concurrency_limit=gpus)


def _make_bucket(store: str) -> None:
    import boto3

    s3 = boto3.client("s3", endpoint_url=store)
    if _BUCKET not in {one["Name"] for one in s3.list_buckets()["Buckets"]}:
        s3.create_bucket(Bucket=_BUCKET)


def _make_account(mlflow: str) -> None:
    """An account for the workers; the administrator's password stays here."""
    person = {"username": os.environ["MLFLOW_TRACKING_USERNAME"], "password": os.environ["MLFLOW_TRACKING_PASSWORD"]}
    admin = f"{os.environ.get('MLFLOW_AUTH_ADMIN_USERNAME', 'admin')}:{os.environ['MLFLOW_AUTH_ADMIN_PASSWORD']}"
    headers = {
        "Authorization": f"Basic {base64.b64encode(admin.encode()).decode()}",
        "Content-Type": "application/json",
    }
    url = f"{mlflow.rstrip('/')}/api/2.0/mlflow/users/create"
    try:
        with urlopen(Request(url, json.dumps(person).encode(), headers), timeout=30):
            return
    except HTTPError as error:
        reason = error.read().decode(errors="replace")
        if "RESOURCE_ALREADY_EXISTS" not in reason:
            sys.exit(without_secrets(f"{url} answers {error.code}: {reason[:200]}"))


if __name__ == "__main__":
    main()
