"""Which front a fit keeps: the start as found or its mirror image in depth, whichever explains the frames better.

Both are fitted alike; the mirrored one is left at the first image size where that is clear enough. The evidence for "as
found" against "mirrored" is

    log odds = w_loss log(loss_mirrored / loss_found) + w_doubt doubt + prior,

whose weights depend on the kind of start. Where the better fit does not cover the mattes, neither has explained the
frames, and the first term is 0. The weights were fitted to fits whose truth is known (`hfb train fronts`) and lie in
data/fronts.json, with the counts.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np

from hfb.fitting.alternatives import FrontMotion
from hfb.fitting.confidence import StartKind, start_kind
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float

LARGEST_RATIO = 0.7
"""Largest logarithm of two losses that counts: beyond it one fit has failed, and how badly does not matter."""
_LARGEST_MATTE_LOSS = 0.085
"""Of a fit that explains its frames: good fits of real images reach 0.07, walks with shade in the matte 0.09 to 0.12
(`docs/experiments/2026-11.md`, both fronts)."""
CLEAR_LOG_ODDS = 2.0
"""Log odds after the first stage from which on the other front is fitted no further. Of 130 doubtful fronts of real
images (65, and these mirrored by hand) the 29 that ended mirrored had 1.1 at most."""
ANOTHER_FRONT_DEG = 60.0
"""Angle between both fits' chests from which on the other one faces another way."""


@dataclass(frozen=True)
class FitLoss:
    """Losses of a fit's best iterate.

    Attributes:
        total: weighted sum of all terms.
        matte: matte term, unweighted; 0 where it is not used.
    """

    total: float
    matte: float


@dataclass(frozen=True)
class FrontChoice:
    """The front that was kept, and the other one.

    Attributes:
        log_odds: of the front of the first bodies as found; negative where the mirrored one was kept.
        loss_ratio: see `loss_log_ratio`.
        doubt: mean of `hfb.initialization.fronts.front_doubts`.
        other: the motion that was fitted with the other front.
        turn_deg: angle between both chests at mid-exposure, the mean over the frames. The mirror image of somebody seen
            from the side faces the same way: the angle is small there, and the choice is one of left and right.
    """

    log_odds: float
    loss_ratio: float
    doubt: float
    other: SampledMotion
    turn_deg: float

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


def turn_between_deg(one: SampledMotion, other: SampledMotion) -> float:
    """Return the angle between the chests of two motions at mid-exposure, the mean over the frames.

    Args:
        one: a motion.
        other: at the same instants.
    """
    numbers = np.unique(one.frame_index)
    rows = [int(one.rows_of(int(number))[len(one.rows_of(int(number))) // 2]) for number in numbers]
    cosines = (_chests(one.joints[rows]) * _chests(other.joints[rows])).sum(-1)
    return float(np.rad2deg(np.arccos(np.clip(cosines, -1, 1))).mean())


def _chests(joints: Float[Array, "T 24 3"]) -> Float[Array, "T 3"]:
    """Return unit normals of the planes through shoulders and hips."""
    (left, right), hips = (joints[:, 16], joints[:, 17]), joints[:, 1] + joints[:, 2]
    normals = np.cross(left - right, left + right - hips)
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)


def front_probability(log_odds: float) -> float:
    """Return the probability of the likelier front.

    Args:
        log_odds: of one of both.
    """
    return 1 / (1 + math.exp(-abs(log_odds)))


def loss_log_ratio(found: FitLoss, mirrored: FitLoss) -> float:
    """Return log(loss_mirrored / loss_found), at most `LARGEST_RATIO`; 0 where the better fit misses the mattes.

    Args:
        found: of the fit from the bodies as found.
        mirrored: of the fit from the mirrored bodies.
    """
    better = min(found, mirrored, key=lambda one: one.total)
    if better.matte > _LARGEST_MATTE_LOSS or better.total <= 0:
        return 0.0
    return float(np.clip(math.log(mirrored.total / found.total), -LARGEST_RATIO, LARGEST_RATIO))


def front_log_odds(loss_ratio: float, doubt: float, sources: Sequence[str]) -> float:
    """Return the log odds of the front as found; of frames with several kinds of start the mean of what each says.

    Args:
        loss_ratio: see `loss_log_ratio`.
        doubt: mean of `hfb.initialization.fronts.front_doubts` over the frames.
        sources: of the first bodies.
    """
    weights = [shipped_front_weights(start_kind(source)) for source in sources]
    return float(np.mean([one.loss * loss_ratio + one.doubt * doubt + one.prior for one in weights]))


@dataclass(frozen=True)
class FrontWeights:
    """Weights of the evidence about a front, see the head of this file."""

    loss: float
    doubt: float
    prior: float


@lru_cache
def shipped_front_weights(kind: StartKind) -> FrontWeights:
    """Return the weights that come with hfb.

    Args:
        kind: of start.
    """
    content = json.loads((resources.files("hfb.fitting") / "data" / "fronts.json").read_text())
    return FrontWeights(**content["weights"][kind])
