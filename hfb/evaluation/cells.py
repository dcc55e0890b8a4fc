"""Rows of results, one per case and method, and their aggregation to a table's cell."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from pandas import DataFrame, Series, concat

from hfb.errors import InputError
from hfb.evaluation.intervals import mean_ci95, ratio_ci95
from hfb.evaluation.reliability import COLUMNS as RELIABILITY_COLUMNS
from hfb.evaluation.reliability import reliability_cell
from hfb.typing import Array, Float

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
    "in_plane_px": "in_plane_px",
    "ray_depth_mm": "ray_depth_mm",
    "lean_deg": "lean_deg",
    "front_wrong": "front_wrong",
    "spin_deg": "spin_deg",
    "motion_mm": "motion_mm",
    "still_motion_mm": "still_motion_mm",
    "psnr_db": "psnr_db",
    "seconds_per_case": "seconds",
}
"""Entry of a cell -> column of the rows of which it is the mean over the cases that know it."""

_COLUMNS = (
    "blur_rate",
    "initial_mpjpe_mm",
    "mpjpe_mm",
    "initial_pa_mpjpe_mm",
    "pa_mpjpe_mm",
    "initial_iou",
    "iou",
    *_MEANS.values(),
    "better_motion_mm",
    "path_mm",
    "true_path_mm",
    *RELIABILITY_COLUMNS,
)


RECORDED = ("recording", "source", "average")
"""Columns with the source of a case of real video: its folder, its video, K."""

_STARTS = {
    "blur_rate": "blur_rate",
    "mpjpe_mm": "initial_mpjpe_mm",
    "pa_mpjpe_mm": "initial_pa_mpjpe_mm",
    "iou": "initial_iou",
}
"""Column of the start, taken as a method -> column of any method's rows."""


def by_method(rows: Any, order: Collection[str] = ()) -> dict[str, DataFrame]:
    """Sort rows of results by method: those of `order` first, as named there, the others by name.

    Args:
        rows: mappings from column to value, or a pandas table of them.
        order: methods, also such as have no rows.

    Returns:
        per method a table with a row per case, in the order of ``case``: numbers (NaN where unknown or infinite),
        ``failed`` (the method gave no answer) and ``joint_errors_mm`` (NaN for an array that is not known).

    Raises:
        InputError: a case stands there twice for one method, or a row names no case or method.
    """
    table = DataFrame(rows).reindex(columns=["case", "method", "failed", "joint_errors_mm", *RECORDED, *_COLUMNS])
    if table[["case", "method"]].isna().to_numpy().any():
        raise InputError("a row of the results names no case or no method; run the benchmark into an empty folder")
    table = table.astype({"case": int, "method": str})
    for twice in table[table.duplicated(["case", "method"])].itertuples():
        raise InputError(f"case {twice.case} stands twice in the results of {twice.method}; remove one of them")
    table["failed"] = np.array([isinstance(reason, str) for reason in table["failed"]], bool)
    table[[*_COLUMNS]] = table[[*_COLUMNS]].astype(float).replace([math.inf, -math.inf], math.nan)
    table = table.sort_values("case", ignore_index=True)
    names = dict.fromkeys([*order, *sorted(set(table["method"]))])
    return {name: table[table["method"] == name] for name in names}


def within(cases: DataFrame, bins: Sequence[tuple[float, float]], index: int) -> DataFrame:
    """Return the cases whose blur rate lies in a bin: its lower edge included, its upper one only in the last bin.

    Args:
        cases: rows of cases.parquet.
        bins: intervals of blur rates, ascending.
        index: number of the bin.
    """
    return cases[cases["blur_rate"].between(*bins[index], inclusive="both" if index == len(bins) - 1 else "left")]


def known_joints(cases: DataFrame) -> Float[Array, "C 24"]:
    """Return the errors per joint [mm] of the cases that know all of them.

    Args:
        cases: rows of cases.parquet.
    """
    tables = [np.asarray(errors, float) for errors in cases["joint_errors_mm"] if np.ndim(errors) == 1]
    return np.array([one for one in tables if len(one) == 24 and np.isfinite(one).all()]).reshape(-1, 24)


