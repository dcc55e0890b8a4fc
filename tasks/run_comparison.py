"""Two recorded runs beside each other: where options, inputs, machines and figures differ."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from tasks.stored_runs import StoredRun

_ENVIRONMENT = ("version.", "code", "platform", "processor", "device")
_FIRST = ("eval/", "rerun/", "time/", "fit/", "loss/total")


class Pair(NamedTuple):
    """What two runs say under one name; None where one says nothing."""

    name: str
    one: str | None
    other: str | None


class NumberPair(NamedTuple):
    """A metric of two runs; None where one lacks it or it is no number."""

    name: str
    one: float | None
    other: float | None

    @property
    def difference(self) -> float | None:
        """The second run's minus the first's."""
        return None if self.one is None or self.other is None else self.other - self.one


@dataclass(frozen=True)
class RunComparison:
    """Two runs.

    Attributes:
        config: options, inputs and clip where they differ.
        same_options: how many do not.
        environment: versions, code and machine where they differ.
        metrics: every metric, errors and scores before losses.
    """

    one: StoredRun
    other: StoredRun
    config: tuple[Pair, ...]
    same_options: int
    environment: tuple[Pair, ...]
    metrics: tuple[NumberPair, ...]


def compare_records(one: StoredRun, other: StoredRun) -> RunComparison:
    """What the store says of two runs."""
    config = _differing(one.params, other.params)
    return RunComparison(
        one=one,
        other=other,
        config=config,
        same_options=len(one.params.keys() | other.params.keys()) - len(config),
        environment=_differing(_environment(one), _environment(other)),
        metrics=tuple(
            NumberPair(name, _finite(one.metrics.get(name)), _finite(other.metrics.get(name)))
            for name in sorted(one.metrics.keys() | other.metrics.keys(), key=_order)
        ),
    )


def _differing(one: Mapping[str, str], other: Mapping[str, str]) -> tuple[Pair, ...]:
    names = sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))
    return tuple(Pair(name, one.get(name), other.get(name)) for name in names)


def _environment(run: StoredRun) -> dict[str, str]:
    return {name.removeprefix("version."): value for name, value in run.tags.items() if name.startswith(_ENVIRONMENT)}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _order(name: str) -> tuple[int, str]:
    return next((place for place, start in enumerate(_FIRST) if name.startswith(start)), len(_FIRST)), name
