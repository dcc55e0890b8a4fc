"""The table printed at the end of a run, and the keys of its JSON line."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from hfb.networks.registry import KnownModel


def number_text(value: float | None) -> str:
    """Format a number in few characters; ``-`` for None.

    Args:
        value: any number.
    """
    if value is None:
        return "-"
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def figure_text(value: float | None, form: str) -> str:
    """Return a figure as displayed, a dash where it is not known.

    Args:
        value: the figure.
        form: format specification.
    """
    return "-" if value is None else format(value, form)


class Row(NamedTuple):
    """One line of the table: label and key of a score, and its format."""

    label: str
    key: str
    form: str


_PLACES = ("out", "strip", "report", "mlflow_run_id")
FIT_KEYS = (
    "matte_iou",
    "psnr_db",
    "foot_skate_mm",
    "world",
    "fit_seconds",
    *_PLACES,
    "directions",
    "unknown",
    "warnings",
)
DEMO_KEYS = (
    "initial_mpjpe_mm",
    "mpjpe_mm",
    "pa_mpjpe_mm",
    "initial_iou",
    "iou",
    "psnr_db",
    "fit_seconds",
    "total_seconds",
    *_PLACES,
    "directions",
    "unknown",
    "warnings",
)
FIT_ROWS = (Row("IoU with the matte", "matte_iou", ".3f"), Row("image PSNR [dB]", "psnr_db", ".1f"))
DEMO_ROWS = (
    Row("MPJPE [mm]", "mpjpe_mm", ".1f"),
    Row("PA-MPJPE [mm]", "pa_mpjpe_mm", ".1f"),
    Row("IoU", "iou", ".3f"),
    Row("better way: MPJPE", "better_mpjpe_mm", ".1f"),  # of time, which one picture does not tell
    Row("better way: IoU", "better_iou", ".3f"),
    Row("image PSNR [dB]", "psnr_db", ".1f"),
)


def text(result: Mapping[str, Any], rows: tuple[Row, ...], hint: str | None) -> str:
    """Return the table, the times and the places of files.

    Args:
        result: content of result.json, with ``total_seconds``.
        rows: of the table.
        hint: how to open the link to MLflow; None to leave it out.
    """
    lines = ["", f"{'':<20}{'initial':>10}{'fitted':>10}"]
    for label, key, form in rows:
        cells = (figure_text(result.get(name), form) for name in (f"initial_{key}", key))
        lines.append(f"{label:<20}" + "".join(f"{cell:>10}" for cell in cells))
    lines += [
        f"{'seconds':<20}{'':>10}{result['fit_seconds']:>10.1f}   (the whole command {result['total_seconds']:.1f})",
        *(["", *textwrap.wrap(result["unknown"], 100)] if result.get("unknown") else []),
        "",
        f"strip    {result['strip']}",
        *([f"report   {result['report']}"] if result.get("report") else []),
        f"result   {result['out']}",
    ]
    if result["mlflow_link"] is not None:
        lines.append(f"MLflow   {result['mlflow_link']}")
        lines += [f"         {hint}"] if hint else []
    return "\n".join(lines)


def models_text(models: Sequence[KnownModel]) -> str:
    """Return a few lines per model: use, presence, licence, and how to get it.

    Args:
        models: known models.
    """
    lines = []
    for model in models:
        state = {True: "here", False: f"missing, get it by {model.get}", None: f"yours to bring: {model.get}"}
        lines += textwrap.wrap(f"{model.name}: {model.role}; {model.use}", 110)
        lines += textwrap.wrap(
            f"{state[model.present]}  [{model.licence}]", 110, initial_indent="    ", subsequent_indent="    "
        )
    return "\n".join(lines)
