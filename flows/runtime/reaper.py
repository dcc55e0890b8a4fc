"""End flow runs without a process: a killed process leaves them Running in Prefect, so each start ends them.

The same happens where the database is unavailable when a run's end is reported: Prefect's server answers 500, and the
end is not reported again.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import Any
from uuid import UUID

from prefect import get_client
from prefect.client.schemas.filters import FlowRunFilter
from prefect.client.schemas.objects import StateType
from prefect.context import FlowRunContext
from prefect.states import Crashed

from hfb.tasks.tracking.ownership import is_abandoned, owner

_OWNER_LABEL = "hfb.owner"
_UNFINISHED = [StateType.RUNNING.value, StateType.PENDING.value, StateType.CANCELLING.value]
_PAGE = 200
_begun: set[UUID] = set()  # by this process
_log = logging.getLogger(__name__)


def mark_owner(flow: Any, flow_run: Any, state: Any) -> None:
    """Hook of every flow that begins: mark its process, so that a later start can detect that it is gone.

    Args:
        flow: the flow.
        flow_run: its run.
        state: of the run.
    """
    del flow, state
    _begun.add(flow_run.id)
    with suppress(Exception), get_client(sync_client=True) as client:  # without a mark it is merely never reaped
        client.update_flow_run_labels(flow_run.id, {_OWNER_LABEL: owner()})


def end_abandoned_flow_runs() -> int:
    """Set Crashed for every unfinished flow run without a process; returns their number.

    Its process on this machine is gone, or it is this one and the run is not the caller's.
    """
    current = FlowRunContext.get()
    ours = _begun - ({current.flow_run.id} if current is not None and current.flow_run is not None else set())
    unfinished = FlowRunFilter.model_validate({"state": {"type": {"any_": _UNFINISHED}}})
    ended, seen = 0, 0
    with get_client(sync_client=True) as client:
        while True:
            page = client.read_flow_runs(flow_run_filter=unfinished, limit=_PAGE, offset=seen)
            gone = [run for run in page if run.id in ours or is_abandoned(str(run.labels.get(_OWNER_LABEL, "")))]
            for run in gone:
                reason = "its end could not be told" if run.id in ours else "its process was killed"
                client.set_flow_run_state(run.id, Crashed(message=reason), force=True)
                _log.info("flow run %s: Crashed, since %s", run.name, reason)
            ended += len(gone)
            seen += len(page) - len(gone)
            if len(page) < _PAGE:
                return ended
