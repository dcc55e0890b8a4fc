"""Results of real video by recording and K, and by camera."""

from collections.abc import Mapping
from typing import Any

from pandas import DataFrame

from hfb.evaluation.cells import Cell, make_cell, start_cases, start_cell


def recording_cells(found: Mapping[str, DataFrame]) -> dict[str, Any]:
    """Return the entries ``recordings`` and ``cameras`` of summary.json, or nothing where no row names a recording.

    ``recordings`` has an entry per recording and K; ``average`` is None in the one over all K, ``recording`` in the
    one over all recordings. ``cameras`` has one per video. Each entry has the start's cell and one per method.

    Args:
        found: per method its rows (`hfb.evaluation.cells.by_method`).
    """
    recordings, cameras, averages = (_values(found, column) for column in ("recording", "source", "average"))
    if not recordings:
        return {}
    return {
        "recordings": [
            {"recording": recording, "average": None if average is None else int(average)}
            | _cells({name: _where(cases, recording=recording, average=average) for name, cases in found.items()})
            for recording in [*recordings, None]
            for average in [*averages, None]
        ],
        "cameras": [
            {"camera": camera} | _cells({name: _where(cases, source=camera) for name, cases in found.items()})
            for camera in cameras
        ],
    }


def _values(found: Mapping[str, DataFrame], column: str) -> list[Any]:
    """Return the sorted values of a column, of rows that name a recording."""
    return sorted({one for cases in found.values() for one in cases[cases["recording"].notna()][column].dropna()})


def _where(cases: DataFrame, **wanted: Any) -> DataFrame:
    for column, value in wanted.items():
        if value is not None:
            cases = cases[cases[column] == value]
    return cases


def _cells(methods: Mapping[str, DataFrame]) -> Cell:
    return {
        "start": start_cell(start_cases(methods.values())),
        "methods": {name: make_cell(cases) for name, cases in methods.items()},
    }
