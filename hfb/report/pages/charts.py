"""Line charts of a result's page: losses over iterations, limb speeds over time, scores per frame."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hfb.motion.sampled import SampledMotion
from hfb.report.pages.limb_speed import LIMB_ENDS, instant_speeds
from hfb.report.plots.plot_style import GRAY, png, sheet
from hfb.typing import Array

_INCHES = (7.0, 3.6)
_SMALLEST = 1e-30  # what a logarithmic axis shows
_SINGLE_FRAMES = 12  # beyond, the speeds within an exposure are too fine to be seen
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D31", "#7F7F7F")


def loss_chart(terms: Mapping[str, Sequence[float | None]], stages: Sequence[int]) -> bytes:
    """Plot every term of the objective and the weighted sum over the iterations, as PNG.

    Args:
        terms: unweighted, by name; ``total`` is the weighted sum.
        stages: iterations of every stage; where one ends, the image resolution rises and the sum starts anew.
    """
    figure, axes = sheet(inches=_INCHES)
    others = [name for name in terms if name != "total"]
    for name, colour in zip(others, _COLOURS * (1 + len(others) // len(_COLOURS)), strict=False):
        _line(axes, terms[name], colour, name, 1.1)
    if "total" in terms:
        _line(axes, terms["total"], "black", "weighted sum", 2.0)
    for end in np.cumsum(stages)[:-1]:
        axes.axvline(end, color=GRAY, linewidth=0.8, linestyle=":")
    axes.set_yscale("log")
    axes.set_xlabel("iteration")
    return png(figure, axes, columns=4)


def window_chart(totals: Sequence[Sequence[float]]) -> bytes:
    """Plot the median and the 10th to 90th percentile of all windows' weighted sums over the iterations, as PNG.

    Args:
        totals: per window, a value per iteration.
    """
    longest = max(len(one) for one in totals)
    table = np.full((len(totals), longest), np.nan)
    for row, one in zip(table, totals, strict=True):
        row[: len(one)] = one
    low, middle, high = np.nanpercentile(table, [10, 50, 90], axis=0)
    figure, axes = sheet(inches=_INCHES)
    across = np.arange(longest)
    axes.fill_between(across, low, high, color=_COLOURS[0], alpha=0.2, linewidth=0, label="80 % of the windows")
    axes.plot(across, middle, color=_COLOURS[0], label="the median window")
    axes.set_yscale("log")
    axes.set_xlabel("iteration")
    axes.set_ylabel("weighted sum")
    return png(figure, axes, columns=4)


def speed_chart(motion: SampledMotion) -> bytes:
    """Plot limb speeds over time, interrupted while the shutter is closed, as PNG; of a long clip each exposure's mean.

    Args:
        motion: fitted motion.
    """
    times, speeds, frames = instant_speeds(motion)
    short = float(times[-1]) < 1
    if len(np.unique(frames)) > _SINGLE_FRAMES:
        rows = np.split(np.arange(len(frames)), np.flatnonzero(np.diff(frames)) + 1)
        times, speeds = np.array([times[one].mean() for one in rows]), np.array([speeds[one].mean(0) for one in rows])
        frames = np.cumsum(np.diff(np.unique(frames), prepend=frames[0]) > 1).astype(np.float64)
    figure, axes = sheet(inches=_INCHES)
    breaks = np.flatnonzero(np.diff(frames)) + 1
    across = np.insert(times, breaks, np.nan) * (1000 if short else 1)
    for at, (limb, colour) in enumerate(zip(LIMB_ENDS, _COLOURS, strict=False)):
        dashes = "--" if limb == "whole body" else "-"
        lines = np.insert(speeds[:, at], breaks, np.nan)
        axes.plot(across, lines, color=colour, label=limb, linewidth=1.6, linestyle=dashes)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("time since the shutter first opened [ms]" if short else "time since the shutter first opened [s]")
    axes.set_ylabel("speed [m/s]")
    return png(figure, axes, columns=4)


def frames_chart(values: Mapping[int, float], label: str) -> bytes:
    """Plot one score of every frame of a clip, as PNG.

    Args:
        values: frame number -> score.
        label: name of the score.
    """
    figure, axes = sheet(inches=_INCHES)
    numbers = np.array(sorted(values))
    axes.plot(numbers, [values[int(number)] for number in numbers], color=_COLOURS[0], linewidth=1.2, label=label)
    axes.set_xlabel("frame")
    return png(figure, axes, columns=4)


def _line(axes: Any, values: Sequence[float | None], colour: str, label: str, width: float) -> None:
    """Plot a curve on a logarithmic axis without values that are not positive."""
    known: Array = np.array([np.nan if value is None else value for value in values], np.float64)
    if (known > _SMALLEST).any():
        axes.plot(np.where(known > _SMALLEST, known, np.nan), color=colour, label=label, linewidth=width)
