"""Results of a benchmark from its rows: cases, summary, the paper's table, plots, the record."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hfb.config import Record
from hfb.datasets.blur_bins import SetName
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.benchmark.judge_case import JudgedHandle
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle, digest
from hfb.tasks.task import task
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.run_record import RunHandle

_SHOWN_RANKS = (0.05, 0.25, 0.5, 0.75, 0.95)


class ResultsHandle(Record):
    """Files of a benchmark by the name they are published under, and the summary's content."""

    cases: FileHandle
    summary: FileHandle
    table: FileHandle
    plots: tuple[FileHandle, ...]

    def files(self) -> dict[str, Path]:
        """Return name -> file."""
        return {one.path.name: one.path for one in (self.cases, self.summary, self.table, *self.plots)}

    def content(self) -> dict[str, Any]:
        """Return the content of summary.json."""
        return json.loads(self.summary.path.read_text())


@task("tables and plots")
def tabulate(
    *,
    judged: tuple[JudgedHandle, ...],
    set_name: SetName,
    frames: int,
    methods: tuple[str, ...],
    count: int,
    seed: int,
    skipped: dict[str, str],
    notes: tuple[str, ...],
    folder: Path,
) -> ResultsHandle:
    """Gather the rows of all cases and methods.

    Args:
        judged: results per case and method.
        set_name: the set, as on the command line.
        frames: blurred frames per case.
        methods: names, in their order.
        count: number of cases.
        seed: of the set.
        skipped: name -> reason, of cases left out.
        notes: sentences below the table.
        folder: where the files go.
    """
    import pandas

    from hfb.datasets.blur_bins import bins_of
    from hfb.evaluation.tables import summarize, table_markdown
    from hfb.report.plots.benchmark_plots import write_plots

    rows = [json.loads(one.path.read_text()) for one in judged]
    bins = bins_of(set_name, frames)
    summary = summarize(rows, set_name, count, skipped, seed, bins, methods)
    paths = [folder / name for name in ("cases.parquet", "summary.json", "table.md")]
    write_bytes_atomic(paths[0], pandas.DataFrame(rows).to_parquet(index=False))
    write_bytes_atomic(paths[1], json.dumps(summary, indent=2, allow_nan=False).encode() + b"\n")
    write_bytes_atomic(paths[2], table_markdown(summary, notes).encode())
    plots = write_plots(rows, summary, folder)
    cases, written, table = (FileHandle.of(path) for path in paths)
    return ResultsHandle(cases=cases, summary=written, table=table, plots=tuple(FileHandle.of(path) for path in plots))


@task("gallery")
def gallery(judged: tuple[JudgedHandle, ...], methods: tuple[str, ...], folder: Path) -> FileHandle:
    """Draw good, median and bad results of the first method with images, stacked.

    The cases are at fixed ranks of fitted over initial error, so that the choice is not ours.

    Args:
        judged: results per case and method.
        methods: names, in their order.
        folder: where the image goes.
    """
    from hfb.io.media.images.image_io import read_picture_srgb, write_png
    from hfb.report.images.strip import captioned, stacked

    rows = [(json.loads(one.path.read_text()), one) for one in judged]
    drawn = [(row, one) for row, one in rows if one.look is not None]
    shown = next((name for name in methods if any(row["method"] == name for row, _ in drawn)), None)
    seen = [(row, one) for row, one in drawn if row["method"] == shown]
    ranked = sorted(seen, key=lambda pair: _rank(pair[0]))
    cells = []
    for place in sorted({int(share * len(ranked)) for share in _SHOWN_RANKS} if ranked else ()):
        row, one = ranked[place]
        assert one.look is not None
        words = f"{shown}: case {row['case']}, blur rate {row['blur_rate']:.2f}"
        if row.get("mpjpe_mm") is not None and row.get("initial_mpjpe_mm") is not None:
            words += f": {row['initial_mpjpe_mm']:.0f} -> {row['mpjpe_mm']:.0f} mm (rank {place + 1} of {len(ranked)})"
        cells.append(captioned(read_picture_srgb(one.look.path), words))
    path = folder / "gallery.png"
    write_png(path, stacked(cells))
    return FileHandle.of(path)


@task("record in MLflow", cached=False)
def record_benchmark(
    *,
    name: str,
    params: dict[str, Any],
    methods: dict[str, Any],
    results: ResultsHandle,
    files: tuple[Path, ...],
    began_ms: int,
) -> RunHandle:
    """Record a parent run for the set and a child per method; metrics of blur intervals are steps, in their order.

    Args:
        name: of the run.
        params: the options that decide the figures.
        methods: options of every method.
        results: tables and plots.
        files: of the benchmark.
        began_ms: when the benchmark began, in milliseconds since 1970.

    Raises:
        tracking.StoreLost: the store cannot be reached.
    """
    summary = results.content()
    key = digest([params, methods, code_version()])
    tags = {"code": code_version(), "seed": str(summary["seed"])}
    with tracking.record_run(name, key, params, tags, began_ms=began_ms) as parent:
        if not parent.complete:
            counts = {"count": [summary["count"]], "skipped": [summary["skipped"]]}
            tracking.log_histories(parent, counts)
            tracking.log_files(parent, files)
        for method, options in methods.items():
            cells = summary["methods"].get(method)
            if cells is None:
                continue
            with tracking.record_run(
                f"{name}/{method}", digest([key, method]), {"method": options, **params}, tags, parent=parent
            ) as child:
                if not child.complete:
                    tracking.log_histories(child, _metrics("all", [cells["all"]]) | _metrics("bin", cells["bins"]))
        return RunHandle(run_id=parent.run_id, link=tracking.link(parent))


def _rank(row: Mapping[str, Any]) -> tuple[float, int]:
    """Return fitted over initial error, or for a method without poses the negative IoU, and the case's number."""
    if row.get("mpjpe_mm") is not None and row.get("initial_mpjpe_mm"):
        return row["mpjpe_mm"] / row["initial_mpjpe_mm"], row["case"]
    return -(row.get("iou") or 0.0), row["case"]


def _metrics(prefix: str, cells: Sequence[Mapping[str, Any]]) -> dict[str, list[float | None]]:
    """Return the numbers of some cells by name, a step per cell."""
    names = {name for cell in cells for name, value in cell.items() if isinstance(value, int | float)}
    return {f"{prefix}/{name}": [cell.get(name) for cell in cells] for name in sorted(names)}
