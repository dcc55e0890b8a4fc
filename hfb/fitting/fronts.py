"""Which front a fit keeps: the start as found or its mirror image in depth, whichever explains the frames better.

Both are fitted alike. The evidence for "as found" against "mirrored" is what each loss and the joint network say,

    log odds = w_loss (loss_mirrored - loss_found) + w_network doubt + prior(kind of start).

The weights were fitted to fits whose truth is known and lie in data/fronts.json, with how they were made.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np

from hfb.fitting.alternatives import FrontMotion
from hfb.fitting.confidence import start_kind
from hfb.motion.sampled import SampledMotion

LARGEST_DIFFERENCE = 1.0
"""Of two losses: beyond it one of the fits has failed, and how badly says nothing more."""


@dataclass(frozen=True)
class FrontChoice:
    """The front that was kept, and the other one.

    Attributes:
        log_odds: of the front of the first bodies as found; negative where the mirrored one was kept.
        loss_difference: loss of the fit from the mirrored bodies less that from the bodies as found.
        doubt: mean of `hfb.initialization.fronts.front_doubts`.
        other: the motion that was fitted with the other front.
    """

    log_odds: float
    loss_difference: float
    doubt: float
    other: SampledMotion

    @property
    def mirrored(self) -> bool:
        """Whether the kept fit began from the mirrored bodies."""
        return self.log_odds < 0

    @property
    def probability(self) -> float:
        """Probability that the kept front is right."""
        return front_probability(self.log_odds)

    def as_alternative(self) -> FrontMotion:
        """Return the motion that was not kept, as `Alternatives` holds it."""
        other = self.other
        return FrontMotion(other.poses, other.trans, other.joints, 1 - self.probability)


def front_probability(log_odds: float) -> float:
    """Return the probability of the likelier front.

    Args:
        log_odds: of one of both.
    """
    return 1 / (1 + math.exp(-abs(log_odds)))


def front_log_odds(loss_difference: float, doubt: float, sources: Sequence[str]) -> float:
    """Return the log odds of the front as found.

    Args:
        loss_difference: loss of the fit from the mirrored bodies less that from the bodies as found.
        doubt: mean of `hfb.initialization.fronts.front_doubts` over the frames.
        sources: of the first bodies.
    """
    weights = shipped_fronts()
    prior = float(np.mean([weights["prior"][start_kind(source)] for source in sources]))
    clipped = float(np.clip(loss_difference, -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE))
    return weights["loss"] * clipped + weights["network"] * doubt + prior


@lru_cache
def shipped_fronts() -> dict[str, Any]:
    """Return the weights that come with hfb."""
    path = resources.files("hfb.fitting") / "data" / "fronts.json"
    content: dict[str, Any] = json.loads(path.read_text())
    return content
