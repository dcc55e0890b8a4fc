"""The paper's tables and figures as data: methods to run, the paper's numbers, and ours beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hfb.config import Record
from hfb.evaluation.experiment_files import experiment_file
from hfb.evaluation.table_text import UNKNOWN, blur_label, grid, interval, number
from hfb.io.toml_file import read_toml, to_record

Metric = Literal["mpjpe_mm", "pa_mpjpe_mm", "iou"]
Share = Annotated[float, Field(ge=0, le=1)]
Millimetres = Annotated[float, Field(gt=0)]

_TITLES: Mapping[Metric, str] = {"mpjpe_mm": "MPJPE [mm]", "pa_mpjpe_mm": "PA-MPJPE [mm]", "iou": "IoU"}
_RATIOS: Mapping[Metric, str] = {"mpjpe_mm": "ratio", "pa_mpjpe_mm": "pa_ratio"}
_DIGITS: Mapping[Metric, int] = {"mpjpe_mm": 1, "pa_mpjpe_mm": 1, "iou": 3}


class Column(Record):
    """A column of the paper's table: its heading, our interval of blur rates, its number of cases where stated."""

    label: str
    blur: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(gt=0)]]
    n: int | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _in_order(self) -> Column:
        if self.blur[0] >= self.blur[1]:
            raise ValueError("blur must be [lower, upper]")
        return self


class PaperRow(Record):
    """A row of the paper's table, and our methods that correspond to it."""

    name: str
    ours: tuple[str, ...] = ()
    mpjpe_mm: tuple[Millimetres, ...] | None = None
    pa_mpjpe_mm: tuple[Millimetres, ...] | None = None
    iou: tuple[Share, ...] | None = None

    def metrics(self) -> list[Metric]:
        """Return the metrics that the paper gives."""
        return [metric for metric in _TITLES if getattr(self, metric) is not None]


class Strips(Record):
    """The image strips beside a figure: number of cases, methods and blur rates."""

    methods: tuple[str, ...] = Field(min_length=1)
    cases: int = Field(ge=1)
    blur: tuple[float, float] | None = None
    shows: str


class Experiment(Record):
    """One table or figure of the paper, as a run of the benchmark.

    Attributes:
        place: its number in the paper, counted in the order of the source.
        label: its name there.
        count: cases of the paper (of ours, where it does not say).
        methods: methods that run by default; ``chains`` need networks or files that only a user can have.
        start: the paper's row that HfB starts from, where the table has one.
        differs: differences between the two experiments, a sentence each.
    """

    title: str
    place: str
    label: str
    set: Literal["bt-amass", "bc-cape", "b-aist"]
    frames: int = Field(ge=1, le=16)
    count: int = Field(ge=1)
    fill: Literal["paper", "even", "natural"] = "paper"
    methods: tuple[str, ...] = Field(min_length=1)
    chains: tuple[str, ...] = ()
    start: str | None = None
    differs: tuple[str, ...] = Field(min_length=1)
    columns: tuple[Column, ...] = ()
    rows: tuple[PaperRow, ...] = ()
    strips: tuple[Strips, ...] = ()

    @model_validator(mode="after")
    def _fits_together(self) -> Experiment:
        if bool(self.columns) != bool(self.rows) or not (self.rows or self.strips):
            raise ValueError("a table needs columns and rows, a figure strips")
        edges = [edge for column in self.columns for edge in column.blur]
        if edges != sorted(edges):
            raise ValueError("columns must ascend in blur rate and not overlap")
        for row in self.rows:
            if not row.metrics() or any(len(getattr(row, m)) != len(self.columns) for m in row.metrics()):
                raise ValueError(f"row {row.name} needs a number for each of the {len(self.columns)} columns")
        if self.start is not None and self.start not in [row.name for row in self.rows]:
            raise ValueError(f"start names no row: {self.start}")
        named = {name for row in self.rows for name in row.ours} | {n for strip in self.strips for n in strip.methods}
        unknown = sorted(named - {*self.methods, *self.chains})
        if unknown:
            raise ValueError(f"{unknown[0]} stands beside the paper but neither in methods nor in chains")
        return self

    def bins(self) -> list[tuple[float, float]]:
        """Return our intervals of blur rates, one per column."""
        return [column.blur for column in self.columns]

    def mean(self, values: Sequence[float]) -> float:
        """Return the mean of a paper's row: weighted by its cases, or plain where it gives none.

        Args:
            values: one per column.
        """
        weights = [column.n or 0 for column in self.columns]
        weights = weights if all(weights) else [1] * len(weights)
        return sum(w * value for w, value in zip(weights, values, strict=True)) / sum(weights)

    def start_row(self) -> PaperRow | None:
        """Return the row that HfB starts from."""
        return next((row for row in self.rows if row.name == self.start), None)


def find_experiment(name: str) -> Experiment:
    """Read one of the paper's tables or figures by its name, such as ``table1``.

    Args:
        name: name such as ``table1``.

    Raises:
        InputError: there is none of that name.
    """
    with resources.as_file(experiment_file(name)) as path:
        return load_experiment(path)


