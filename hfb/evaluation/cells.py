"""Rows of results, one per case and method, and the cell of a table that some of them make."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.evaluation.intervals import mean_ci95, ratio_ci95
from hfb.evaluation.reliability import COLUMNS as RELIABILITY_COLUMNS
from hfb.evaluation.reliability import reliability_cell
from hfb.typing import Array, Bool, Float, Int

Cell = dict[str, Any]
"""Plain numbers, None where nothing is known: ready for JSON."""

_MEANS = {
    "mpjpe_14_mm": "mpjpe_14_mm",
    "pa_mpjpe_14_mm": "pa_mpjpe_14_mm",
    "in_plane_mm": "in_plane_mm",
    "depth_mm": "depth_mm",
    "initial_in_plane_mm": "initial_in_plane_mm",
    "initial_depth_mm": "initial_depth_mm",
    "wrong_direction": "wrong_direction",
    "best_of_two_mpjpe_mm": "better_mpjpe_mm",
    "best_of_two_iou": "better_iou",
    "sharp_psnr_db": "sharp_psnr_db",
    "sharp_ssim": "sharp_ssim",
    "matte_iou": "matte_iou",
    "psnr_db": "psnr_db",
    "seconds_per_case": "seconds",
}
"""Entry of a cell -> column of the rows of which it is the mean over the cases that know it."""

_COLUMNS = (
    "blur_rate", "initial_mpjpe_mm", "mpjpe_mm", "initial_pa_mpjpe_mm", "pa_mpjpe_mm", "initial_iou", "iou",
    *_MEANS.values(), *RELIABILITY_COLUMNS,
)  # fmt: skip


_STARTS = {
    "blur_rate": "blur_rate",
    "mpjpe_mm": "initial_mpjpe_mm",
    "pa_mpjpe_mm": "initial_pa_mpjpe_mm",
    "iou": "initial_iou",
}
"""Column of the start, taken as a method -> column of any method's rows."""


@dataclass(frozen=True)
class MethodCases:
    """One method's rows as columns, sorted by the case's number.

    Attributes:
        values: per column, NaN where unknown.
        failed: the method gave no answer.
        joint_errors_mm: per joint, NaN where unknown.
    """

    numbers: Int[Array, "C"]
    values: Mapping[str, Float[Array, "C"]]
    failed: Bool[Array, "C"]
    joint_errors_mm: Float[Array, "C 24"]

    def chosen(self, mask: Bool[Array, "C"]) -> "MethodCases":
        """The cases where the mask is True."""
        values = {name: column[mask] for name, column in self.values.items()}
        return MethodCases(self.numbers[mask], values, self.failed[mask], self.joint_errors_mm[mask])

    def within(self, bins: Sequence[tuple[float, float]], index: int) -> "MethodCases":
        """The cases whose blur rate lies in a bin: its lower edge included, its upper one only in the last bin."""
        (low, high), rates = bins[index], self.values["blur_rate"]
        below = rates <= high if index == len(bins) - 1 else rates < high
        return self.chosen((rates >= low) & below)


def by_method(rows: Any, order: Collection[str] = ()) -> dict[str, MethodCases]:
    """Sort rows of results by method: those of `order` first, as named there, the others by name.

    Args:
        rows: mappings from column to value, or a pandas table of them.

    Raises:
        InputError: a case stands there twice for one method, or a row names no case or method.
    """
    records: Iterable[Mapping[str, Any]] = rows.to_dict("records") if hasattr(rows, "to_dict") else rows
    found: dict[str, dict[int, Mapping[str, Any]]] = {name: {} for name in order}
    for row in records:
        if row.get("case") is None or row.get("method") is None:
            raise InputError("a row of the results names no case or no method; run the benchmark into an empty folder")
        cases = found.setdefault(str(row["method"]), {})
        if cases.setdefault(int(row["case"]), row) is not row:
            raise InputError(f"case {row['case']} stands twice in the results of {row['method']}; remove one of them")
    names = [*order, *sorted(set(found) - set(order))]
    return {name: _columns([found[name][number] for number in sorted(found[name])]) for name in names}


def _columns(rows: Sequence[Mapping[str, Any]]) -> MethodCases:
    return MethodCases(
        np.array([row["case"] for row in rows], np.int64),
        {name: np.array([_number(row.get(name)) for row in rows], np.float64) for name in _COLUMNS},
        np.array([isinstance(row.get("failed"), str) for row in rows], bool),
        np.array([_joints(row.get("joint_errors_mm")) for row in rows], np.float64).reshape(-1, 24),
    )


def _number(value: Any) -> float:
    """What a table may hold for "unknown" (None, NaN, infinity) as NaN."""
    number = math.nan if value is None else float(value)
    return number if math.isfinite(number) else math.nan


def _joints(errors: Any) -> list[float]:
    known = [] if errors is None or np.ndim(errors) == 0 else [_number(error) for error in errors]
    return known if len(known) == 24 else [math.nan] * 24


