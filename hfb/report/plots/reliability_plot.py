"""The reliability plot: stated probabilities against observed frequencies, of joint radii and of directions."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pandas import DataFrame

from hfb.evaluation.intervals import mean_ci95
from hfb.evaluation.reliability import LEVELS, WITHIN, direction_groups
from hfb.report.plots.plot_style import GRAY, png, sheet, styles

_SMALLEST_MARK, _MARK_PER_CASE = 12.0, 5.0


def reliability(methods: Mapping[str, DataFrame], summary: Mapping[str, Any]) -> bytes | None:
    """Plot stated against observed frequencies in two panels; None where no method states any.

    Left: the share of joints within the radius for each probability, with its 95 % interval over the cases. Right:
    directions, a mark per group of stated probabilities, its area growing with the number of cases.

    Args:
        methods: method -> its rows of cases.parquet.
        summary: content of summary.json.
    """
    sure = {name: cases for name, cases in methods.items() if cases["radius_mm"].notna().any()}
    directed = {name: cases for name, cases in methods.items() if direction_groups(cases)}
    if not sure and not directed:
        return None
    figure, (joints, directions) = sheet(panels=2)
    for axes in (joints, directions):
        axes.plot([0, 1], [0, 1], color=GRAY, linewidth=1.2, linestyle="--")
        axes.set_xlim(0, 1)
        axes.set_ylim(-0.02, 1.04)
        axes.set_aspect("equal")
    for name, cases in {**sure, **directed}.items():
        style = styles(summary)[name]
        count = cases["radius_mm"].count()
        joints.plot(
            [], [], linewidth=2, markersize=6, label=f"{name} (n {count})", **style
        )  # in the legend, whichever panel it is in
        if name in sure:
            _draw_joints(joints, cases, style)
        if name in directed:
            _draw_directions(directions, cases, style)
    joints.set_xlabel("said: joint within its radius")
    joints.set_ylabel("happened: share of joints")
    directions.set_xlabel("said: direction of time right")
    directions.set_ylabel("happened: share of cases")
    return png(figure, joints, directions)


def _draw_joints(axes: Any, cases: DataFrame, style: Mapping[str, Any]) -> None:
    shares = [cases[name].dropna().to_numpy() for name in WITHIN]
    means = np.array([share.mean() for share in shares])
    bounds = np.array([mean_ci95(s) or (m, m) for s, m in zip(shares, means, strict=True)])
    axes.fill_between(LEVELS, *bounds.T, color=style["color"], alpha=0.2, linewidth=0)
    axes.plot(LEVELS, means, linewidth=2, markersize=6, **style)


def _draw_directions(axes: Any, cases: DataFrame, style: Mapping[str, Any]) -> None:
    for group in direction_groups(cases):
        size = _SMALLEST_MARK + _MARK_PER_CASE * group["n"]
        axes.scatter(group["said"], group["right"], s=size, color=style["color"], marker=style["marker"], alpha=0.8)
        axes.annotate(
            f"n {group['n']}", (group["said"], group["right"]), (6, 4), textcoords="offset points", color=GRAY
        )
