"""Calibration of the odds of directions on fits whose truth is known, and their reliability.

An event is the direction of the body, or of a limb, in one frame, which the result predicts rightly or wrongly.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from hfb.evaluation.metrics import wrong_direction
from hfb.evaluation.reliability import DIRECTION_EDGES
from hfb.fitting.alternatives import LIMB_JOINTS, Alternatives
from hfb.fitting.confidence import Features, StartKind
from hfb.fitting.direction_trust import SIGNS, Trust, group_probability, power_of, signs_of, temper
from hfb.typing import Array, Bool, Float

_LIMB_WEIGHT = 0.1
"""Weight of a limb's event, where a body's is 1: limbs of a frame are correlated with each other and with the body."""

_COMMON, _COMMON_SPREAD, _KINDS_APART, _SLOPES = 0.73, 0.2, 0.15, 0.15
"""Prior of the doubts in log odds: mean and spread over all kinds of start, spread of the kinds, and slope per spread
of a sign. On motions that no prior had learned from, predictions of .6 to .8 were right in .53 of cases: a doubt of
0.73."""

_CERTAIN = 1e-3


@dataclass(frozen=True)
class DirectionEvent:
    """One predicted direction and whether it was right.

    Attributes:
        person: events of a person stay together when some are held out.
        probability: probability of the hypotheses, before `hfb.fitting.direction_trust`.
        grouped: `group_probability` of them.
        agrees: whether each says as the result.
        right: whether the result was right.
        whole: whether it concerns the body, not a limb.
        body_right: P(the body is right) in this frame; NaN where it hardly moves.
        signs: signs of the frame.
        frames: number of the fit's frames.
    """

    person: str
    probability: Float[Array, "A"]
    grouped: Float[Array, "A"]
    agrees: Float[Array, "A"]
    right: bool
    whole: bool
    body_right: float
    signs: Mapping[str, float]
    frames: int = 1


def direction_events(
    person: str, alternatives: Alternatives, features: Features, true: Float[Array, "R 24 3"]
) -> Iterator[DirectionEvent]:
    """Yield the events of one fit: in every frame the body, and each limb, that moved enough to have a direction.

    Args:
        person: name, by which events are grouped.
        alternatives: alternatives of the fit.
        features: features of the result, by name.
        true: the true joints at the rows' instants [m].
    """
    joints, frames = alternatives.joints[alternatives.chosen], int(alternatives.frame_index.max()) + 1
    wrong, agrees = wrong_direction(joints, true, frames), alternatives.body_agrees()
    sure, grouped = alternatives.body_right(), group_probability(alternatives.probability, agrees)
    for frame in range(frames):
        rows = alternatives.frame_index == frame
        signs = signs_of(features, rows)
        queries = [(agrees[frame], not wrong[frame], True)]
        queries += [
            (
                alternatives.agrees(alternatives.joints, limb)[frame],
                _right(joints[rows][:, list(limb)], true[rows][:, list(limb)]),
                False,
            )
            for limb in LIMB_JOINTS
        ]
        for answers, right, whole in queries:
            if np.isfinite(answers).all():
                yield DirectionEvent(
                    person, alternatives.probability, grouped, answers, bool(right), whole, sure[frame], signs, frames
                )


def _right(path: Float[Array, "S J 3"], true: Float[Array, "S J 3"]) -> bool:
    """Return whether a path, wherever it is, is nearer to the true one than its reverse is."""
    here, there = (one - one.mean(0) for one in (path, true))
    return bool(np.linalg.norm(here - there, axis=-1).sum() <= np.linalg.norm(here[::-1] - there, axis=-1).sum())


class _Queries:
    """Many events as arrays.

    Attributes:
        right: whether the results were right.
    """

    def __init__(self, events: Sequence[DirectionEvent]) -> None:
        most = max(len(event.agrees) for event in events)
        self._probability, self._grouped, self._agrees = np.zeros((3, len(events), most))
        for row, event in enumerate(events):
            count = len(event.agrees)
            self._probability[row, :count], self._grouped[row, :count] = event.probability, event.grouped
            self._agrees[row, :count] = event.agrees
        self._body_right = np.array([event.body_right for event in events])
        self.right = np.array([event.right for event in events], bool)

    def said(self, discounts: Float[Array, "n"]) -> Float[Array, "n"]:
        """Return P(the result is right), where evidence has to exceed these doubts."""
        probability = temper(self._probability, self._grouped, power_of(self._body_right, discounts))
        return np.clip((self._agrees * probability).sum(1), _CERTAIN, 1 - _CERTAIN)


def fit_trust(events: Mapping[StartKind, Sequence[DirectionEvent]]) -> dict[StartKind, Trust]:
    """Fit the doubts by kind of start: a constant each, pulled to a common one, and common slopes of the signs.

    With few events a kind's doubt stays near the common one.

    Args:
        events: events of fits whose truth is known, by kind of start.
    """
    kinds = [kind for kind, known in events.items() if known]
    every = [one for kind in kinds for one in events[kind]]
    places = np.repeat(np.arange(len(kinds)), [len(events[kind]) for kind in kinds])
    table = np.array([[one.signs[name] for name in SIGNS] for one in every])
    typical, spread = table.mean(0), table.std(0) + 1e-9
    scaled = (table - typical) / spread
    weights = np.array([1.0 if one.whole else _LIMB_WEIGHT for one in every])
    queries = _Queries(every)

    def cost(numbers: Array) -> float:
        common, constants, slopes = numbers[0], numbers[1 : 1 + len(kinds)], numbers[1 + len(kinds) :]
        discounts = np.maximum(0, constants[places] + scaled @ np.abs(slopes))
        said = queries.said(discounts)
        pulled = ((common - _COMMON) / _COMMON_SPREAD, *(constants - common) / _KINDS_APART, *slopes / _SLOPES)
        return float(-weights @ np.log(np.where(queries.right, said, 1 - said)) + np.square(pulled).sum() / 2)

    start = np.concatenate([np.full(1 + len(kinds), 0.2), np.full(len(SIGNS), 0.05)])
    found = minimize(cost, start, method="Powell", options={"xtol": 1e-3, "ftol": 1e-6}).x
    named = [
        dict(zip(SIGNS, values.tolist(), strict=True)) for values in (np.abs(found[1 + len(kinds) :]), typical, spread)
    ]
    return {kind: Trust(float(found[1 + place]), *named) for place, kind in enumerate(kinds)}


def said_and_right(events: Sequence[DirectionEvent], trust: Trust | None) -> tuple[Float[Array, "n"], Bool[Array, "n"]]:
    """Return the predicted probability of each event, and whether the prediction was right.

    Args:
        events: events of fits whose truth is known.
        trust: corrects the odds; None leaves them as they are.
    """
    if not events:
        return np.zeros(0), np.zeros(0, bool)
    queries = _Queries(events)
    return queries.said(np.array([trust.discount(one.signs) if trust else 0.0 for one in events])), queries.right


def reliability_groups(
    said: Float[Array, "n"], right: Bool[Array, "n"], edges: Sequence[float] = DIRECTION_EDGES
) -> list[dict[str, float]]:
    """Group events by predicted probability: mean prediction, share right with Wilson's 95 % interval, and number.

    Args:
        said: predicted probabilities.
        right: whether each prediction was right.
        edges: edges of the groups, ascending.
    """
    place = np.digitize(said, edges[1:-1])
    groups = [place == index for index in range(len(edges) - 1)]
    return [
        {"said": round(float(said[one].mean()), 3), "right": round(float(right[one].mean()), 3), "n": int(one.sum())}
        | dict(zip(("low", "high"), wilson_ci95(int(right[one].sum()), int(one.sum())), strict=True))
        for one in groups
        if one.any()
    ]


def wilson_ci95(right: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share.

    Args:
        right: number of successes.
        count: number of trials.
    """
    z = float(norm.ppf(0.975))
    share, extra = right / count, z * z / count
    middle, half = share + extra / 2, z * np.sqrt(share * (1 - share) / count + extra / count / 4)
    return round(float((middle - half) / (1 + extra)), 3), round(float((middle + half) / (1 + extra)), 3)
