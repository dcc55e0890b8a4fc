"""Flow runs that nobody runs any more: kill -9 leaves them Running in Prefect for ever, so each start ends them."""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import Any

from prefect import get_client
from prefect.client.schemas.filters import FlowRunFilter
from prefect.client.schemas.objects import StateType
from prefect.states import Crashed

from tasks.ownership import is_abandoned, owner

_OWNER_LABEL = "hfb.owner"
_UNFINISHED = [StateType.RUNNING.value, StateType.PENDING.value, StateType.CANCELLING.value]
_PAGE = 200
_log = logging.getLogger(__name__)


def mark_owner(flow: Any, flow_run: Any, state: Any) -> None:
    """Hook of every flow that begins: whose it is, so that a later start can tell that its process is gone."""
    del flow, state
    with suppress(Exception), get_client(sync_client=True) as client:  # without a mark it is merely never reaped
        client.update_flow_run_labels(flow_run.id, {_OWNER_LABEL: owner()})


def end_abandoned_flow_runs() -> int:
    """Crashed for every unfinished flow run whose process on this machine is gone; returns how many there were."""
    unfinished = FlowRunFilter.model_validate({"state": {"type": {"any_": _UNFINISHED}}})
    ended, seen = 0, 0
    with get_client(sync_client=True) as client:
        while True:
            page = client.read_flow_runs(flow_run_filter=unfinished, limit=_PAGE, offset=seen)
            gone = [run for run in page if is_abandoned(str(run.labels.get(_OWNER_LABEL, "")))]
            for run in gone:
                client.set_flow_run_state(run.id, Crashed(message="its process was killed"), force=True)
                _log.info("flow run %s: Crashed, since its process is gone", run.name)
            ended += len(gone)
            seen += len(page) - len(gone)
            if len(page) < _PAGE:
                return ended
