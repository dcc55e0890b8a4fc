"""Flow runs that nobody runs any more: kill -9 leaves them Running in Prefect for ever, so each start ends them.

So does a database that is away when a run's end is told: Prefect's server answers 500, and nobody tells it again.
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
    """Hook of every flow that begins: whose it is, so that a later start can tell that its process is gone."""
    del flow, state
    _begun.add(flow_run.id)
    with suppress(Exception), get_client(sync_client=True) as client:  # without a mark it is merely never reaped
        client.update_flow_run_labels(flow_run.id, {_OWNER_LABEL: owner()})


def end_abandoned_flow_runs() -> int:
    """Crashed for every unfinished flow run that nobody runs; returns how many there were.

    Its process on this machine is gone, or it is this one, and the run is not the one in which this is called.
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