def make_cell(cases: DataFrame) -> Cell:
    """Return one cell of a results table.

    ``n`` counts the answered cases; ``n_pose``, ``n_pa`` and ``n_iou`` those behind MPJPE, PA-MPJPE and IoU with their
    intervals. ``ratio`` is mean fitted / mean initial MPJPE over the cases that know both, as are these two means then.
    Shares of cases are strict: an equal error is neither better nor worse. ``motion_ratio`` is mean motion error over
    that of a still body, ``better_motion_ratio`` in the better direction of time, ``path_share`` mean path length over
    the true one.

    Args:
        cases: rows of one method.
    """
    answered = cases[~cases["failed"]]
    initial, fitted, known = _pair(answered, "initial_mpjpe_mm", "mpjpe_mm")
    initial_pa, fitted_pa, known_pa = _pair(answered, "initial_pa_mpjpe_mm", "pa_mpjpe_mm")
    initial_iou, iou, _ = _pair(answered, "initial_iou", "iou")
    ratio, ratio_bounds = _ratio(fitted, initial) if known else (None, None)
    pa_ratio, pa_ratio_bounds = _ratio(fitted_pa, initial_pa) if known_pa else (None, None)
    motion_ratio, motion_bounds = _ratio_of(answered, "motion_mm", "still_motion_mm")
    return {
        "n": len(answered),
        "n_pose": len(fitted),
        "n_pa": len(fitted_pa),
        "n_iou": len(iou),
        "failed": int(cases["failed"].sum()),
        "initial_mpjpe_mm": _mean(initial),
        "mpjpe_mm": _mean(fitted),
        "mpjpe_ci95": _interval(mean_ci95(fitted)),
        "ratio": ratio,
        "ratio_ci95": ratio_bounds,
        "initial_pa_mpjpe_mm": _mean(initial_pa),
        "pa_mpjpe_mm": _mean(fitted_pa),
        "pa_mpjpe_ci95": _interval(mean_ci95(fitted_pa)),
        "pa_ratio": pa_ratio,
        "pa_ratio_ci95": pa_ratio_bounds,
        "initial_iou": _mean(initial_iou),
        "iou": _mean(iou),
        "iou_ci95": _interval(mean_ci95(iou)),
        "better_than_start": _mean((fitted < initial).astype(float)) if known else None,
        "worse_than_start": _mean((fitted > initial).astype(float)) if known else None,
        "n_motion": int(answered[["motion_mm", "still_motion_mm"]].notna().all(axis=1).sum()),
        "motion_ratio": motion_ratio,
        "motion_ratio_ci95": motion_bounds,
        "better_motion_ratio": _ratio_of(answered, "better_motion_mm", "still_motion_mm")[0],
        "path_share": _ratio_of(answered, "path_mm", "true_path_mm")[0],
        **{entry: _mean(_known(answered[column])) for entry, column in _MEANS.items()},
        **reliability_cell(answered),
    }


def start_cases(methods: Iterable[DataFrame]) -> DataFrame:
    """Return the start's errors as the rows of a method, over all cases that any method answered.

    Args:
        methods: rows of each method.
    """
    every = concat([DataFrame(columns=["case", "failed", *_STARTS.values()]), *methods])
    answered = every[~every["failed"].astype(bool)]
    starts = answered.groupby("case")[[*_STARTS.values()]].first()  # of each column the first that is known
    return starts.astype(float).set_axis([*_STARTS], axis=1).reset_index()


def start_cell(starts: DataFrame) -> Cell:
    """Return the start's row of a table.

    Args:
        starts: by `start_cases`.
    """
    mpjpe, pa_mpjpe, iou = (_known(starts[name]) for name in ("mpjpe_mm", "pa_mpjpe_mm", "iou"))
    return {
        "n": len(starts),
        "n_pose": len(mpjpe),
        "n_pa": len(pa_mpjpe),
        "n_iou": len(iou),
        "mpjpe_mm": _mean(mpjpe),
        "mpjpe_ci95": _interval(mean_ci95(mpjpe)),
        "pa_mpjpe_mm": _mean(pa_mpjpe),
        "pa_mpjpe_ci95": _interval(mean_ci95(pa_mpjpe)),
        "iou": _mean(iou),
        "iou_ci95": _interval(mean_ci95(iou)),
    }


def is_start(cell: Mapping[str, Any]) -> bool:
    """Return whether a method left the start's error as it was in every case: the static estimate itself.

    Args:
        cell: cell of the method, by `make_cell`.
    """
    return cell["ratio"] == 1 and cell["better_than_start"] == cell["worse_than_start"] == 0


def compare(one: DataFrame, other: DataFrame) -> Cell:
    """Compare two methods on the cases that both answered.

    ``difference_mm`` is mean(one - other), negative where `one` is better; ``ratio`` mean one / mean other; ``better``
    the share of cases in which `one` has the lower MPJPE.

    Args:
        one: rows of the first method.
        other: rows of the second one.
    """
    first, second = (cases.loc[~cases["failed"], ["case", "mpjpe_mm"]].dropna() for cases in (one, other))
    ours, theirs = first.merge(second, on="case", sort=True)[["mpjpe_mm_x", "mpjpe_mm_y"]].to_numpy().T
    ratio, bounds = _ratio(ours, theirs)
    return {
        "n": len(ours),
        "difference_mm": _mean(ours - theirs),
        "difference_ci95": _interval(mean_ci95(ours - theirs)),
        "ratio": ratio,
        "ratio_ci95": bounds,
        "better": _mean((ours < theirs).astype(float)),
    }


def _pair(cases: DataFrame, before: str, after: str) -> tuple[Float[Array, "B"], Float[Array, "A"], bool]:
    """Return two columns over the cases that know both, and True; without any, each over its known cases, and False."""
    first, second = cases[before].to_numpy(), cases[after].to_numpy()
    both = np.isfinite(first) & np.isfinite(second)
    if both.any():
        return first[both], second[both], True
    return _known(cases[before]), _known(cases[after]), False


def _ratio(above: Float[Array, "C"], below: Float[Array, "C"]) -> tuple[float | None, list[float] | None]:
    """Return ratio of the means and its 95 % interval."""
    if not len(below) or below.mean() <= 0:
        return None, None
    return float(above.mean() / below.mean()), _interval(ratio_ci95(above, below))


def _ratio_of(cases: DataFrame, above: str, below: str) -> tuple[float | None, list[float] | None]:
    """Return the ratio of the means of two columns over the cases that know both, and its 95 % interval."""
    first, second, both = _pair(cases, above, below)
    return _ratio(first, second) if both else (None, None)


def _known(values: Series) -> Float[Array, "K"]:
    numbers = values.to_numpy()
    return numbers[np.isfinite(numbers)]


def _mean(values: Float[Array, "C"]) -> float | None:
    return float(values.mean()) if len(values) else None


def _interval(bounds: tuple[float, float] | None) -> list[float] | None:
    return None if bounds is None else list(bounds)
