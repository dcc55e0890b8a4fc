"""Plots of a benchmark: error and IoU against blur rate, ratios to the start, errors per joint."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame

from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.evaluation.cells import by_method, is_start, known_joints, start_cases, within
from hfb.evaluation.intervals import mean_ci95
from hfb.evaluation.table_text import blur_label
from hfb.io.atomic import write_bytes_atomic
from hfb.report.plots.plot_style import FAINT_GRAY, GRAY, png, sheet, styles
from hfb.report.plots.reliability_plot import reliability
from hfb.typing import Array, Float

_POINTS_SHOWN = 0.98
"""Share of the cases within the error plot's vertical axis; the others are counted in a corner."""

_CHAINS = (
    "spine1",
    "spine2",
    "spine3",
    "neck",
    "head",
    "collar",
    "shoulder",
    "elbow",
    "wrist",
    "hand",
    "hip",
    "knee",
    "ankle",
    "foot",
)
"""Joints along the body, from the pelvis (whose error is zero by definition) outwards, left and right as one."""


def write_plots(rows: Any, summary: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write every plot that the rows have numbers for.

    Args:
        rows: a mapping (or a row of a pandas table) per case and method, as in `summarize`.
        summary: result of `summarize` for the same rows.
        folder: where the PNG files go.

    Returns:
        the files: error_by_blur.png, iou_by_blur.png, ratio_by_blur.png, error_by_joint.png, reliability.png, as far as
        there are.
    """
    methods = by_method(rows, tuple(summary["methods"]))
    pictures = {
        "error_by_blur.png": error_by_blur(methods, summary),
        "iou_by_blur.png": iou_by_blur(methods, summary),
        "ratio_by_blur.png": ratio_by_blur(summary),
        "error_by_joint.png": error_by_joint(methods, summary),
        "reliability.png": reliability(methods, summary),
    }
    written = []
    for name, picture in pictures.items():
        if picture is not None:
            write_bytes_atomic(folder / name, picture)
            written.append(folder / name)
    return written


def error_by_blur(methods: Mapping[str, DataFrame], summary: Mapping[str, Any]) -> bytes | None:
    """Plot MPJPE against blur rate: a line per method with its 95 % band, a faint point per case, the start in gray.

    Args:
        methods: method -> its rows of cases.parquet.
        summary: content of summary.json.
    """
    return _against_blur(methods, summary, "mpjpe_mm", "MPJPE [mm]")


def iou_by_blur(methods: Mapping[str, DataFrame], summary: Mapping[str, Any]) -> bytes | None:
    """Plot the IoU of silhouettes against blur rate, in the layout of `error_by_blur`.

    Args:
        methods: method -> its rows of cases.parquet.
        summary: content of summary.json.
    """
    return _against_blur(methods, summary, "iou", "silhouette IoU")


def ratio_by_blur(summary: Mapping[str, Any], paper: Sequence[float] | None = None) -> bytes | None:
    """Plot the ratio of MPJPE to the start's, per interval of blur rates and overall, with 95 % intervals.

    Args:
        summary: content of summary.json.
        paper: the paper's ratios per interval and, if it states one, overall; drawn in gray.
    """
    cells = {name: [*both["bins"], both["all"]] for name, both in _contenders(summary, "ratio").items()}
    if not cells:
        return None
    figure, axes = sheet()
    labels = [f"{blur_label(cell['blur'])}\nn {cell['n']}" for cell in summary["start"]["bins"]]
    labels.append(f"all\nn {summary['start']['all']['n']}")
    axes.axhline(1, color=GRAY, linewidth=1.2, linestyle="--")
    if paper is not None:
        last = len(labels) - 1
        axes.plot(range(last), paper[:last], color=GRAY, linewidth=2, marker="_", label="HfB in the paper")
        axes.plot(range(last, len(paper)), paper[last:], color=GRAY, linestyle="", marker="_", markersize=14, mew=2)
    for place, (name, row) in enumerate(cells.items()):
        style, shift = styles(summary)[name], 0.7 * ((place + 0.5) / len(cells) - 0.5)
        known = [(index, cell) for index, cell in enumerate(row) if cell["ratio"] is not None]
        heights = np.array([cell["ratio"] for _, cell in known])
        bounds = np.array([cell["ratio_ci95"] or (cell["ratio"], cell["ratio"]) for _, cell in known])
        reach = np.abs(bounds - heights[:, None]).T
        places = [index + shift for index, _ in known]
        axes.errorbar(
            places,
            heights,
            reach,
            fmt=style["marker"],
            color=style["color"],
            markersize=5,
            linewidth=1.6,
            label=f"{name} (n {row[-1]['n_pose']})",
        )
    axes.axvline(len(labels) - 1.5, color=FAINT_GRAY, linewidth=1)
    axes.set_xticks(range(len(labels)), labels)
    axes.set_xlabel(f"blur rate ({_of_set(summary)})")
    axes.set_ylabel("MPJPE, share of the start's")
    axes.margins(x=0.02, y=0.08)
    return png(figure, axes)


def error_by_joint(
    methods: Mapping[str, DataFrame], summary: Mapping[str, Any], merge_sides: bool = True
) -> bytes | None:
    """Plot the mean error of every joint, a bar per method with its 95 % interval.

    Args:
        methods: method -> its rows of cases.parquet.
        summary: content of summary.json.
        merge_sides: whether left and right share a bar; else all joints of the SMPL layout but the pelvis.
    """
    groups = _joint_groups(merge_sides)
    errors = {name: _per_group(cases, list(groups.values())) for name, cases in methods.items()}
    errors = {name: table for name, table in errors.items() if len(table)}
    if not errors:
        return None
    figure, axes = sheet()
    width = 0.84 / len(errors)
    for place, (name, table) in enumerate(errors.items()):
        means = table.mean(0)
        bounds = [mean_ci95(column) or (mean, mean) for column, mean in zip(table.T, means, strict=True)]
        lefts = np.arange(len(groups)) + (place - (len(errors) - 1) / 2) * width
        axes.bar(
            lefts,
            means,
            width * 0.92,
            color=styles(summary)[name]["color"],
            label=f"{f'start ({name})' if is_start(summary['methods'][name]['all']) else name} (n {len(table)})",
            yerr=np.abs(np.array(bounds).T - means),
            error_kw={"linewidth": 0.9, "ecolor": "#222222"},
        )
    slanted = {} if merge_sides else {"rotation": 45, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(groups)), list(groups), **slanted)
    axes.set_xlabel(_of_set(summary))
    axes.set_ylabel("mean joint error [mm]")
    axes.set_xlim(-0.6, len(groups) - 0.4)
    return png(figure, axes)


def _against_blur(
    methods: Mapping[str, DataFrame], summary: Mapping[str, Any], column: str, label: str
) -> bytes | None:
    drawn = {name: methods[name] for name in _contenders(summary, column)}
    starts = start_cases(methods.values())
    if not any(cases[column].notna().any() for cases in (starts, *drawn.values())):
        return None
    figure, axes = sheet()
    bins = [(float(low), float(high)) for low, high in (cell["blur"] for cell in summary["start"]["bins"])]
    gray = {"color": GRAY, "marker": None, "linestyle": "--"}
    for name, cases in {"start": starts, **drawn}.items():
        style = gray if name == "start" else styles(summary)[name]
        rates, heights = cases["blur_rate"].to_numpy(), cases[column].to_numpy()
        axes.scatter(rates, heights, s=7, color=style["color"], alpha=0.5 / (1 + len(drawn)), linewidths=0)
        middles, means, bands = _per_bin(cases, column, bins)
        axes.fill_between(middles, *bands.T, color=style["color"], alpha=0.5 / (2 + len(drawn)), linewidth=0)
        axes.plot(middles, means, linewidth=2, markersize=5, label=f"{name} (n {np.isfinite(heights).sum()})", **style)
    if column == "iou":
        axes.set_ylim(0, 1)
    else:
        _frame_most(axes, [cases[column].dropna().to_numpy() for cases in (starts, *drawn.values())])
    axes.set_xlabel(f"blur rate ({_of_set(summary)})")
    axes.set_ylabel(label)
    axes.set_xlim(left=0)
    return png(figure, axes)


def _per_bin(
    cases: DataFrame, column: str, bins: Sequence[tuple[float, float]]
) -> tuple[Float[Array, "P"], Float[Array, "P"], Float[Array, "P 2"]]:
    """Return mean blur rate, mean of a column and its 95 % interval, of every interval with a case."""
    points = []
    for index in range(len(bins)):
        part = within(cases, bins, index).dropna(subset=column)
        if len(part):
            values = part[column].to_numpy()
            low, high = mean_ci95(values) or (values.mean(), values.mean())
            points.append((part["blur_rate"].to_numpy().mean(), values.mean(), low, high))
    table = np.array(points, np.float64).reshape(-1, 4)
    return table[:, 0], table[:, 1], table[:, 2:]


def _frame_most(axes: Any, columns: Sequence[Float[Array, "_"]]) -> None:
    """Let the axis start at zero and hold nearly all points; annotate the number above it."""
    values = np.concatenate(columns)
    lines = max((float(np.max(line.get_ydata())) for line in axes.lines if len(line.get_ydata())), default=0.0)
    top = 1.05 * max(float(np.quantile(values, _POINTS_SHOWN)), lines)
    axes.set_ylim(0, top)
    above = int((values > top).sum())
    if above:
        place = {"transform": axes.transAxes, "ha": "right", "va": "top"}
        axes.text(0.995, 0.985, f"{above} points above", color=GRAY, backgroundcolor="white", **place)


def _contenders(summary: Mapping[str, Any], entry: str) -> dict[str, Any]:
    """Return methods with an entry that are not the start itself."""
    cells = summary["methods"].items()
    return {name: both for name, both in cells if both["all"][entry] is not None and not is_start(both["all"])}


def _of_set(summary: Mapping[str, Any]) -> str:
    return f"{summary['set']}, {summary['start']['all']['n']} cases"


def _joint_groups(merge_sides: bool) -> dict[str, list[int]]:
    """Return label -> joints of the SMPL layout."""
    bare = [name.removeprefix("left_").removeprefix("right_") for name in JOINT_NAMES]
    if merge_sides:
        return {name: [joint for joint in range(24) if bare[joint] == name] for name in _CHAINS}
    ordered = sorted(range(1, 24), key=lambda joint: (_CHAINS.index(bare[joint]), joint > MIRROR[joint]))
    return {JOINT_NAMES[joint].replace("_", " "): [joint] for joint in ordered}


def _per_group(cases: DataFrame, groups: Sequence[Sequence[int]]) -> Float[Array, "C G"]:
    """Return the mean error of each group of joints in every case with joint errors."""
    known = known_joints(cases)
    return np.stack([known[:, list(group)].mean(1) for group in groups], axis=1)
