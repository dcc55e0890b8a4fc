"""Limb speeds and advice on how to take further images, as parts of a result's page."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hfb.motion.sampled import SampledMotion
from hfb.report.pages.charts import speed_chart
from hfb.report.pages.limb_speed import SHUTTER_SPEEDS, LimbSpeed, exposure_s, limb_speeds, shutter_for

_WORTH_SAYING_PX = 1.5
_FROZEN_PX, _NEARLY_PX = 1.0, 2.0
_POOR_IOU = 0.75
_SMALL_PX = 100
_UNSURE_DIRECTION = 0.9


def speeds_table(motion: SampledMotion) -> dict[str, Any] | None:
    """Return ``head`` and ``rows`` of top speeds, and the curves as ``chart``; None where no frame has two instants.

    Args:
        motion: fitted motion.
    """
    speeds = limb_speeds(motion)
    if not speeds:
        return None
    several = len(np.unique(motion.frame_index)) > 1
    head = ["", "top speed", "80 % interval", "at", *(["frame"] if several else []), "mean", "smear"]
    rows = [
        [
            one.limb,
            f"{one.peak_m_s:.1f} m/s",
            interval_text(one),
            f"{1000 * one.peak_s:.0f} ms",
            *([str(one.frame)] if several else []),
            f"{one.mean_m_s:.1f} m/s",
            f"{one.smear_px:.0f} px",
        ]
        for one in speeds
    ]
    return {"head": head, "rows": rows, "chart": speed_chart(motion)}


def interval_text(speed: LimbSpeed) -> str:
    """Format the 80 % interval of a limb's speed.

    Args:
        speed: one limb.
    """
    if speed.interval_m_s is None:
        return "not known"
    low, high = speed.interval_m_s
    return f"{low:.1f} \u2013 {high:.1f} m/s"


def advice(motion: SampledMotion, facts: Mapping[str, Any]) -> list[str]:
    """Return sentences on how further images could tell more.

    Args:
        motion: fitted motion.
        facts: content of result.json.
    """
    return [*shutter_advice(limb_speeds(motion), exposure_s(motion)), *_other_advice(motion, facts)]


def shutter_advice(speeds: Sequence[LimbSpeed], open_s: float) -> list[str]:
    """Name the limb with the longest motion blur and the exposure that would have frozen it.

    Args:
        speeds: of all limbs.
        open_s: exposure time.
    """
    if not speeds:
        return []
    most = max(speeds, key=lambda one: one.smear_px)
    if most.smear_px < _WORTH_SAYING_PX:
        return []
    fastest = max(one.peak_px_s for one in speeds)
    began = f"The {most.limb} smeared {most.smear_px:.0f} px in {shutter_text(open_s)}"
    frozen, nearly = shutter_for(fastest, _FROZEN_PX), shutter_for(fastest, _NEARLY_PX)
    if frozen is None and nearly is None:
        return [f"{began}; 1/{SHUTTER_SPEEDS[-1]} s would not have frozen it, a flash would."]
    if frozen is None:
        return [f"{began}; 1/{nearly} s would have kept everything within 2 px."]
    if nearly == frozen:
        return [f"{began}; 1/{frozen} s would have frozen it (1 px at most, every limb)."]
    return [f"{began}; 1/{frozen} s would have frozen it (1 px at most, every limb), 1/{nearly} s nearly (2 px)."]


def shutter_text(seconds: float) -> str:
    """Format an exposure time as cameras do, such as 1/250 s.

    Args:
        seconds: exposure time.
    """
    return f"{seconds:.2g} s" if seconds >= 0.4 else f"1/{1 / max(seconds, 1e-9):.0f} s"


def _other_advice(motion: SampledMotion, facts: Mapping[str, Any]) -> list[str]:
    said = []
    directions = facts.get("directions")
    if isinstance(directions, list) and len(directions) == 1:
        right = directions[0].get("right", {}).get("body")
        if isinstance(right, int | float) and right < _UNSURE_DIRECTION:
            said.append(
                "One picture leaves the direction open: a second frame of the same camera tells it, 57 of 60 in our "
                "measurements."
            )
    agreement = facts.get("matte_iou")
    if isinstance(agreement, int | float) and agreement < _POOR_IOU:
        said.append(
            f"Body and matte agree to {agreement:.2f} only (IoU): look at the matte above. A plate of the empty scene "
            "from the same camera, taken in the same light, makes a better one."
        )
    height = _height_px(motion)
    if height < _SMALL_PX:
        said.append(f"The person is some {height:.0f} px high: closer, or with a longer lens, limbs are told apart.")
    return said


def _height_px(motion: SampledMotion) -> float:
    """Return the median distance from the highest to the lowest joint in the image."""
    seen = motion.joints @ motion.K.T
    rows = seen[..., 1] / np.maximum(seen[..., 2], 1e-6)
    return float(np.median(np.ptp(rows, axis=1)))