def make_cell(cases: MethodCases) -> Cell:
    """One cell of a results table.

    ``n`` counts the answered cases; ``n_pose``, ``n_pa`` and ``n_iou`` those behind MPJPE, PA-MPJPE and IoU with their
    intervals. ``ratio`` is mean fitted / mean initial MPJPE over the cases that know both, as are these two means then.
    Shares of cases are strict: an equal error is neither
    better nor worse.
    """
    answered = cases.chosen(~cases.failed)
    initial, fitted, known = _pair(answered, "initial_mpjpe_mm", "mpjpe_mm")
    initial_pa, fitted_pa, known_pa = _pair(answered, "initial_pa_mpjpe_mm", "pa_mpjpe_mm")
    initial_iou, iou, _ = _pair(answered, "initial_iou", "iou")
    ratio, ratio_bounds = _ratio(fitted, initial) if known else (None, None)
    pa_ratio, pa_ratio_bounds = _ratio(fitted_pa, initial_pa) if known_pa else (None, None)
    return {
        "n": len(answered.numbers),
        "n_pose": len(fitted),
        "n_pa": len(fitted_pa),
        "n_iou": len(iou),
        "failed": int(cases.failed.sum()),
        "initial_mpjpe_mm": _mean(initial),
        "mpjpe_mm": _mean(fitted),
        "mpjpe_ci95": _interval(mean_ci95(fitted)),
        "ratio": ratio,
        "ratio_ci95": ratio_bounds,
        "initial_pa_mpjpe_mm": _mean(initial_pa),
        "pa_mpjpe_mm": _mean(fitted_pa),
        "pa_ratio": pa_ratio,
        "pa_ratio_ci95": pa_ratio_bounds,
        "initial_iou": _mean(initial_iou),
        "iou": _mean(iou),
        "iou_ci95": _interval(mean_ci95(iou)),
        "better_than_start": _mean((fitted < initial).astype(float)) if known else None,
        "worse_than_start": _mean((fitted > initial).astype(float)) if known else None,
        **{entry: _mean(_known(answered.values[column])) for entry, column in _MEANS.items()},
        **reliability_cell(answered.values),
    }


def start_cases(methods: Iterable[MethodCases]) -> MethodCases:
    """What every method started from, as if it were a method, over all cases that any method answered."""
    known: dict[int, dict[str, float]] = {}
    for cases in methods:
        for index in np.flatnonzero(~cases.failed):
            row = known.setdefault(int(cases.numbers[index]), {})
            for name, column in _STARTS.items():
                value = float(cases.values[column][index])
                if math.isfinite(value):
                    row.setdefault(name, value)
    return _columns([{"case": number, **known[number]} for number in sorted(known)])


def start_cell(starts: MethodCases) -> Cell:
    """The start's row of a table."""
    mpjpe, pa_mpjpe, iou = (_known(starts.values[name]) for name in ("mpjpe_mm", "pa_mpjpe_mm", "iou"))
    return {
        "n": len(starts.numbers),
        "n_pose": len(mpjpe),
        "n_iou": len(iou),
        "mpjpe_mm": _mean(mpjpe),
        "mpjpe_ci95": _interval(mean_ci95(mpjpe)),
        "pa_mpjpe_mm": _mean(pa_mpjpe),
        "iou": _mean(iou),
        "iou_ci95": _interval(mean_ci95(iou)),
    }


def is_start(cell: Mapping[str, Any]) -> bool:
    """Whether a method left the start's error as it was in every case: the static estimate itself."""
    return cell["ratio"] == 1 and cell["better_than_start"] == cell["worse_than_start"] == 0


def compare(one: MethodCases, other: MethodCases) -> Cell:
    """Two methods on the cases that both answered: what a claim "one is better" rests on.

    ``difference_mm`` is mean(one - other), negative where `one` is better; ``ratio`` mean one / mean other; ``better``
    the share of cases in which `one` has the lower MPJPE.
    """
    _, first, second = np.intersect1d(one.numbers, other.numbers, return_indices=True)
    ours, theirs = one.values["mpjpe_mm"][first], other.values["mpjpe_mm"][second]
    both = np.isfinite(ours) & np.isfinite(theirs) & ~one.failed[first] & ~other.failed[second]
    ours, theirs = ours[both], theirs[both]
    ratio, bounds = _ratio(ours, theirs)
    return {
        "n": len(ours),
        "difference_mm": _mean(ours - theirs),
        "difference_ci95": _interval(mean_ci95(ours - theirs)),
        "ratio": ratio,
        "ratio_ci95": bounds,
        "better": _mean((ours < theirs).astype(float)),
    }


def _pair(cases: MethodCases, before: str, after: str) -> tuple[Float[Array, "B"], Float[Array, "A"], bool]:
    """Two columns over the cases that know both, and True; where no case does, each over what it knows, and False."""
    first, second = cases.values[before], cases.values[after]
    both = np.isfinite(first) & np.isfinite(second)
    if both.any():
        return first[both], second[both], True
    return _known(first), _known(second), False


def _ratio(above: Float[Array, "C"], below: Float[Array, "C"]) -> tuple[float | None, list[float] | None]:
    """Ratio of the means and its 95 % interval."""
    if not len(below) or below.mean() <= 0:
        return None, None
    return float(above.mean() / below.mean()), _interval(ratio_ci95(above, below))


def _known(values: Float[Array, "C"]) -> Float[Array, "K"]:
    return values[np.isfinite(values)]


def _mean(values: Float[Array, "C"]) -> float | None:
    return float(values.mean()) if len(values) else None


def _interval(bounds: tuple[float, float] | None) -> list[float] | None:
    return None if bounds is None else list(bounds)
