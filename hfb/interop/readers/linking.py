"""People without names: a person is who lies nearest to where they lay in the frames before."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from scipy.optimize import linear_sum_assignment

from hfb.errors import InputError
from hfb.typing import Array, Float

_MOST_STEPS = 3
"""Over how many frames the way grows that somebody may have gone."""
_REMEMBERED, _MOST_IN_FRAME = 5, 128
"""After so many given frames without them people are new; more in a frame are not told apart."""


@runtime_checkable
class Seen(Protocol):
    """Somebody in a frame."""

    @property
    def number(self) -> int:
        """Of the frame."""
        ...


SeenT = TypeVar("SeenT", bound=Seen)


def linked(seen: Sequence[SeenT], ways: Callable[[list[SeenT], list[SeenT]], Float[Array, "b n"]]) -> list[list[SeenT]]:
    """Group rows by person, in the order of appearance. The order within a frame has no meaning.

    Args:
        seen: a row per person and frame.
        ways: between the people of two frames, 1 being as far as somebody goes from one frame to the next.

    Raises:
        InputError: a frame has more people than can be told apart.
    """
    frames: dict[int, list[SeenT]] = defaultdict(list)
    for one in seen:
        frames[one.number].append(one)
    if len(frames) > 1 and max(map(len, frames.values())) > _MOST_IN_FRAME:
        raise InputError(f"it holds more than {_MOST_IN_FRAME} people in a frame")
    people: list[list[SeenT]] = []
    recent: list[set[int]] = []
    for number in sorted(frames):
        known = sorted(set().union(*recent[-_REMEMBERED:]))
        follows = _followed([people[person][-1] for person in known], frames[number], ways)
        recent.append(set())
        for at, one in enumerate(frames[number]):
            person = known[follows[at]] if at in follows else len(people)
            if person == len(people):
                people.append([])
            people[person].append(one)
            recent[-1].add(person)
    return people


def _followed(
    before: list[SeenT], now: list[SeenT], ways: Callable[[list[SeenT], list[SeenT]], Float[Array, "b n"]]
) -> dict[int, int]:
    """Whom of `before` those of `now` continue, by their places in the lists."""
    if not before:
        return {}
    steps = np.array([min(now[0].number - one.number, _MOST_STEPS) for one in before], np.float64)
    cost = ways(before, now) / steps[:, None]
    cost = np.where(np.isfinite(cost), cost, np.inf)
    pairs = zip(*linear_sum_assignment(np.minimum(cost, 1)), strict=True)
    return {int(new): int(old) for old, new in pairs if cost[old, new] < 1}
