"""table.md: a summary in the paper's layout, as a page of GitHub's markdown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hfb.evaluation.cells import Cell, is_start
from hfb.evaluation.intervals import FEWEST_CASES
from hfb.evaluation.movement_page import movement_tables, recording_tables
from hfb.evaluation.reliability import LEVELS, WITHIN
from hfb.evaluation.table_text import TIED, UNKNOWN, blur_label, grid, interval, method_name, number, percent

Metric = Literal["mpjpe", "pa_mpjpe", "iou"]
_PAPERS_METRICS: Mapping[str, tuple[Metric, ...]] = {"bt-amass": ("mpjpe", "iou")}
_OTHER_METRICS: tuple[Metric, ...] = ("pa_mpjpe", "mpjpe")


@dataclass(frozen=True)
class _Block:
    """The format of one metric."""

    title: str
    entry: str
    start_entry: str
    digits: int
    lower_is_better: bool


_BLOCKS: Mapping[Metric, _Block] = {
    "mpjpe": _Block("MPJPE [mm] ↓", "mpjpe_mm", "mpjpe_mm", 1, True),
    "pa_mpjpe": _Block("PA-MPJPE [mm] ↓", "pa_mpjpe_mm", "pa_mpjpe_mm", 1, True),
    "iou": _Block("IoU ↑", "iou", "iou", 3, False),
}


def table_markdown(
    summary: Mapping[str, Any],
    notes: Sequence[str] = (),
    metrics: Sequence[Metric] | None = None,
    oracles: Sequence[str] | None = None,
) -> str:
    """Format a summary as a page: all cases, per metric a column per interval of blur rates, ratios with intervals.

    Args:
        summary: result of `summarize`, or content of summary.json.
        notes: on how it was made (starts, mattes, body ...); a line under the title.
        metrics: blocks in their order; the paper's of this set when not given.
        oracles: methods that use the truth: in italics, and never best; by `is_oracle` when not given.
    """
    chosen = _PAPERS_METRICS.get(summary["set"], _OTHER_METRICS) if metrics is None else metrics
    methods = summary["methods"]
    out_of_contest = [name for name in methods if is_oracle(name)] if oracles is None else oracles
    parts = [
        f"# {summary['set']}: {summary['start']['all']['n']} cases",
        *(["; ".join(notes) + "."] if notes else []),
        _counts(summary),
        "## All cases",
        f"In brackets the 95 % interval over cases (Student's t on the logarithm) and their number n; none below "
        f"{FEWEST_CASES} cases.",
        _overall(summary, out_of_contest),
        *recording_tables(summary, out_of_contest),
        *movement_tables(summary, out_of_contest),
        *(f"## {_BLOCKS[metric].title} by blur rate\n\n{_block(summary, metric, out_of_contest)}" for metric in chosen),
    ]
    if any(cells["all"]["ratio"] is not None for cells in methods.values()):
        explanation = "Mean MPJPE over the start's, of the same cases; below 1 is better than the start."
        parts += ["## Ratio to the start by blur rate", explanation, _ratios(summary)]
    if any(cells["all"].get("radius_error") is not None for cells in methods.values()):
        explanation = (
            "Share of joints whose error is within the radius that the method gives for a probability; direction of "
            "time: mean probability said, and share of cases right. Off: mean distance of said and happened."
        )
        parts += ["## How sure it is, and how often that was right", explanation, _reliability(summary)]
    if summary.get("comparisons"):
        explanation = "Differences of MPJPE over the cases that both methods answered; negative: the first is better."
        parts += ["## On the same cases", explanation, _same_cases(summary["comparisons"])]
    return "\n\n".join(parts) + "\n"


def ratio_text(cell: Cell, digits: int) -> str:
    """Format a method's ratio to the start with its interval.

    Args:
        cell: cell of the method, by `make_cell`.
        digits: decimals of the interval.
    """
    return number(cell["ratio"], 3) + interval(cell["ratio_ci95"], digits, cell["n_pose"])


def is_oracle(method: str) -> bool:
    """Return whether a method's name says that it uses the truth: "oracle-..." and "...@true-...".

    Args:
        method: its name.
    """
    return method.startswith("oracle") or "@true-" in method


def _counts(summary: Mapping[str, Any]) -> str:
    outside = summary.get("outside_bins", 0)
    beyond = f" Outside the intervals below, and in `all` only: {outside}." if outside else ""
    skipped = "nothing skipped" if not summary["skipped"] else f"skipped (summary.json says why): {summary['skipped']}"
    return f"Count {summary['count']}, seed {summary['seed']}, {skipped}.{beyond}"


def _overall(summary: Mapping[str, Any], oracles: Sequence[str]) -> str:
    header = ["method", "n", "MPJPE [mm]", "ratio to start", "PA-MPJPE [mm]", "in plane / depth [mm]", "IoU"]
    header += ["better way of time [mm], IoU", "better than start", "wrong direction", "s per case"]
    cells = {name: both["all"] for name, both in summary["methods"].items() if not is_start(both["all"])}
    best = _best([cell["mpjpe_mm"] for name, cell in cells.items() if name not in oracles], 1, True)
    start = summary["start"]["all"]
    first = [_start_name(summary), str(start["n"]), number(start["mpjpe_mm"], 1), "1", number(start["pa_mpjpe_mm"], 1)]
    first += [UNKNOWN, number(start["iou"], 3), UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN]
    rows = [
        [method_name(name, oracles), *_overall_row(cell, None if name in oracles else best)]
        for name, cell in cells.items()
    ]
    return grid(header, [first, *rows])


def _overall_row(cell: Cell, best: str | None) -> list[str]:
    error, better_iou = number(cell["mpjpe_mm"], 1), cell.get("best_of_two_iou")
    return [
        str(cell["n"]) + (f" ({cell['failed']}{TIED}failed)" if cell["failed"] else ""),
        (f"**{error}**" if error == best else error) + interval(cell["mpjpe_ci95"], 1, cell["n_pose"]),
        ratio_text(cell, 3),
        number(cell["pa_mpjpe_mm"], 1),
        TIED.join([number(cell["in_plane_mm"], 0), "/", number(cell["depth_mm"], 0)]),
        number(cell["iou"], 3),
        number(cell["best_of_two_mpjpe_mm"], 1) + ("" if better_iou is None else f",{TIED}{better_iou:.3f}"),
        percent(cell["better_than_start"]),
        percent(cell["wrong_direction"]),
        number(cell["seconds_per_case"], 1),
    ]


def _block(summary: Mapping[str, Any], metric: Metric, oracles: Sequence[str]) -> str:
    """Return one metric: a row per method, a column per interval and one for all cases."""
    block = _BLOCKS[metric]
    starts = [*summary["start"]["bins"], summary["start"]["all"]]
    first = _start_name(summary)
    cells = {
        name: [*both["bins"], both["all"]] for name, both in summary["methods"].items() if not is_start(both["all"])
    }
    columns = range(len(starts))

    def entries(row: Sequence[Cell], entry: str) -> list[str]:
        return [number(cell[entry], block.digits) for cell in row]

    written = {first: entries(starts, block.start_entry)}
    written |= {name: entries(row, block.entry) for name, row in cells.items()}
    contest = [row for name, row in written.items() if name not in oracles]
    best = [
        _best([float(row[c]) for row in contest if row[c] != UNKNOWN], block.digits, block.lower_is_better)
        for c in columns
    ]
    rows = [["n", *(str(cell["n"]) for cell in starts)]]
    for name, row in written.items():
        shown = [f"**{text}**" if text == best[c] and name not in oracles else text for c, text in enumerate(row)]
        for column, cell in enumerate(cells.get(name, [])):
            if 0 < cell["n"] < starts[column]["n"]:
                shown[column] += f" (n{TIED}{cell['n']})"
        rows.append([method_name(name, oracles), *shown])
    return grid(["blur rate", *(blur_label(cell["blur"]) for cell in starts[:-1]), "all"], rows)


def _ratios(summary: Mapping[str, Any]) -> str:
    """Return a row per interval, a column per method with a body: narrower than the other way round."""
    judged = {n: c for n, c in summary["methods"].items() if c["all"]["ratio"] is not None and not is_start(c["all"])}
    cells = {name: [*both["bins"], both["all"]] for name, both in judged.items()}
    starts = [*summary["start"]["bins"], summary["start"]["all"]]
    rows = []
    for index, start in enumerate(starts):
        label = blur_label(start["blur"]) if "blur" in start else "all"
        ratios = [ratio_text(row[index], 2) for row in cells.values()]
        rows.append([label, str(start["n"]), number(start["mpjpe_mm"], 1), *ratios])
    return grid(["blur rate", "n", "start [mm]", *cells], rows)


def _reliability(summary: Mapping[str, Any]) -> str:
    sure = {name: both["all"] for name, both in summary["methods"].items() if both["all"]["radius_error"] is not None}
    header = ["method", *(f"said {100 * level:.0f}{TIED}%" for level in LEVELS), "off", "mean radius [mm]"]
    header += ["direction said", "direction right", "off"]
    rows = [
        [
            name,
            *(percent(cell[column]) for column in WITHIN),
            percent(cell["radius_error"]),
            number(cell["radius_mm"], 0),
            percent(cell["direction_said"]),
            percent(None if cell["wrong_direction"] is None else 1 - cell["wrong_direction"]),
            percent(cell["direction_error"]),
        ]
        for name, cell in sure.items()
    ]
    return grid(header, rows)


def _same_cases(comparisons: Mapping[str, Any]) -> str:
    rows = [
        [
            pair,
            str(both["all"]["n"]),
            number(both["all"]["difference_mm"], 1) + interval(both["all"]["difference_ci95"], 1, both["all"]["n"]),
            number(both["all"]["ratio"], 3) + interval(both["all"]["ratio_ci95"], 3, both["all"]["n"]),
            percent(both["all"]["better"]),
        ]
        for pair, both in comparisons.items()
    ]
    return grid(["pair", "n", "difference [mm]", "ratio", "first better in"], rows)


def _start_name(summary: Mapping[str, Any]) -> str:
    same = [name for name, cells in summary["methods"].items() if is_start(cells["all"])]
    return f"start ({', '.join(same)})" if same else "start"


def _best(values: Sequence[float | None], digits: int, lower_is_better: bool) -> str | None:
    """Return the best value as it is formatted, so that equal texts are equally bold."""
    choose: Callable[[list[float]], float] = min if lower_is_better else max
    known = [value for value in values if value is not None]
    return number(choose(known), digits) if known else None
