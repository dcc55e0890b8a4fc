"""The blur-rate intervals of the paper's tables, and the distribution of cases over them. Light to import."""

from collections.abc import Sequence
from typing import Literal

Interval = tuple[float, float]
SetName = Literal["bt-amass", "bc-cape", "b-aist", "real"]

BLUR_BINS: tuple[Interval, ...] = (
    (0.05, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5),
    (0.5, 0.6), (0.6, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 1.1),
)  # fmt: skip
"""BT-AMASS, tables 1 and 2."""

SINGLE_COUNTS: tuple[int, ...] = (123, 206, 154, 139, 106, 108, 81, 79, 76, 52)
"""Images per interval in table 1."""

PAIR_COUNTS: tuple[int, ...] = (35, 39, 47, 42, 38, 32, 25, 19, 13, 15)
"""Videos per interval in table 2."""

CAPE_SINGLE_BINS: tuple[Interval, ...] = ((0.05, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5), (0.5, 0.6), (0.6, 0.8))
"""BC-CAPE, table 3; its first interval reads "< 0.2", of which the motionless end is left out."""

CAPE_MULTI_BINS: tuple[Interval, ...] = ((0.05, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5), (0.5, 0.7), (0.7, 0.9))
"""BC-CAPE with several frames, table 4."""

REAL_BINS: tuple[Interval, ...] = ((0.0, 0.05), (0.05, 0.15), (0.15, 0.3), (0.3, 0.5), (0.5, 0.8), (0.8, 1.3))
"""Real video, sharp frames among it: a few recordings fill no ten intervals."""


def bins_of(name: SetName, frames: int) -> tuple[Interval, ...]:
    """Return the intervals by which a set is sorted.

    Args:
        name: name of the set.
        frames: blurred frames per case.
    """
    if name == "real":
        return REAL_BINS
    if name != "bc-cape":
        return BLUR_BINS
    return CAPE_SINGLE_BINS if frames == 1 else CAPE_MULTI_BINS


def paper_counts(name: Literal["bt-amass", "bc-cape"], frames: int) -> tuple[int, ...]:
    """Return the paper's cases per interval; it gives none for BC-CAPE: equally many there.

    Args:
        name: name of the set.
        frames: blurred frames per case.
    """
    if name == "bt-amass":
        return SINGLE_COUNTS if frames == 1 else PAIR_COUNTS
    return (1,) * len(bins_of(name, frames))


def bin_of_case(number: int, counts: Sequence[int]) -> int:
    """Return the interval of case ``number`` (from 1) where cases are dealt in the proportion of the counts.

    Each goes to the interval that lacks most so far, so every beginning of a set is proportional to within about one
    case per interval, and does not depend on how many follow.

    Args:
        number: number of the case, from 1.
        counts: proportion of the intervals.
    """
    total, dealt, chosen = sum(counts), [0] * len(counts), 0
    # After sum(counts) cases everything is dealt exactly, and the deal begins anew.
    for position in range(1, (number - 1) % total + 2):
        lacking = [position * count - total * got for count, got in zip(counts, dealt, strict=True)]
        chosen = lacking.index(max(lacking))
        dealt[chosen] += 1
    return chosen


def wanted_interval(
    name: Literal["bt-amass", "bc-cape"], frames: int, fill: Literal["paper", "even", "natural"], number: int
) -> Interval:
    """Return the blur rates that case ``number`` may have; the whole range of the set for ``"natural"``.

    Args:
        name: name of the set.
        frames: blurred frames per case.
        fill: proportions of the intervals: the paper's, even, or whatever the motions give.
        number: number of the case, from 1.
    """
    bins = bins_of(name, frames)
    if fill == "natural":
        return bins[0][0], bins[-1][1]
    counts = paper_counts(name, frames) if fill == "paper" else (1,) * len(bins)
    return bins[bin_of_case(number, counts)]
