"""95 % intervals of a mean, and of a ratio of two means, over the cases of a table's cell.

The ratio is mean(above) / mean(below) of the same cases: a ratio of means, never a mean of ratios. Its interval is
Student's t (n - 1 degrees of freedom) on the logarithm of that ratio, with the jackknife's standard error: the root of
the sum of squares by which leaving out one case moves it, about their mean. The factor (n - 1) / n of the usual
jackknife is left out (HC3; MacKinnon and White 1985), since few skewed errors show too little of their spread.

The case is the unit, never the sub-frame or the joint: errors within a case are not independent. Where every value is
positive the scale is logarithmic, else (differences, shares that may be zero) it is the values' own.
"""

from functools import lru_cache

import numpy as np
from scipy.special import stdtrit

from hfb.typing import Array, Float

FEWEST_CASES = 6
"""Smallest number of cases: below it no interval contains the truth in 95 % of draws."""

_TAIL = 0.975


@lru_cache
def _quantile(freedom: int) -> float:
    return float(stdtrit(freedom, _TAIL))  # scipy.stats would cost half a second of every report


def mean_ci95(values: Float[Array, "C"]) -> tuple[float, float] | None:
    """Return the 95 % interval of the mean over the cases; None for fewer than `FEWEST_CASES`.

    Args:
        values: one per case.
    """
    return ratio_ci95(values, np.ones_like(values))


def ratio_ci95(above: Float[Array, "C"], below: Float[Array, "C"]) -> tuple[float, float] | None:
    """Return the 95 % interval of mean(above) / mean(below), both of the same cases.

    None for fewer than `FEWEST_CASES`, and where the mean below is zero without some case.

    Args:
        above: numerators, one per case.
        below: denominators, one per case.
    """
    cases = len(above)
    if cases < FEWEST_CASES:
        return None
    rest = below.sum() - below
    if not (rest > 0).all():
        return None
    logarithmic = bool((above > 0).all())
    whole, without = above.sum() / below.sum(), (above.sum() - above) / rest
    if logarithmic:
        whole, without = np.log(whole), np.log(without)
    reach = _quantile(cases - 1) * np.sqrt(np.square(without - without.mean()).sum())
    low, high = whole - reach, whole + reach
    return (float(np.exp(low)), float(np.exp(high))) if logarithmic else (float(low), float(high))
