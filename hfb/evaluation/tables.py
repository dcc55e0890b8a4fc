"""The paper's tables from rows of results: a column per interval of blur rates, with confidence intervals."""

from collections.abc import Mapping, Sequence
from typing import Any

from pandas import DataFrame

from hfb.evaluation.cells import Cell, by_method, compare, make_cell, start_cases, start_cell, within
from hfb.evaluation.recordings import recording_cells
from hfb.evaluation.table_page import table_markdown

__all__ = ["Bins", "summarize", "table_markdown"]

Bins = Sequence[tuple[float, float]]


def summarize(
    rows: Any,
    set_name: str,
    count: int,
    skipped: Mapping[str, str],
    seed: int,
    bins: Bins,
    methods: Sequence[str] = (),
    pairs: Sequence[tuple[str, str]] | None = None,
) -> dict[str, Any]:
    """Return the content of summary.json: plain numbers, None where nothing is known.

    The result depends only on the arguments, not on the order of the rows.

    Args:
        rows: a mapping (or a row of a pandas table) per case and method, as in cases.parquet.
        set_name: name of the set of cases.
        count: number of cases that were asked for.
        skipped: unusable cases with their reasons.
        seed: seed of the set.
        bins: intervals of blur rates, ascending; a rate on an edge belongs to the upper one, the last is closed.
        methods: their order; methods that are not named follow by name, named ones without rows have n = 0.
        pairs: which methods to compare on the same cases; `best` against each other one when not given.

    Raises:
        InputError: a case stands twice in the rows of one method.
    """
    found = by_method(rows, methods)
    pairs = [("best", other) for other in found if other != "best"] if pairs is None else pairs
    binned = {name: [within(cases, bins, index) for index in range(len(bins))] for name, cases in found.items()}
    starts = start_cases(found.values())
    numbers = {number for cases in found.values() for number in cases["case"]}
    inside = {number for parts in binned.values() for part in parts for number in part["case"]}
    return {
        "set": set_name,
        "count": count,
        "skipped": len(skipped),
        "seed": seed,
        "cases": len(numbers),
        "outside_bins": len(numbers - inside),
        "start": {
            "all": start_cell(starts),
            "bins": _per_bin(bins, [start_cell(within(starts, bins, index)) for index in range(len(bins))]),
        },
        "methods": {
            name: {"all": make_cell(cases), "bins": _per_bin(bins, [make_cell(part) for part in binned[name]])}
            for name, cases in found.items()
        },
        **recording_cells(found),
        "comparisons": _comparisons(found, binned, pairs, bins),
        "skipped_reasons": dict(sorted(skipped.items())),
    }


def _per_bin(bins: Bins, cells: Sequence[Cell]) -> list[Cell]:
    return [{"blur": [float(low), float(high)], **cell} for (low, high), cell in zip(bins, cells, strict=True)]


def _comparisons(
    found: Mapping[str, DataFrame],
    binned: Mapping[str, Sequence[DataFrame]],
    pairs: Sequence[tuple[str, str]],
    bins: Bins,
) -> dict[str, Any]:
    """Compare those pairs that share a case with known errors."""
    compared = {}
    for one, other in pairs:
        if one not in found or other not in found:
            continue
        overall = compare(found[one], found[other])
        if overall["n"]:
            by_bin = [compare(*both) for both in zip(binned[one], binned[other], strict=True)]
            compared[f"{one} vs {other}"] = {"all": overall, "bins": _per_bin(bins, by_bin)}
    return compared
