"""The decorator of hfb's flows: what Prefect's server stores of a run's parameters holds no secrets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from prefect import Flow

from hfb.flows.runtime.reaper import mark_owner
from hfb.tasks.telemetry.secrets import hidden_in

P = ParamSpec("P")
R = TypeVar("R")


class RecordedFlow(Flow[P, R]):
    """A flow whose function gets its parameters as they are, and whose server gets them without secrets."""

    def serialize_parameters(self, parameters: dict[str, Any]) -> dict[str, Any]:
        """Return the parameters as they are stored.

        Args:
            parameters: of a call.
        """
        return dict(hidden_in(super().serialize_parameters(parameters)))


def recorded_flow(name: str, **options: Any) -> Callable[[Callable[P, R]], Flow[P, R]]:
    """Return a decorator that makes a flow of a function; its results are files and not Prefect's.

    Args:
        name: of the flow.
        **options: of `prefect.flow`.
    """
    return lambda function: RecordedFlow(function, name=name, persist_result=False, on_running=[mark_owner], **options)
