"""Comparison of recorded runs: differences in options, inputs, machines and metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hfb.config import current_option_name
from hfb.tasks.results.stored_runs import StoredRun

_ENVIRONMENT = ("version.", "code", "platform", "processor", "device")
_FIRST = ("eval/", "rerun/", "time/", "fit/", "loss/total")


class Words(NamedTuple):
    """A text of every run under one name; None where a run has none."""

    name: str
    values: tuple[str | None, ...]


class Numbers(NamedTuple):
    """A metric of every run; None where a run lacks it or it is no number."""

    name: str
    values: tuple[float | None, ...]


@dataclass(frozen=True)
class RunComparison:
    """Two runs or more.

    Attributes:
        config: options, inputs and clip where they differ.
        same_options: number of equal ones.
        environment: versions, code and machine where they differ.
        metrics: every metric, errors and scores before losses.
    """

    runs: tuple[StoredRun, ...]
    config: tuple[Words, ...]
    same_options: int
    environment: tuple[Words, ...]
    metrics: tuple[Numbers, ...]


def compare_records(runs: Sequence[StoredRun]) -> RunComparison:
    """Compare runs by their records.

    Args:
        runs: at least two.
    """
    params = [{current_option_name(name): value for name, value in run.params.items()} for run in runs]
    config = _find_differences(params)
    named = sorted({name for run in runs for name in run.metrics}, key=_order)
    return RunComparison(
        runs=tuple(runs),
        config=config,
        same_options=len({name for one in params for name in one}) - len(config),
        environment=_find_differences([_environment(run) for run in runs]),
        metrics=tuple(Numbers(name, tuple(_finite(run.metrics.get(name)) for run in runs)) for name in named),
    )


def _find_differences(records: Sequence[Mapping[str, str]]) -> tuple[Words, ...]:
    names = sorted({name for record in records for name in record})
    every = (Words(name, tuple(record.get(name) for record in records)) for name in names)
    return tuple(words for words in every if len(set(words.values)) > 1)


def _environment(run: StoredRun) -> dict[str, str]:
    return {name.removeprefix("version."): value for name, value in run.tags.items() if name.startswith(_ENVIRONMENT)}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _order(name: str) -> tuple[int, str]:
    return next((place for place, start in enumerate(_FIRST) if name.startswith(start)), len(_FIRST)), name
