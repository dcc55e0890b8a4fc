"""95 % intervals hold the truth in 94 to 96 % of draws, from six cases on."""

import math

import numpy as np
import pytest

from hfb.evaluation.intervals import FEWEST_CASES, mean_ci95, ratio_ci95

_DRAWS = 4000
SHAPES = {
    "own starts": ((0.44, 0.45), 0.87),
    "simulated starts": ((0.25, 0.35), 0.7),
    "all blur rates together": ((0.35, 0.5), 0.6),
}
"""Standard deviations of the logarithms of the start's and the fit's error of a case, and their correlation, as
benchmarks have them (own starts: 50 cases of people that no network had seen)."""


def errors_mm(shape: str, cases: int, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Draws (D, cases) of the start's and the fit's error, log-normal and of the same cases, and the true ratio."""
    (start, fit), correlation = SHAPES[shape]
    one, other = np.random.default_rng(seed).standard_normal((2, _DRAWS, cases))
    other = correlation * one + math.sqrt(1 - correlation**2) * other
    return 100 * np.exp(start * one), 50 * np.exp(fit * other), 0.5 * math.exp((fit**2 - start**2) / 2)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("cases", [6, 12, 22, 40])
def test_intervals_of_a_ratio_of_means_hold_it_as_often_as_they_say(shape: str, cases: int) -> None:
    """The percentile bootstrap holds it in 84, 89 and 91 % of draws of 6, 12 and 22 cases."""
    starts, fits, true = errors_mm(shape, cases, 7)
    bounds = [ratio_ci95(fit, start) for fit, start in zip(fits, starts, strict=True)]
    held = np.mean([low <= true <= high for low, high in filter(None, bounds)])
    assert len(bounds) == _DRAWS
    assert 0.94 <= held <= 0.96


@pytest.mark.parametrize("cases", [6, 12, 22, 40])
def test_intervals_of_a_mean_hold_it_as_often_as_they_say(cases: int) -> None:
    fits = errors_mm("own starts", cases, 3)[1]
    true = 50 * math.exp(0.45**2 / 2)
    bounds = [mean_ci95(fit) for fit in fits]
    assert 0.935 <= np.mean([low <= true <= high for low, high in filter(None, bounds)]) <= 0.965


def test_a_difference_of_errors_has_an_interval_on_its_own_scale() -> None:
    apart = np.random.default_rng(1).normal(1.0, 3.0, (_DRAWS, 12))
    bounds = [mean_ci95(one) for one in apart]
    assert 0.94 <= np.mean([low <= 1 <= high for low, high in filter(None, bounds)]) <= 0.97


def test_that_both_are_of_the_same_cases_counts() -> None:
    starts, fits, _ = errors_mm("own starts", 40, 5)
    paired, apart = ratio_ci95(fits[0], starts[0]), ratio_ci95(fits[0], np.roll(starts[0], 7))
    assert paired is not None
    assert apart is not None
    assert np.ptp(paired) < 0.6 * np.ptp(apart)


def test_few_cases_have_no_interval() -> None:
    values = np.linspace(40, 90, FEWEST_CASES)
    assert ratio_ci95(values[1:], values[1:]) is None
    assert mean_ci95(values[1:]) is None
    assert mean_ci95(values) is not None
    assert ratio_ci95(np.ones(8), np.zeros(8)) is None
    assert ratio_ci95(values, values) == (1, 1)


def test_many_cases_have_the_normal_interval() -> None:
    many = np.random.default_rng(0).uniform(50, 150, 5000)
    bounds = mean_ci95(many)
    assert bounds is not None
    assert np.ptp(bounds) / 2 == pytest.approx(1.96 * many.std() / math.sqrt(len(many)), rel=0.02)