def load_experiment(path: Path) -> Experiment:
    """Read an experiment's file.

    Args:
        path: TOML file.

    Raises:
        InputError: the file is missing, no TOML, or its entries do not fit together.
    """
    return to_record(Experiment, read_toml(path), str(path))


def beside_paper(experiment: Experiment, summary: Mapping[str, Any]) -> str:
    """Return our numbers beside the paper's as markdown, with a line for every difference of the two experiments.

    Args:
        experiment: the paper's table or figure.
        summary: summary of a run of this experiment, by `summarize`; its intervals need not be the columns.
    """
    parts = [
        f"# {experiment.place}: {experiment.title}",
        f"The paper's `{experiment.label}` beside {summary['start']['all']['n']} cases of {summary['set']}"
        f" ({experiment.frames} frame{'s' * (experiment.frames > 1)} each, seed {summary['seed']}).",
    ]
    if experiment.rows:
        weighted = all(column.n for column in experiment.columns)
        parts.append(
            f"The paper's `all` is {'weighted by its cases' if weighted else 'the plain mean of its columns'}."
        )
        parts += ["## In short", _in_short(experiment, summary), *_against_start(experiment, summary)]
        parts += [
            f"## {_TITLES[metric]}: `{ours}` beside {row.name}\n\n{_pair(experiment, summary, row, ours, metric)}"
            for metric in _RATIOS
            for row, ours in _pairs(experiment, summary, metric)
        ]
        parts += [f"## All rows, {_TITLES[m]}\n\n{_all_rows(experiment, summary, m)}" for m in _metrics(experiment)]
    parts += [_strip(strip) for strip in experiment.strips]
    parts.append("## What differs\n\n" + "\n".join(f"- {sentence}" for sentence in experiment.differs))
    absent = [name for name in (*experiment.methods, *experiment.chains) if name not in summary["methods"]]
    if absent:
        parts.append(f"Not run here: {', '.join(absent)}.")
    return "\n\n".join(parts) + "\n"


def papers_ratios(experiment: Experiment, summary: Mapping[str, Any]) -> list[float] | None:
    """Return the paper's HfB MPJPE over its start's, per column and in all; None where the summary's bins differ.

    Args:
        experiment: the paper's table or figure.
        summary: summary of our run, by `summarize`.
    """
    rows = [row for row in experiment.rows if "best" in row.ours and row.mpjpe_mm and row.name != experiment.start]
    start = _start_values(experiment, "mpjpe_mm")
    if not rows or not start or [tuple(cell["blur"]) for cell in summary["start"]["bins"]] != experiment.bins():
        return None
    pairs = zip(_with_mean(experiment, rows[-1].mpjpe_mm or ()), _with_mean(experiment, start), strict=True)
    return [after / before for after, before in pairs]


def _pairs(experiment: Experiment, summary: Mapping[str, Any], metric: Metric) -> list[tuple[PaperRow, str]]:
    """Return the paper's rows but the start's, each with every corresponding method of ours that was run."""
    rows = [row for row in experiment.rows if metric in row.metrics() and row.name != experiment.start]
    return [(row, ours) for row in rows for ours in row.ours if ours in summary["methods"]]


def _in_short(experiment: Experiment, summary: Mapping[str, Any]) -> str:
    """Return all cases: a line per pair and metric."""
    header = ["metric", "the paper's", "its start", "its result", "its ratio"]
    header += ["ours", "n", "our start", "our result", "our ratio"]
    lines = []
    for metric in _metrics(experiment):
        digits, ratio = _DIGITS[metric], _RATIOS.get(metric, "")
        for row, ours in _pairs(experiment, summary, metric):
            value, cell = experiment.mean(getattr(row, metric)), summary["methods"][ours]["all"]
            starts = _start_values(experiment, metric) if row.metrics() != ["iou"] else None  # no body: no start
            first = experiment.mean(starts) if starts else None
            share = number(value / first, 3) if first and ratio else UNKNOWN
            line = [_TITLES[metric], row.name, number(first, digits), number(value, digits), share]
            line += [
                f"`{ours}`",
                str(cell["n"]),
                number(cell[f"initial_{metric}"] if starts or ratio else None, digits),
            ]
            line += [number(cell[metric], digits), _ratio_text(cell, metric)]
            lines.append(line)
    return grid(header, lines, left=2)


def _pair(experiment: Experiment, summary: Mapping[str, Any], row: PaperRow, ours: str, metric: Metric) -> str:
    """Return one method of ours beside one row of the paper: a line per column, and one for all."""
    digits, start = _DIGITS[metric], _start_values(experiment, metric)
    theirs, before = _with_mean(experiment, getattr(row, metric)), _with_mean(experiment, start) if start else None
    header = ["blur rate", "n, paper", *([str(experiment.start)] if before else []), row.name]
    header += [*(["ratio, paper"] if before else []), "n, ours", "our start", f"`{ours}`", "ratio, ours"]
    labels = [*(column.label for column in experiment.columns), "all"]
    lines = []
    for index, cell in enumerate(_cells(experiment, summary, ours)):
        line = [labels[index], _papers_counts(experiment)[index]]
        line += [number(before[index], digits)] if before else []
        line += [number(theirs[index], digits)]
        line += [number(theirs[index] / before[index], 3)] if before else []
        line += [str(cell.get("n", UNKNOWN)), number(cell.get(f"initial_{metric}"), digits)]
        line += [number(cell.get(metric), digits), _ratio_text(cell, metric)]
        lines.append(line)
    weighted = _in_the_papers_shares(experiment, summary, ours, metric)
    return grid(header, lines) + (f"\n\n{weighted}" if weighted else "")


