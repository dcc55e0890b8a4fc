"""A benchmark as one self-contained page: figures, comparison with the paper, plots and every case."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hfb.evaluation.cells import is_start
from hfb.evaluation.table_page import is_oracle
from hfb.evaluation.table_text import UNKNOWN, interval, number
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.report.images.several_motions import png_bytes
from hfb.report.pages.markdown import markdown
from hfb.report.pages.page import page, small_picture

_PLOT_PX, _LOOK_PX = 860, 640
_MOST_LOOKS = 360
"""Largest number of images of some 25 KB; a larger benchmark shows those of evenly chosen cases."""

_PLOTS = {
    "ratio_by_blur.png": "MPJPE over the start's, by blur rate (95 % intervals from 6 cases on); below 1 is better",
    "ratio_beside_paper.png": "MPJPE over the start's: ours (95 % intervals from 6 cases on), the paper's over its own",
    "error_by_blur.png": "MPJPE by blur rate, with 95 % bands from 6 cases on; a point is a case",
    "iou_by_blur.png": "IoU of silhouettes by blur rate",
    "error_by_joint.png": "Mean error of every joint, with 95 % intervals from 6 cases on",
    "reliability.png": "How sure a method said it was, and how often that was right",
}


@dataclass(frozen=True)
class Answer:
    """A method's result on a case.

    Attributes:
        row: as in cases.parquet.
        look: image of the input and of predicted and true sub-frames.
    """

    row: Mapping[str, Any]
    look: Path | None = None


def benchmark_page(
    summary: Mapping[str, Any],
    tables: str,
    plots: Sequence[Path],
    gallery: Path | None,
    answers: Sequence[Answer],
    made_from: Mapping[str, str],
    beside_paper: str | None = None,
) -> str:
    """Render the page.

    Args:
        summary: the content of summary.json.
        tables: the content of table.md.
        plots: files; those without a caption here are left out.
        gallery: image file of results from good to bad.
        answers: one per case and method.
        made_from: the options that decide the figures, by name.
        beside_paper: the content of beside_paper.md; None without an experiment.
    """
    title = f"{summary['set']}: {summary['start']['all']['n']} cases, {len(summary['methods'])} methods"
    if beside_paper is not None:
        heading = beside_paper.lstrip().split("\n", 1)[0].removeprefix("# ")
        title = f"{heading}: ours beside the paper"
    shown = sorted((path for path in plots if path.name in _PLOTS), key=lambda one: list(_PLOTS).index(one.name))
    methods = list(dict.fromkeys(str(answer.row["method"]) for answer in answers))
    return page(
        "benchmark.html",
        title,
        figures=_in_short(summary),
        beside_paper=None if beside_paper is None else markdown(beside_paper),
        tables=markdown(tables),
        plots=[(_plot(path), _PLOTS[path.name]) for path in shown],
        gallery=None if gallery is None else small_picture(gallery, _PLOT_PX),
        methods=methods,
        cases=_cases(answers, methods),
        skipped=sorted((summary.get("skipped_reasons") or {}).items()),
        made_from=made_from.items(),
    )


def _in_short(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the main figures, each with its description."""
    cells = {name: both["all"] for name, both in summary["methods"].items() if not is_start(both["all"])}
    found = []
    for name, cell in cells.items():
        ratio = cell["ratio"]
        if ratio is not None:
            between = (
                interval(cell["ratio_ci95"], 2, cell["n_pose"]) or f" (n {cell['n_pose']}, too few for an interval)"
            )
            words = f"{name}{' (an oracle)' if is_oracle(name) else ''}: MPJPE over the start's{between}"
            found.append((f"{ratio:.2f}", words))
    start = summary["start"]["all"]
    return [*found, (f"{number(start['mpjpe_mm'], 0)} mm", "MPJPE of the start")]


def _plot(path: Path) -> bytes:
    """Return a plot that keeps a readable size and scrolls where the page is narrower."""
    pixels = read_picture_srgb(path)
    height = max(1, round(pixels.shape[0] * _PLOT_PX / pixels.shape[1]))
    small = cv2.resize(pixels, (_PLOT_PX, height), interpolation=cv2.INTER_AREA)
    return png_bytes(small)


def _cases(answers: Sequence[Answer], methods: Sequence[str]) -> list[dict[str, Any]]:
    """Return the table's row and the images of every case."""
    by_case: dict[int, list[Answer]] = {}
    for answer in answers:
        by_case.setdefault(int(answer.row["case"]), []).append(answer)
    drawn = _drawn(by_case)
    cases = []
    for case in sorted(by_case):
        row, told = by_case[case][0].row, {str(one.row["method"]): one.row for one in by_case[case]}
        cases.append(
            {
                "number": case,
                "blur_rate": f"{row['blur_rate']:.2f}",
                "start": number(row.get("initial_mpjpe_mm"), 0),
                "figures": [_figure(told.get(method)) for method in methods],
                "source": row.get("source"),
                "looks": [_look(one) for one in by_case[case] if one.look is not None] if case in drawn else [],
            }
        )
    return cases


def _drawn(by_case: Mapping[int, Sequence[Answer]]) -> set[int]:
    """Return the cases whose images are shown: all, or evenly chosen ones."""
    seen = [case for case in sorted(by_case) if any(one.look is not None for one in by_case[case])]
    each = max((sum(one.look is not None for one in by_case[case]) for case in seen), default=1)
    places = np.unique(np.linspace(0, len(seen) - 1, min(len(seen), max(1, _MOST_LOOKS // each))).round().astype(int))
    return {seen[int(place)] for place in places} if seen else set()


def _figure(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return UNKNOWN
    if row.get("failed"):
        return "failed"
    iou = "" if row.get("iou") is None else f" ({row['iou']:.2f})"
    return number(row.get("mpjpe_mm"), 0) + iou


def _look(answer: Answer) -> tuple[bytes, str]:
    assert answer.look is not None
    row = answer.row
    words = str(row["method"])
    if row.get("mpjpe_mm") is not None and row.get("initial_mpjpe_mm") is not None:
        words += f": {row['initial_mpjpe_mm']:.0f} → {row['mpjpe_mm']:.0f} mm"
    return small_picture(answer.look, _LOOK_PX), words
