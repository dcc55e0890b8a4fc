"""The part of a result's page on how the fit went: curves.json as charts.

``losses``: term -> a value per iteration, of a fit of one problem. ``windows``: per window of a clip its ``frames`` and
``total``, the weighted sum per iteration. ``frames``: figure -> [frame, value] pairs.
"""

from collections.abc import Mapping
from typing import Any

from hfb.report.charts import frames_chart, loss_chart, window_chart
from hfb.report.page import Html, element, picture, section

_LABELS = {"matte_iou": "IoU with the matte", "psnr_db": "PSNR of the re-blurred frame [dB]", "mpjpe_mm": "error [mm]"}


def curves_section(curves: Mapping[str, Any], facts: Mapping[str, Any]) -> Html | None:
    """Losses, and how well each frame is explained; None where nothing of the kind was kept."""
    shown = []
    if curves.get("losses"):
        chart = loss_chart(curves["losses"], _iterations(facts))
        shown.append(_figure(chart, "Every term of the objective as it is, and their weighted sum; dotted where the "
                                    "pictures become larger."))  # fmt: skip
    windows = [one["total"] for one in curves.get("windows", ()) if one.get("total")]
    if windows:
        chart = window_chart(windows)
        shown.append(_figure(chart, f"The weighted sum of the objective in the {len(windows)} windows of the clip."))
    for name, pairs in sorted(curves.get("frames", {}).items()):
        values = {int(frame): float(value) for frame, value in pairs}
        if len(values) > 1:
            label = _LABELS.get(name, name)
            shown.append(_figure(frames_chart(values, label), f"{label}, frame by frame."))
    if not shown:
        return None
    return section("How the fit went", element("div", *shown, class_="columns"), id="curves")


def _figure(chart: bytes, caption: str) -> Html:
    return element("figure", picture(chart, caption), element("figcaption", caption))


def _iterations(facts: Mapping[str, Any]) -> list[int]:
    """Of every stage, as the configuration has them."""
    config = facts.get("config")
    stages = config.get("fit", {}).get("stages", []) if isinstance(config, Mapping) else []
    return [int(stage["iterations"]) for stage in stages if isinstance(stage, Mapping) and "iterations" in stage]
