"""The deal of cases to blur-rate intervals, and the blur rate itself."""

from itertools import pairwise

import numpy as np
import pytest

from hfb.datasets.blur_bins import (
    BLUR_BINS,
    PAIR_COUNTS,
    SINGLE_COUNTS,
    bin_of_case,
    bins_of,
    wanted_interval,
)
from hfb.datasets.blur_rates import blur_rates
from hfb.evaluation.metrics import blur_rate


def test_the_papers_tables() -> None:
    assert sum(SINGLE_COUNTS) == 1124
    assert sum(PAIR_COUNTS) == 305
    for bins in (BLUR_BINS, bins_of("bc-cape", 1), bins_of("bc-cape", 4)):
        assert bins[0][0] == 0.05
        assert all(before[1] == after[0] for before, after in pairwise(bins))


@pytest.mark.parametrize("counts", [SINGLE_COUNTS, PAIR_COUNTS, (1, 1, 1), (5, 1)])
def test_every_beginning_is_proportional(counts: tuple[int, ...]) -> None:
    total, dealt = sum(counts), np.zeros(len(counts))
    for number in range(1, 2 * min(total, 400) + 1):
        dealt[bin_of_case(number, counts)] += 1
        assert np.abs(dealt - number * np.array(counts) / total).max() < 1.5
    if 2 * min(total, 400) == 2 * total:
        assert dealt.tolist() == [2 * count for count in counts]


def test_even_means_in_turn() -> None:
    assert [wanted_interval("bt-amass", 1, "even", number) for number in range(1, 21)] == [*BLUR_BINS, *BLUR_BINS]
    assert [wanted_interval("bc-cape", 4, "paper", number) for number in range(1, 7)] == list(bins_of("bc-cape", 4))
    assert wanted_interval("bc-cape", 1, "natural", 3) == (0.05, 0.8)


def test_blur_rates_are_the_protocols() -> None:
    silhouettes = np.random.default_rng(0).random((3, 5, 8, 9)) > 0.6
    expected = [blur_rate(frame.astype(np.float32)) for frame in silhouettes]
    np.testing.assert_allclose(blur_rates(silhouettes), expected)
    one = np.zeros((1, 3, 4, 4), bool)
    one[0, 0, 0, :2] = one[0, 1, 0, 2] = True  # by hand: two pixels, then a third
    assert blur_rates(one).tolist() == [0.5]
    assert blur_rates(np.zeros((1, 2, 3, 3), bool)).tolist() == [0]
