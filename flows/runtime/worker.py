"""Prefect workers that start only hfb's flows; variables of a run or a pool have no effect.

With Prefect's process worker, whoever starts a run chooses its command, environment and folder (job variables), and the
worker loads the code that a deployment names. `prefect worker start --pool hfb` finds these classes by the pool's type.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Self

from anyio import TASK_STATUS_IGNORED
from anyio.abc import TaskStatus
from prefect.client.orchestration import PrefectClient
from prefect.client.schemas.objects import FlowRun
from prefect.workers.base import BaseJobConfiguration, BaseVariables, BaseWorker, BaseWorkerResult

from hfb.flows.runtime.deployment_run import COMMAND, entrypoint_of, supervise

BEAT = "PREFECT_FLOWS_HEARTBEAT_FREQUENCY"
_SHORTEST_BEAT_S = 30  # Prefect's
NO_VARIABLES: Mapping[str, Any] = {"type": "object", "properties": {}, "additionalProperties": False}


class FixedConfiguration(BaseJobConfiguration):
    """The start of a flow run's process: as the worker was started, whatever run, deployment and pool say.

    The pool sets one thing: the interval of a run's heartbeats, since its server ends runs without them.
    """

    @classmethod
    async def from_template_and_values(
        cls, base_job_template: dict[str, Any], values: dict[str, Any], client: PrefectClient | None = None
    ) -> Self:
        """Take the heartbeat's interval from the pool, and nothing else.

        Args:
            base_job_template: of the pool.
            values: of the run; ignored.
            client: of Prefect's server; ignored.
        """
        beat = (base_job_template.get("job_configuration", {}).get("env") or {}).get(BEAT)
        is_valid = isinstance(beat, str) and beat.isdecimal() and int(beat) >= _SHORTEST_BEAT_S
        return cls(env={BEAT: beat} if is_valid else {})


class HfbWorker(BaseWorker[FixedConfiguration, BaseVariables, BaseWorkerResult]):
    """Starts each flow run in its own process on this machine."""

    type = "hfb"
    job_configuration = FixedConfiguration
    _display_name = "hfb"
    _description = "Runs the flows of hfb, and no others, in processes beside the worker."

    @classmethod
    def get_default_base_job_template(cls) -> dict[str, Any]:
        """Return the template of a pool that a worker creates: no variables."""
        return {"job_configuration": {"env": {}}, "variables": dict(NO_VARIABLES)}

    async def run(
        self, flow_run: FlowRun, configuration: FixedConfiguration, task_status: TaskStatus[int] | None = None
    ) -> BaseWorkerResult:
        """Refuse a run of other code, else run it to its end.

        Args:
            flow_run: the run.
            configuration: with the heartbeat's interval.
            task_status: receives the process id.
        """
        entrypoint = await entrypoint_of(flow_run, self.client)
        environment = {**os.environ, **configuration.env}
        code, process = await supervise(flow_run, entrypoint, environment, task_status or TASK_STATUS_IGNORED)
        return BaseWorkerResult(status_code=code, identifier=process)


def _fixed(configuration: type[Any]) -> type[Any]:
    """Return a job configuration of containers with the pool's image and mounts, and hfb's command."""

    class Fixed(configuration):
        """Job variables of runs and deployments have no effect."""

        @classmethod
        async def from_template_and_values(
            cls, base_job_template: dict[str, Any], values: dict[str, Any], client: PrefectClient | None = None
        ) -> Any:
            """See the class."""
            return await super().from_template_and_values(base_job_template, {}, client=client)

        def prepare_for_flow_run(self, *args: Any, **kwargs: Any) -> None:
            """See the class."""
            self.command = COMMAND
            if hasattr(self, "job_manifest"):  # of a job in Kubernetes, where the command is a container's arguments
                for container in self.job_manifest["spec"]["template"]["spec"]["containers"]:
                    container.pop("command", None)
                    container["args"] = COMMAND
            super().prepare_for_flow_run(*args, **kwargs)

    return Fixed


with suppress(ImportError):  # the extra `team` has it
    from prefect_docker.worker import DockerWorker

    class HfbDockerWorker(DockerWorker):
        """Starts each flow run in a container of its own."""

        type = "hfb-docker"
        job_configuration = _fixed(DockerWorker.job_configuration)


with suppress(ImportError):
    from prefect_kubernetes.worker import KubernetesWorker

    class HfbKubernetesWorker(KubernetesWorker):
        """Starts each flow run in a job of its own."""

        type = "hfb-kubernetes"
        job_configuration = _fixed(KubernetesWorker.job_configuration)
