"""Calibration of confidence on fits whose truth is known.

Errors within a case are correlated, so every case counts as one, and the reliability is measured on cases of recordings
that the coefficients were not fitted to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from hfb.evaluation.reliability import LEVELS
from hfb.fitting.confidence import ConfidenceModel, radius_factor
from hfb.fitting.direction_odds import EVIDENCE
from hfb.typing import Array, Float

_SMALLEST_ERROR_MM = 1.0
_RIDGE = 3.0
_STAKE_MM, _LARGEST_STAKE_MM = 1.0, 10.0
_ODDS_RIDGE = 0.05


@dataclass(frozen=True)
class JointCase:
    """One case's joints: their features and errors.

    Attributes:
        recording: cases of one recording, or person, stay together when some are held out.
        features: by name; `hfb.fitting.joint_features`.
        errors_mm: as `hfb.evaluation.metrics.errors_mm` takes them.
    """

    recording: str
    features: dict[str, Float[Array, "R 24"]]
    errors_mm: Float[Array, "R 24"]


@dataclass(frozen=True)
class DirectionCase:
    """One case's hypotheses: the evidence (columns: `EVIDENCE`), and their errors [mm].

    For one frame the second half of the hypotheses are the first half reversed in time, in the same order.
    """

    recording: str
    frames: int
    evidence: Float[Array, "A E"]
    errors_mm: Float[Array, "A"]


def fit_confidence(
    cases: Sequence[JointCase],
    names: Sequence[str],
    exponent: float | None = None,
    prior: ConfidenceModel | None = None,
) -> ConfidenceModel:
    """Fit the coefficients of the log-linear radius and the Weibull law's exponent by weakly regularised likelihood.

    The constant is then moved until half of the errors lie within the radius, whatever law they follow.

    Args:
        cases: fits whose errors are known.
        names: the features to use.
        exponent: exponent of the law, where it is known already.
        prior: model towards whose coefficients the fit is regularised; zero without one.
    """
    tables = [np.stack([case.features[name][:, 1:].ravel() for name in names], 1) for case in cases]
    errors = [np.maximum(case.errors_mm[:, 1:].ravel(), _SMALLEST_ERROR_MM) for case in cases]
    table, error = np.concatenate(tables), np.log(np.concatenate(errors))
    weight = np.concatenate([np.full(len(one), 1 / len(one)) for one in errors])
    mean, spread = table.mean(0), table.std(0) + 1e-9
    scaled = (table - mean) / spread
    pulled_to = spread * [0.0 if prior is None else prior.coefficients.get(name, 0.0) for name in names]

    def cost(numbers: Array) -> tuple[float, Array]:
        log_k, constant, slopes = numbers[0], numbers[1], numbers[2:]
        k, log_ratio = np.exp(log_k), error - constant - scaled @ slopes
        power = np.log(2) * np.exp(np.clip(k * log_ratio, -50, 50))
        value = weight @ (power - k * log_ratio) - len(cases) * log_k + _RIDGE / 2 * np.square(slopes - pulled_to).sum()
        gradient = weight * k * (1 - power)
        of_k = weight @ ((power - 1) * log_ratio) * k - len(cases)
        return float(value), np.concatenate([[of_k, gradient.sum()], gradient @ scaled + _RIDGE * (slopes - pulled_to)])

    log_exponent = 0.5 if exponent is None else float(np.log(exponent))
    start = np.concatenate([[log_exponent, np.median(error)], pulled_to])
    held = None if exponent is None else [(log_exponent, log_exponent), *[(None, None)] * (1 + len(names))]
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=held).x
    constant = found[1] + _median(error - found[1] - scaled @ found[2:], weight)
    slopes = found[2:] / spread
    coefficients = {name: float(slope) for name, slope in zip(names, slopes, strict=True)}
    typical = {name: float(value) for name, value in zip(names, mean, strict=True)}
    return ConfidenceModel(coefficients, float(constant - slopes @ mean), float(np.exp(found[0])), typical)


def _median(values: Float[Array, "n"], weights: Float[Array, "n"]) -> float:
    order = np.argsort(values)
    return float(values[order][np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)])


def held_out_reliability(
    cases: Sequence[JointCase],
    names: Sequence[str],
    folds: int = 8,
    exponent: float | None = None,
    prior: ConfidenceModel | None = None,
) -> dict[str, float]:
    """Measure how calibrated and how sharp the radii are on recordings that the coefficients were not fitted to.

    ``within_p50`` and so on: share of joints within the radius; ``off``: mean distance from the predicted share;
    ``rank``: Spearman's correlation of radius and error over all joints; ``rank_in_case``: its mean within the cases.

    Args:
        cases: fits whose errors are known.
        names: the features to use.
        folds: parts into which the recordings are split.
        exponent: exponent of the law, where it is known already.
        prior: model towards whose coefficients the fit is regularised; zero without one.
    """
    shares, ranks, radii, errors = [], [], [], []
    for part in _folds([case.recording for case in cases], folds):
        model = fit_confidence([cases[i] for i in range(len(cases)) if i not in part], names, exponent, prior)
        for case in (cases[i] for i in part):
            radius, error = model.radius_mm(case.features)[:, 1:], case.errors_mm[:, 1:]
            shares.append([(error <= radius * radius_factor(level, model.exponent)).mean() for level in LEVELS])
            ranks.append(_rank_correlation(radius.ravel(), error.ravel()))
            radii.append(radius.ravel())
            errors.append(error.ravel())
    happened = np.mean(shares, axis=0)
    return {
        **{f"within_p{100 * level:.0f}": round(float(s), 4) for level, s in zip(LEVELS, happened, strict=True)},
        "off": round(float(np.abs(happened - LEVELS).mean()), 4),
        "rank": round(_rank_correlation(np.concatenate(radii), np.concatenate(errors)), 4),
        "rank_in_case": round(float(np.mean(ranks)), 4),
    }


def fit_direction_odds(cases: Sequence[DirectionCase]) -> dict[str, float]:
    """Fit coefficients of `EVIDENCE`, none below zero, to pairs of hypotheses of which one is nearer to the truth.

    Logistic regression, each pair weighted by its difference in error. For one frame the image's evidence is fitted on
    hypotheses regardless of the arrow of time (the better of a motion and its reverse), the evidence on time's arrow on
    each motion and its reverse; for several frames there is only the first kind.

    Args:
        cases: fits whose errors are known.
    """
    place = {name: index for index, name in enumerate(EVIDENCE)}
    excess, arrow = [place["excess"]], [place[name] for name in EVIDENCE if name.endswith("_backwards")]
    found = np.zeros(len(EVIDENCE))
    found[excess] = _logistic([_against_fitted(case) for case in cases], excess)
    if all(case.frames == 1 for case in cases):
        found[arrow] = _logistic([_against_reverse(case) for case in cases], arrow)
    return {name: float(found[index]) for name, index in place.items()}


Pairs = tuple[Float[Array, "P E"], Float[Array, "P"]]


def _against_fitted(case: DirectionCase) -> Pairs:
    """Return differences of evidence and error of every other hypothesis from the motion as fitted."""
    evidence, errors = case.evidence, case.errors_mm
    if case.frames == 1:
        half = len(errors) // 2
        evidence, errors = evidence[:half], np.minimum(errors[:half], errors[half:])
    return evidence[1:] - evidence[0], errors[1:] - errors[0]


def _against_reverse(case: DirectionCase) -> Pairs:
    half = len(case.errors_mm) // 2
    return case.evidence[half:] - case.evidence[:half], case.errors_mm[half:] - case.errors_mm[:half]


def _logistic(pairs: Sequence[Pairs], columns: Sequence[int]) -> Float[Array, "_"]:
    """Fit slopes >= 0 with P(the second is worse) = sigmoid(slopes . (its evidence - the first's))."""
    counted = [(evidence[:, columns], errors, abs(errors) > _STAKE_MM) for evidence, errors in pairs]
    table = np.concatenate([(e * np.sign(d)[:, None])[m] for e, d, m in counted])
    stakes = np.concatenate([np.minimum(abs(d), _LARGEST_STAKE_MM)[m] / max(len(d), 1) for _, d, m in counted])

    def cost(slopes: Array) -> float:
        return float(stakes @ np.logaddexp(0, -(table @ slopes)) + _ODDS_RIDGE * slopes @ slopes)

    return minimize(cost, np.full(len(columns), 0.3), bounds=[(0, None)] * len(columns)).x


def reliability_of(model: ConfidenceModel, cases: Sequence[JointCase]) -> dict[str, float]:
    """Return the share of joints within a given model's radius for every level, as in `held_out_reliability`.

    Args:
        model: radii and exponent to test.
        cases: fits whose errors are known.
    """
    shares = [
        [(case.errors_mm[:, 1:] <= radius * radius_factor(level, model.exponent)).mean() for level in LEVELS]
        for case, radius in ((case, model.radius_mm(case.features)[:, 1:]) for case in cases)
    ]
    return {
        f"within_p{100 * level:.0f}": round(float(s), 4) for level, s in zip(LEVELS, np.mean(shares, 0), strict=True)
    }


def _folds(recordings: Sequence[str], count: int) -> list[list[int]]:
    """Split the cases' numbers into parts, all cases of one recording in the same part."""
    order = {name: index % count for index, name in enumerate(sorted(set(recordings)))}
    parts = [[i for i, name in enumerate(recordings) if order[name] == part] for part in range(count)]
    return [part for part in parts if part and len(part) < len(recordings)]


def _rank_correlation(one: Float[Array, "n"], other: Float[Array, "n"]) -> float:
    ranks = [np.argsort(np.argsort(values, kind="stable"), kind="stable") for values in (one, other)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])
