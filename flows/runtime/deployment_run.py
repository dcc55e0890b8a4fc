"""Start the flow of one flow run if its deployment is one of infra/prefect.yaml. Run as a program in containers.

A deployment's row at the server may name any entrypoint, and steps to run before it. Here the row only selects one of
our own flows: nothing that it holds is imported or run, neither to start a flow nor for its hooks.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import UUID

from anyio import TASK_STATUS_IGNORED
from anyio.abc import TaskStatus
from prefect.client.orchestration import PrefectClient, get_client
from prefect.client.schemas.objects import FlowRun, State
from prefect.exceptions import ObjectNotFound
from prefect.runner._flow_run_executor import FlowRunExecutorContext
from prefect.runner._process_manager import ProcessHandle
from prefect.runner._starter_engine import EngineCommandStarter
from prefect.states import Crashed
from prefect.utilities.processutils import command_to_string

from hfb.tasks.telemetry.secrets import hidden_in, secret_entry

ENTRYPOINTS = frozenset(f"hfb.flows.deployed.{name}" for name in ("fit", "video", "batch", "benchmark", "train"))
COMMAND = "python -P -m hfb.flows.runtime.deployment_run"
_ENGINE = command_to_string([sys.executable, "-P", "-m", "hfb.flows.runtime.flow_process"])  # -P: nothing of the folder


class NotOurs(RuntimeError):
    """A flow run that no worker starts."""


async def entrypoint_of(flow_run: FlowRun, client: PrefectClient) -> str:
    """Return the entrypoint of a flow run, one of hfb's.

    Args:
        flow_run: the run.
        client: of Prefect's server.

    Raises:
        NotOurs: it has no deployment, or one with other code or steps of its own, or a secret in its parameters.
    """
    if (name := secret_entry(flow_run.parameters)) is not None:
        await client.update_flow_run(flow_run.id, parameters=hidden_in(flow_run.parameters))
        raise NotOurs(
            f"the parameter {name} holds a secret, which Prefect stores and shows: change the secret, leave it out of "
            "deployment and run, and put the new one into the environment of the workers"
        )
    try:
        deployment = await client.read_deployment(flow_run.deployment_id) if flow_run.deployment_id else None
    except ObjectNotFound:
        deployment = None
    if deployment is None:
        raise NotOurs("workers of hfb start runs of its deployments alone: this run has none")
    if deployment.entrypoint not in ENTRYPOINTS or deployment.pull_steps:
        raise NotOurs(
            f"workers of hfb start its own flows alone: the deployment {deployment.name} has other code, or steps "
            "before it; `python infra/deploy.py` puts ours in place"
        )
    return deployment.entrypoint


async def supervise(
    flow_run: FlowRun,
    entrypoint: str,
    environment: Mapping[str, str | None],
    task_status: TaskStatus[int] = TASK_STATUS_IGNORED,
) -> tuple[int, str]:
    """Run a flow in its own process until it ends or is cancelled; returns exit code and process id.

    Args:
        flow_run: the run.
        entrypoint: its flow.
        environment: further variables of its process.
        task_status: receives the process id.
    """
    async with FlowRunExecutorContext() as context:
        with TemporaryDirectory(prefix="hfb-run-", ignore_cleanup_errors=True) as folder:
            starter = EngineCommandStarter(
                command=_ENGINE,
                cwd=Path(folder),
                env={**environment, "PREFECT__FLOW_ENTRYPOINT": entrypoint},
                control_channel=context.control_channel,
                env_overrides_settings=True,
            )
            executor = context.create_executor(flow_run, starter, hook_runner=_NoHooks(), propose_submitting=False)
            execution = await executor.submit(task_status=_process_id(task_status))
    if execution is None or execution.status_code is None:
        raise RuntimeError("the process of the flow run did not start")
    return execution.status_code, str(execution.handle.pid)


def _process_id(task_status: TaskStatus[int]) -> Any:
    class _Told:
        def started(self, handle: ProcessHandle) -> None:
            assert handle.pid is not None
            task_status.started(handle.pid)

    return _Told()


class _NoHooks:
    """No hooks for crashes and cancellations: those in a server's row are ignored."""

    async def run_cancellation_hooks(self, flow_run: FlowRun, state: State[Any]) -> None:
        """Do nothing.

        Args:
            flow_run: the run.
            state: of the run.
        """

    async def run_crashed_hooks(self, flow_run: FlowRun, state: State[Any]) -> None:
        """Do nothing.

        Args:
            flow_run: the run.
            state: of the run.
        """


async def _in_a_container() -> int:
    async with get_client() as client:
        flow_run = await client.read_flow_run(UUID(os.environ["PREFECT__FLOW_RUN_ID"]))
        try:
            entrypoint = await entrypoint_of(flow_run, client)
        except NotOurs as refused:
            await client.set_flow_run_state(flow_run.id, Crashed(message=str(refused)), force=True)
            print(refused, file=sys.stderr)
            return 2
    code, _ = await supervise(flow_run, entrypoint, {})
    return code


if __name__ == "__main__":
    sys.exit(asyncio.run(_in_a_container()))