def _ratio_text(cell: Mapping[str, Any], metric: Metric) -> str:
    """Return a cell's ratio to the start with its interval, as far as it has one of this metric."""
    ratio, count = _RATIOS.get(metric, ""), "n_pa" if metric == "pa_mpjpe_mm" else "n_pose"
    return number(cell.get(ratio), 3) + interval(cell.get(f"{ratio}_ci95"), 2, cell.get(count, 0))


def _papers_counts(experiment: Experiment) -> list[str]:
    """Return the paper's cases per column and in all, as far as it gives them."""
    counts = [column.n for column in experiment.columns]
    total = UNKNOWN if None in counts else str(sum(n for n in counts if n))
    return [*(UNKNOWN if n is None else str(n) for n in counts), total]


def _in_the_papers_shares(experiment: Experiment, summary: Mapping[str, Any], ours: str, metric: Metric) -> str:
    """Return our means weighted with the paper's share of cases in each column."""
    cells = _cells(experiment, summary, ours)[:-1]
    fitted = [cell[metric] for cell in cells if cell.get(metric) is not None]
    initial = [cell[f"initial_{metric}"] for cell in cells if cell.get(f"initial_{metric}") is not None]
    if len(fitted) < len(cells) or len(initial) < len(cells):
        return ""
    after, before = experiment.mean(fitted), experiment.mean(initial)
    shares = "the paper's cases per column" if experiment.columns[0].n else "equal weight for every column"
    return f"With {shares}: our start {before:.1f}, `{ours}` {after:.1f}, ratio {after / before:.3f}."


def _all_rows(experiment: Experiment, summary: Mapping[str, Any], metric: Metric) -> str:
    """Return the paper's table with our rows below the corresponding ones."""
    lines = [["n, paper", *_papers_counts(experiment)]]
    for row in experiment.rows:
        if metric in row.metrics():
            values = _with_mean(experiment, getattr(row, metric))
            lines.append([f"paper: {row.name}", *(number(value, _DIGITS[metric]) for value in values)])
            for ours in row.ours:
                if ours in summary["methods"]:
                    cells = _cells(experiment, summary, ours)
                    lines.append([f"ours: `{ours}`", *(number(cell.get(metric), _DIGITS[metric]) for cell in cells)])
    starts = [*_by_column(experiment, summary["start"]["bins"]), summary["start"]["all"]]
    lines.insert(1, ["n, ours", *(str(cell.get("n", UNKNOWN)) for cell in starts)])
    return grid(["", *(column.label for column in experiment.columns), "all"], lines)


def _against_start(experiment: Experiment, summary: Mapping[str, Any]) -> list[str]:
    """Return our comparisons with the methods that correspond to the paper's start row."""
    start = experiment.start_row()
    lines = []
    for reference in start.ours if start else ():
        for pair, both in summary.get("comparisons", {}).items():
            cell = both["all"]
            if pair.endswith(f" vs {reference}") and reference != "static":
                ratio = number(cell["ratio"], 3) + interval(cell["ratio_ci95"], 2, cell["n"])
                lines.append(f"On the same cases, {pair}: ratio of MPJPE {ratio}, n {cell['n']}.")
    return lines


def _cells(experiment: Experiment, summary: Mapping[str, Any], method: str) -> list[Mapping[str, Any]]:
    """Return a method's cell for every column, and for all."""
    cells = summary["methods"][method]
    return [*_by_column(experiment, cells["bins"]), cells["all"]]


def _by_column(experiment: Experiment, bins: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the cell of every column; empty where the summary has other intervals."""
    by_interval = {blur_label(cell["blur"]): cell for cell in bins}
    return [by_interval.get(blur_label(column.blur), {}) for column in experiment.columns]


def _start_values(experiment: Experiment, metric: Metric) -> tuple[float, ...] | None:
    """Return the start of the paper's HfB, where its table gives it."""
    row = experiment.start_row()
    return getattr(row, metric) if row else None


def _with_mean(experiment: Experiment, values: Sequence[float]) -> list[float]:
    return [*values, experiment.mean(values)]


def _metrics(experiment: Experiment) -> list[Metric]:
    return [metric for metric in _TITLES if any(metric in row.metrics() for row in experiment.rows)]


def _strip(strip: Strips) -> str:
    chosen = f" of blur rate {blur_label(strip.blur)}" if strip.blur else ""
    cases = "one case" if strip.cases == 1 else f"{strip.cases} cases"
    return (
        f"To set beside it: the strips of {', '.join(strip.methods)} for {cases}{chosen}. The paper's: {strip.shows}."
    )
