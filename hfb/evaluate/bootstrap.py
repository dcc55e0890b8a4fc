"""How sure a mean over cases is: the percentile bootstrap (Efron 1979), cases drawn with replacement.

The case is what is drawn, never the sub-frame or the joint: errors within a case are not independent. Equal seeds and
equal numbers of cases draw the same cases, so two methods on the same cases are resampled together.
"""

from collections.abc import Iterator

import numpy as np

from hfb.shapes import Array, Float, Int

RESAMPLES = 2000
_DRAWS_AT_ONCE = 4_000_000
_PERCENTILES = (2.5, 97.5)


def mean_ci95(values: Float[Array, "C"], seed: int) -> tuple[float, float] | None:
    """95 % interval of the mean over the cases; None for fewer than two cases."""
    return ratio_ci95(values, np.ones_like(values), seed)


def ratio_ci95(above: Float[Array, "C"], below: Float[Array, "C"], seed: int) -> tuple[float, float] | None:
    """95 % interval of mean(above) / mean(below), both of the same cases.

    None for fewer than two cases, and where some draw of cases has a mean below of zero.
    """
    if len(above) < 2:
        return None
    drawn = [(above[cases].mean(1), below[cases].mean(1)) for cases in _draws(len(above), seed)]
    numerators, denominators = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    if not (denominators > 0).all():
        return None
    low, high = np.percentile(numerators / denominators, _PERCENTILES)
    return float(low), float(high)


def _draws(cases: int, seed: int) -> Iterator[Int[Array, "R C"]]:
    """`RESAMPLES` rows of case indices, in parts of bounded size."""
    rng = np.random.default_rng(seed)
    rows = max(1, min(RESAMPLES, _DRAWS_AT_ONCE // cases))
    for first in range(0, RESAMPLES, rows):
        yield rng.integers(0, cases, size=(min(rows, RESAMPLES - first), cases))
