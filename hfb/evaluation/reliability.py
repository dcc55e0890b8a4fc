"""Reliability of predicted uncertainties: predicted against observed errors."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hfb.fitting.alternatives import Alternatives
from hfb.fitting.confidence import radius_factor
from hfb.typing import Array, Float

if TYPE_CHECKING:  # .2 s and 60 MB, which whoever scores a motion can do without
    from pandas import DataFrame

LEVELS: tuple[float, ...] = (0.1, 0.25, 0.5, 0.75, 0.9)
"""Probabilities at which the joints' radii are checked."""

WITHIN: tuple[str, ...] = tuple(f"within_p{100 * level:.0f}" for level in LEVELS)
"""Columns of the rows: the share of a case's joints whose error is within the radius said for that probability."""

COLUMNS: tuple[str, ...] = (*WITHIN, "radius_mm", "direction_said")
DIRECTION_EDGES: tuple[float, ...] = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Directions are compared group by group of what was said: a probability on an edge belongs to the upper group."""


def joint_row(error_mm: Float[Array, "R P"], radius_mm: Float[Array, "R P"], exponent: float) -> dict[str, float]:
    """Return the entries of a case's row about its radii; none where no error is known.

    Args:
        error_mm: errors of the joints that count (the origin does not); NaN where the truth is not known.
        radius_mm: the radii that hold half of them.
        exponent: exponent of the law that gives the other probabilities.
    """
    known = np.isfinite(error_mm)
    if not known.any():
        return {}
    errors, radii = error_mm[known], radius_mm[known]
    shares = [float((errors <= radii * radius_factor(level, exponent)).mean()) for level in LEVELS]
    return dict(zip(WITHIN, shares, strict=True)) | {"radius_mm": float(radii.mean())}


def direction_row(alternatives: Alternatives) -> dict[str, float | None]:
    """Return the mean predicted P(direction right) over the frames; None where nothing moved enough to have one.

    Args:
        alternatives: alternatives of the fit.
    """
    said = alternatives.body_right()
    return {"direction_said": float(said.mean()) if np.isfinite(said).all() else None}


def reliability_cell(cases: "DataFrame") -> dict[str, Any]:
    """Return a results cell's entries: the share of joints within each level's radius, and its distance from the level.

    ``radius_error`` is the mean over the levels of |level - share|, ``direction_error`` the expected calibration
    error of the directions: the mean over the groups of |mean prediction - share right|, weighted by their cases.

    Args:
        cases: rows of one method.
    """
    sure = cases[cases["radius_mm"].notna()]
    shares = [float(sure[name].to_numpy().mean()) if len(sure) else None for name in WITHIN]
    off = [abs(share - level) for share, level in zip(shares, LEVELS, strict=True) if share is not None]
    groups = direction_groups(cases)
    count = sum(group["n"] for group in groups)
    return {
        **dict(zip(WITHIN, shares, strict=True)),
        "radius_mm": float(sure["radius_mm"].to_numpy().mean()) if len(sure) else None,
        "radius_error": float(np.mean(off)) if off else None,
        "direction_said": float(sum(group["n"] * group["said"] for group in groups) / count) if count else None,
        "direction_error": (
            float(sum(group["n"] * abs(group["said"] - group["right"]) for group in groups) / count) if count else None
        ),
    }


def direction_groups(cases: "DataFrame") -> list[dict[str, Any]]:
    """Group cases by predicted P(direction right): their number, the mean prediction, the share that was right.

    Args:
        cases: rows of one method.
    """
    known = cases[["direction_said", "wrong_direction"]].dropna()
    groups = known.groupby(np.digitize(known["direction_said"], DIRECTION_EDGES[1:-1]))
    return [
        {
            "n": len(one),
            "said": float(one["direction_said"].to_numpy().mean()),
            "right": float((1 - one["wrong_direction"].to_numpy()).mean()),
        }
        for _, one in groups
    ]
