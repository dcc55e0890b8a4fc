"""A benchmark as one page that opens anywhere: what came out, beside the paper where asked, plots, and every case."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hfb.evaluation.cells import is_start
from hfb.evaluation.table_page import UNKNOWN, interval, is_oracle, number
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.report.markdown import markdown
from hfb.report.page import Html, element, folded, joined, page, picture, section, small_picture, table

_PLOT_PX, _LOOK_PX = 860, 640
_MOST_LOOKS = 360
"""So many pictures of some 25 KB are shown; of a larger benchmark those of cases spread over the whole range."""

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
    """A method's answer to a case: its row (as in cases.parquet); the picture of what was seen, claimed and true."""

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
    """The page.

    Args:
        summary: the content of summary.json. tables: the content of table.md.
        gallery: answers from good to bad.
        made_from: what decides the figures, in words.
        beside_paper: the content of beside_paper.md.
    """
    title = f"{summary['set']}: {summary['start']['all']['n']} cases, {len(summary['methods'])} methods"
    if beside_paper is not None:
        title = f"{_title_of(beside_paper)}: ours beside the paper"
    shown = [path for path in plots if path.name in _PLOTS]
    skipped = summary.get("skipped_reasons") or {}
    return page(
        title,
        _in_short(summary),
        section("Beside the paper", markdown(beside_paper)) if beside_paper is not None else None,
        section("Tables", markdown(tables)),
        section("Plots", *(_plot(path) for path in sorted(shown, key=lambda one: list(_PLOTS).index(one.name)))),
        section("From good to bad answers", picture(small_picture(gallery, _PLOT_PX), "gallery", wide=True))
        if gallery is not None
        else None,
        section("Cases", *_cases(answers)),
        section("Left out", table(sorted(skipped.items()), ("what", "why"), "long")) if skipped else None,
        section("How it was made", table(made_from.items(), classes="long")),
    )


def _title_of(text: str) -> str:
    return text.lstrip().split("\n", 1)[0].removeprefix("# ")


def _in_short(summary: Mapping[str, Any]) -> Html:
    """The figures that a reader looks for first."""
    cells = {name: both["all"] for name, both in summary["methods"].items() if not is_start(both["all"])}
    items = []
    for name, cell in cells.items():
        ratio = cell["ratio"]
        if ratio is not None:
            between = (
                interval(cell["ratio_ci95"], 2, cell["n_pose"]) or f" (n {cell['n_pose']}, too few for an interval)"
            )
            words = f"{name}{' (an oracle)' if is_oracle(name) else ''}: MPJPE over the start's{between}"
            items.append(element("li", element("b", f"{ratio:.2f}"), element("span", words)))
    start = summary["start"]["all"]
    items.append(
        element("li", element("b", f"{number(start['mpjpe_mm'], 0)} mm"), element("span", "MPJPE of the start"))
    )
    return element("ul", *items, class_="figures-line")


def _plot(path: Path) -> Html:
    """A plot that keeps a readable size and scrolls where the page is narrower."""
    pixels = read_picture_srgb(path)
    height = max(1, round(pixels.shape[0] * _PLOT_PX / pixels.shape[1]))
    small = cv2.resize(pixels, (_PLOT_PX, height), interpolation=cv2.INTER_AREA)
    done, encoded = cv2.imencode(".png", np.round(small[..., ::-1] * 255).astype(np.uint8))
    assert done, "OpenCV writes PNG"
    caption = element("figcaption", _PLOTS[path.name])
    return element("figure", picture(encoded.tobytes(), _PLOTS[path.name], wide=True), caption)


def _cases(answers: Sequence[Answer]) -> list[Html]:
    """A table with a row per case, then the pictures of each, folded."""
    by_case: dict[int, list[Answer]] = {}
    for answer in answers:
        by_case.setdefault(int(answer.row["case"]), []).append(answer)
    methods = list(dict.fromkeys(str(answer.row["method"]) for answer in answers))
    drawn = _drawn(by_case)
    rows: list[Sequence[object]] = []
    pictures = []
    for case in sorted(by_case):
        row, told = by_case[case][0].row, {str(one.row["method"]): one.row for one in by_case[case]}
        name = element("a", f"case {case}", href=f"#case-{case}") if case in drawn else f"case {case}"
        figures = [_figure(told.get(method)) for method in methods]
        rows.append(
            [name, f"{row['blur_rate']:.2f}", number(row.get("initial_mpjpe_mm"), 0), *figures, row.get("source")]
        )
        if case in drawn:
            looks = [one for one in by_case[case] if one.look is not None]
            words = f"case {case}, blur rate {row['blur_rate']:.2f}, {row.get('source') or ''}"
            pictures.append(element("div", folded(words, *(_look(one) for one in looks)), id=f"case-{case}"))
    note = "MPJPE [mm] of the start and of every method, in brackets the IoU; below a picture: from the start's MPJPE."
    left = len(by_case) - len(drawn)
    said = (
        f"The pictures of {len(drawn)} cases are below; those of {left} others lie beside this page." if left else None
    )
    head = ["case", "blur rate", "start", *methods, "made from"]
    return [
        element("p", note, class_="muted"),
        folded(f"all {len(by_case)} cases", table(rows, head, "figures")),
        *([element("p", said)] if said and drawn else []),
        joined(pictures),
    ]


def _drawn(by_case: Mapping[int, Sequence[Answer]]) -> set[int]:
    """The cases whose pictures are shown: all, or as many as a page can hold, spread over all of them."""
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


def _look(answer: Answer) -> Html:
    assert answer.look is not None
    row = answer.row
    words = str(row["method"])
    if row.get("mpjpe_mm") is not None and row.get("initial_mpjpe_mm") is not None:
        words += f": {row['initial_mpjpe_mm']:.0f} → {row['mpjpe_mm']:.0f} mm"
    shown = picture(small_picture(answer.look, _LOOK_PX), words)
    return element("figure", shown, element("figcaption", words))
