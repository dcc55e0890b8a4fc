"""Linking of people without names by their distance between neighbouring frames."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from hfb.errors import InputError
from hfb.typing import Array, Float

_MOST_STEPS = 3
"""Number of frames over which a person's possible distance grows."""
_REMEMBERED, _MOST_IN_FRAME = 5, 128
"""Number of frames after which a person counts as new; and the largest number of people in a frame."""
_PELVIS_REACH_M = 1.0
"""Largest distance that a pelvis moves from one frame to the next."""


@runtime_checkable
class Seen(Protocol):
    """A person in a frame."""

    @property
    def number(self) -> int:
        """Of the frame."""
        ...


SeenT = TypeVar("SeenT", bound=Seen)
Ways = Callable[[list[SeenT], list[SeenT]], Float[Array, "b n"]]


def linked(seen: Sequence[SeenT], ways: Ways[SeenT]) -> list[list[SeenT]]:
    """Group rows by person, in the order of appearance. The order within a frame has no meaning.

    Args:
        seen: a row per person and frame.
        ways: returns distances between the people of two frames, 1 being a person's largest step between frames.

    Raises:
        InputError: a frame has too many people.
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


def pelvis_ways(pelvis: Callable[[SeenT], Float[Array, "3"]]) -> Ways[SeenT]:
    """Return what gives distances between pelvises, as `linked` takes it.

    Args:
        pelvis: returns a person's pelvis [m].
    """
    return lambda before, now: cdist(*([pelvis(one) for one in frame] for frame in (before, now))) / _PELVIS_REACH_M


def _followed(before: list[SeenT], now: list[SeenT], ways: Ways[SeenT]) -> dict[int, int]:
    """Match the people of `now` with those of `before`, by their places in the lists."""
    if not before:
        return {}
    steps = np.array([min(now[0].number - one.number, _MOST_STEPS) for one in before], np.float64)
    cost = ways(before, now) / steps[:, None]
    cost = np.where(np.isfinite(cost), cost, np.inf)
    pairs = zip(*linear_sum_assignment(np.minimum(cost, 1)), strict=True)
    return {int(new): int(old) for old, new in pairs if cost[old, new] < 1}
