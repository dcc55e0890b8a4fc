"""The report of a benchmark: its page, and the comparison with the paper's numbers for an experiment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hfb.interop.writers.export_names import REPORT
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.benchmark.benchmark_results import ResultsHandle
from hfb.tasks.benchmark.judge_case import JudgedHandle
from hfb.tasks.core.environment import code_version, environment
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.task import task
from hfb.tasks.tracking.tracking import flatten

if TYPE_CHECKING:
    from hfb.evaluation.experiments import Experiment

BESIDE, BESIDE_PLOT = "beside_paper.md", "ratio_beside_paper.png"


class BesideHandle(FileHandle):
    """The paper's table beside ours, as Markdown; with a plot where the paper has numbers for one."""

    plot: FileHandle | None = None


@task("beside the paper")
def write_beside(experiment: Experiment, results: ResultsHandle, folder: Path) -> BesideHandle:
    """Write the table and plot that compare our results with the paper's.

    Args:
        experiment: of the paper.
        results: tables and plots.
        folder: where the files go.
    """
    from hfb.evaluation.experiments import beside_paper, papers_ratios
    from hfb.report.plots.benchmark_plots import ratio_by_blur

    summary = results.content()
    write_bytes_atomic(folder / BESIDE, beside_paper(experiment, summary).encode())
    ratios = papers_ratios(experiment, summary)
    drawn = ratio_by_blur(summary, ratios) if ratios is not None else None
    plot = None
    if drawn is not None:
        write_bytes_atomic(folder / BESIDE_PLOT, drawn)
        plot = FileHandle.of(folder / BESIDE_PLOT)
    return BesideHandle.of(folder / BESIDE, plot=plot)


@task("report")
def draw_benchmark_page(
    *,
    judged: tuple[JudgedHandle, ...],
    results: ResultsHandle,
    gallery: FileHandle,
    beside: BesideHandle | None,
    params: dict[str, Any],
    methods: dict[str, Any],
    folder: Path,
) -> FileHandle:
    """Write report.html of a benchmark; see `hfb.report.pages.benchmark_page`.

    Args:
        judged: results per case and method.
        results: tables and plots.
        gallery: image of results from good to bad.
        beside: comparison with the paper; None without an experiment.
        params: the options that decide the figures.
        methods: every method's options.
        folder: where the page goes.
    """
    from hfb.report.pages.benchmark_page import Answer, benchmark_page

    answers = [
        Answer(json.loads(one.path.read_bytes()), one.look.path if one.look is not None else None) for one in judged
    ]
    page = benchmark_page(
        results.content(),
        results.table.path.read_text(),
        _plots(results, beside),
        gallery.path,
        answers,
        _made_from(params, methods),
        beside.path.read_text() if beside is not None else None,
    )
    write_bytes_atomic(folder / REPORT, page.encode())
    return FileHandle.of(folder / REPORT)


def _plots(results: ResultsHandle, beside: BesideHandle | None) -> list[Path]:
    """Return all plots; the one with the paper's numbers replaces the one without."""
    plots = [one.path for one in results.plots]
    if beside is None or beside.plot is None:
        return plots
    return [beside.plot.path, *(path for path in plots if path.name != "ratio_by_blur.png")]


def _made_from(params: Mapping[str, Any], methods: Mapping[str, Any]) -> dict[str, str]:
    """Describe set, starts, mattes, methods, versions and machine."""
    told = {name: value for name, value in flatten(params).items() if value not in ("None", "")}
    told |= {f"method {name}": json.dumps(options, sort_keys=True) for name, options in methods.items()}
    return {**told, "code": code_version(), **environment()}
