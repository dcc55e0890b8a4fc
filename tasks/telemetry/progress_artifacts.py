"""Progress artifacts: the progress of a flow run's long steps in Prefect's pages.

Light to import: Prefect is loaded long after the display was chosen. An artifact costs its server a request, so short
steps have none, and the others a few updates. They are sent from a thread of their own: a slow or unreachable server
must not delay the work.
"""

from __future__ import annotations

import logging
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import Context, copy_context
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hfb.tasks.telemetry.progress import Display, Shown

if TYPE_CHECKING:
    from uuid import UUID

_FIRST_S, _EVERY_S, _PATIENCE_S = 3.0, 5.0, 5.0
_log = logging.getLogger(__name__)


@dataclass
class _Watched:
    """A step of a flow run; ``context`` holds Prefect's settings from its beginning."""

    shown: Shown
    flow_run: UUID
    context: Context
    artifact: UUID | None = None
    ended: bool = False
    told: tuple[float, str] | None = None


class Artifacts(Display):
    """One progress artifact for every long step that reports its progress.

    The sending thread reads a step when its time comes, so that `update` does nothing; lines are for other displays.
    """

    def __init__(self, first_s: float = _FIRST_S, every_s: float = _EVERY_S) -> None:
        """Begin without steps.

        Args:
            first_s: duration after which a step gets an artifact.
            every_s: interval of its updates.
        """
        self._first_s, self._every_s = first_s, every_s
        self._watched: list[_Watched] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._gone = False

    def begin(self, shown: Shown) -> None:
        """Watch the step, if it belongs to a flow run.

        Args:
            shown: the step.
        """
        flow_run = _flow_run_id()
        if flow_run is not None and not self._gone:
            with self._lock:
                self._watched.append(_Watched(shown, flow_run, copy_context()))

    def end(self, shown: Shown, failed: bool) -> None:
        """Mark the step as ended.

        Args:
            shown: the step.
            failed: whether it raised.
        """
        with self._lock:
            for one in self._watched:
                one.ended = one.ended or one.shown is shown
            self._watched = [one for one in self._watched if not one.ended or one.artifact is not None]

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the sending thread."""
        thread = threading.Thread(target=self._send, name="hfb-artifacts", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join(_PATIENCE_S)

    def _send(self) -> None:
        stopped = False
        while not (stopped or self._gone):
            stopped = self._stop.wait(self._every_s)
            with self._lock:
                due = [one for one in self._watched if one.shown.seconds >= self._first_s]
            for one in due:
                try:
                    one.context.run(_tell, one)
                except Exception as error:  # whatever a server fails with: the run does not depend on it
                    _log.info("no more progress artifacts: %s", error)
                    self._gone = True
                    break
            with self._lock:
                self._watched = [one for one in self._watched if not (one.ended and one in due)]


def _flow_run_id() -> UUID | None:
    """Return the flow run of the caller, or None."""
    contexts = sys.modules.get("prefect.context")
    run = contexts.FlowRunContext.get() if contexts is not None else None
    return run.flow_run.id if run is not None and run.flow_run is not None else None


def _tell(one: _Watched) -> None:
    """Create or update the step's artifact."""
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.actions import ArtifactCreate, ArtifactUpdate

    shown = one.shown
    if not shown.total:
        return
    percent = round(100 * min(shown.done / shown.total, 1.0), 1)
    words = f"{shown.label}: {shown.done} of {shown.total}" + (f", {shown.note}" if shown.note else "")
    if one.told == (percent, words):
        return
    with get_client(sync_client=True) as client:
        if one.artifact is None:
            key = "progress-" + re.sub(r"[^a-z0-9]+", "-", shown.label.lower()).strip("-")
            made = client.create_artifact(
                ArtifactCreate(key=key, type="progress", description=words, data=percent, flow_run_id=one.flow_run)
            )
            one.artifact = made.id
        else:
            client.update_artifact(one.artifact, ArtifactUpdate(data=percent, description=words))
    one.told = percent, words
