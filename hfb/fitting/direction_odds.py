"""Probabilities of directions: a softmax over hypotheses with calibrated coefficients."""

import json
from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np

from hfb.typing import Array, Float

EVIDENCE: tuple[str, ...] = ("excess", "limbs_backwards", "body_backwards", "network_backwards")
"""Evidence against a hypothesis.

``excess``: by how much the objective's weighted sum, the motion prior left out, is above that of the motion as fitted;
beyond `LARGEST_EXCESS` more means no more. ``limbs_backwards``, ``body_backwards``: the motion prior's
-log P(it does not run backwards), per limb and of the body as a whole; ``network_backwards``: the joint network's,
which saw the image. All summed over the frames.
"""

LARGEST_EXCESS = 0.3


def probabilities(
    evidence: Float[Array, "A E"], several: bool, calibration: Mapping[str, Any] | None = None
) -> Float[Array, "A"]:
    """Return P(hypothesis) = softmax of minus the evidence (columns: `EVIDENCE`) times the coefficients.

    Args:
        evidence: one row per hypothesis, columns as `EVIDENCE`; the motion as fitted first.
        several: weights for several frames, which their continuity connects.
        calibration: coefficients by name, for ``single`` and for ``several``; the shipped ones when not given.
    """
    chosen = (calibration or shipped_odds())["several" if several else "single"]
    exponent = -(evidence - evidence[:1]) @ np.array([chosen[name] for name in EVIDENCE])
    weights = np.exp(exponent - exponent.max())
    return weights / weights.sum()


@lru_cache
def shipped_odds() -> dict[str, Any]:
    """Load the shipped coefficients, and the cases that they were measured on (`hfb train confidence`)."""
    return json.loads(resources.files("hfb.fitting").joinpath("data/directions.json").read_text())
