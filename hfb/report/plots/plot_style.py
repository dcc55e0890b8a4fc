"""Style of a benchmark's plots: figure size, colours per method, PNG output.

Figures are separate objects without pyplot or global state: the same numbers give the same bytes.
"""

import io
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from hfb.evaluation.cells import is_start

_SIZE_INCHES, _DPI = (9.0, 5.0), 160
_FONT_POINTS = 10.5
GRAY, FAINT_GRAY = "#666666", "#dddddd"
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's colour-blind palette without its yellow, which is hard to see on white."""
_FIXED = {"best": "#0072B2", "paper": "#D55E00"}
_MARKERS = "osD^vP*X"

Style = dict[str, Any]


def styles(summary: Mapping[str, Any]) -> dict[str, Style]:
    """Return a colour, marker and line style per method, the same in every plot of a benchmark.

    Args:
        summary: content of summary.json.
    """
    free = [colour for colour in _COLOURS if colour not in _FIXED.values()]
    styles: dict[str, Style] = {}
    others = 0
    for place, name in enumerate(name for name, both in summary["methods"].items() if not is_start(both["all"])):
        colour, dashes = _FIXED.get(name), 0
        if colour is None:
            colour, dashes = free[others % len(free)], others // len(free)
            others += 1
        lines = ("-", "--", "-.", ":")
        styles[name] = {"color": colour, "marker": _MARKERS[place % len(_MARKERS)], "linestyle": lines[dashes % 4]}
    return {**{name: {"color": GRAY, "marker": None, "linestyle": "--"} for name in summary["methods"]}, **styles}


class Sheet(NamedTuple):
    """An empty figure and its axes; ``axes`` is a list where there are several panels."""

    figure: Any
    axes: Any


def sheet(panels: int = 1, inches: tuple[float, float] = _SIZE_INCHES) -> Sheet:
    """Return an empty figure with its axes.

    Args:
        panels: number of axes side by side.
        inches: width and height.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08)
    figure = Figure(figsize=inches, dpi=_DPI, layout=layout)
    FigureCanvasAgg(figure)
    every = [figure.add_subplot(1, panels, 1 + index) for index in range(panels)]
    for axes in every:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color=FAINT_GRAY, linewidth=0.8)
        axes.set_axisbelow(True)
    return Sheet(figure, every[0] if panels == 1 else every)


def png(figure: Any, *every: Any, columns: int = 6) -> bytes:
    """Render a figure as PNG with the first axes' legend above all panels.

    Args:
        figure: a matplotlib figure.
        *every: its axes.
        columns: most columns of the legend.
    """
    handles, labels = every[0].get_legend_handles_labels()
    if named := len(labels):
        legend = figure.legend(
            handles,
            labels,
            loc="outside upper center",
            ncols=math.ceil(named / math.ceil(named / columns)),
            frameon=False,
            fontsize=_FONT_POINTS,
        )
        for text in legend.get_texts():
            text.set_parse_math(False)  # names come from files and users
    for axes in every:
        axes.xaxis.label.set_size(_FONT_POINTS)
        axes.yaxis.label.set_size(_FONT_POINTS)
        axes.tick_params(labelsize=_FONT_POINTS - 1)
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()
