"""Calibration of the odds of directions by the kind of start and by signs of trouble.

The odds of `hfb.fitting.direction_odds` were measured on fits that began near the truth. Either the motion prior knows
a motion, and is right, or it does not, and leans to one side by chance. So evidence has to overcome a discount: with
L the log odds that the body moved the way the result says, the probability p of every hypothesis becomes

    p P^(k - 1) / norm,  k = max(0, 1 - discount / L),  discount = max(0, b_0 + sum_i b_i (f_i - typical_i) / spread_i),

whose f_i are signs of trouble in the fit (`SIGNS`), with b_i >= 0; P is the probability of all hypotheses by which the
body moved as by this one (`group_probability`). In one frame log odds of the body become max(0, L - discount). What the
image tells of limbs, given the body, is kept: a limb's reversal that the image refutes stays refuted. The coefficients
were fitted to fits whose truth is known (`hfb train confidence`), for each kind of start, and lie in
data/directions.json. Which motion is the result does not depend on them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hfb.fitting.alternatives import Alternatives
from hfb.fitting.confidence import KIND_WORDS, Features, StartKind, start_kind
from hfb.fitting.direction_odds import shipped_odds
from hfb.typing import Array, Float

SIGNS: tuple[str, ...] = ("misfit", "moved", "unusual")
"""Names in `hfb.fitting.joint_features`: an uncovered matte, a large distance from the first body, an unusual pose."""

_LEAST, _SUREST = 1e-12, 1 - 1e-9


@dataclass(frozen=True)
class Trust:
    """The coefficients of the discount.

    Attributes:
        constant: b_0.
        coefficients: b_i, by the name of the sign.
        typical: mean of each sign over the cases of the calibration.
        spread: standard deviation of each sign over these cases.
    """

    constant: float
    coefficients: Mapping[str, float]
    typical: Mapping[str, float]
    spread: Mapping[str, float]

    def discount(self, signs: Mapping[str, float]) -> float:
        """Return the log odds that evidence has to exceed in a frame with these signs.

        Args:
            signs: by name, see `signs_of`.
        """
        scaled = {name: (signs[name] - self.typical[name]) / self.spread[name] for name in self.coefficients}
        return max(0.0, self.constant + sum(weight * scaled[name] for name, weight in self.coefficients.items()))


def power_of(right: Float[Array, "*n"], discount: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the power to which odds are raised, given the probabilities that the body's direction is right.

    It is 1 for a body that hardly moves (NaN).

    Args:
        right: probability that the body's direction is right.
        discount: log odds to exceed, see `Trust.discount`.
    """
    surer = np.clip(np.maximum(right, 1 - right), 0.5, _SUREST)
    log_odds = np.log(surer / (1 - surer))
    known = np.maximum(0, 1 - np.divide(discount, log_odds, out=np.ones_like(log_odds), where=log_odds > 0))
    return np.where(np.isnan(right), 1.0, known)


def signs_of(features: Features, rows: slice | Array) -> dict[str, float]:
    """Return the signs of trouble in a frame: the mean of each feature over its rows and joints.

    Args:
        features: features of the result, by name.
        rows: rows of the frame.
    """
    return {name: float(features[name][rows, 1:].mean()) for name in SIGNS}


def group_probability(probability: Float[Array, "A"], agrees: Float[Array, "T A"]) -> Float[Array, "A"]:
    """Return for each hypothesis the probability of all with the same directions of the body.

    Args:
        probability: probability of the hypotheses.
        agrees: `Alternatives.body_agrees`.
    """
    _, group = np.unique(np.nan_to_num(agrees, nan=1.0) > 0.5, axis=1, return_inverse=True)
    return np.bincount(group.ravel(), weights=probability)[group.ravel()]


def temper(
    probability: Float[Array, "*n A"], grouped: Float[Array, "*n A"], power: Float[Array, "*n"]
) -> Float[Array, "*n A"]:
    """Draw the odds of the body's directions to even ones; inside a group hypotheses keep their odds.

    Args:
        probability: probability of the hypotheses.
        grouped: `group_probability` of them.
        power: 0 makes the groups equally likely, 1 changes nothing.
    """
    weights = probability * np.maximum(grouped, _LEAST) ** (np.asarray(power)[..., None] - 1)
    return weights / weights.sum(-1, keepdims=True)


def trusted(alternatives: Alternatives, features: Features, sources: Sequence[str]) -> Alternatives:
    """Return the alternatives with calibrated probabilities; of several frames the least trusted one counts.

    Args:
        alternatives: alternatives of one fit.
        features: features of the result.
        sources: sources of the frames' first bodies.
    """
    rows = (alternatives.frame_index == frame for frame in range(len(sources)))
    discounts = [
        shipped_trust(start_kind(source)).discount(signs_of(features, one))
        for source, one in zip(sources, rows, strict=True)
    ]
    power = np.asarray(power_of(alternatives.body_right(), np.array(discounts)).min())
    grouped = group_probability(alternatives.probability, alternatives.body_agrees())
    return replace(alternatives, probability=temper(alternatives.probability, grouped, power))


@lru_cache
def shipped_trust(kind: StartKind) -> Trust:
    """Return the shipped coefficients of a kind of start.

    Args:
        kind: kind of the first body.
    """
    content = shipped_odds()["trust"][kind]
    return Trust(**{name: content[name] for name in ("constant", "coefficients", "typical", "spread")})


def direction_condition(sources: Sequence[str]) -> dict[str, Any]:
    """Return the basis of a result's odds of directions: how often they held from its kinds of start, and a sentence.

    Args:
        sources: sources of the first bodies of all frames.
    """
    kinds = sorted({start_kind(source) for source in sources})
    frames = "several_frames" if len(sources) > 1 else "one_frame"
    shipped = shipped_odds()["trust"]
    new = {kind: shipped[kind]["new_people"][frames] for kind in kinds}
    told = "; ".join(f"{KIND_WORDS[kind]}: {_told(shipped[kind], frames)}" for kind in kinds)
    sentence = (
        f"Odds of directions were calibrated on synthetic pictures and counted on other people. From {told}. Least is "
        "known of motions that resemble no walk, run or everyday action; real pictures were not part of it."
    )
    return {"starts": kinds, "new_people": new, "holds_for": sentence}


def _told(counted: Mapping[str, Any], frames: str) -> str:
    """Return how often the predicted direction of the body was right, on new people where there are any."""
    new = counted["new_people"][frames]
    if new is None and frames != "one_frame":
        return "not counted"
    groups = counted["people_held_out"] if new is None else new["body"]
    return ", ".join(
        f"said {100 * one['said']:.0f} %, right {100 * one['right']:.0f} % (n {one['n']})" for one in groups
    )
