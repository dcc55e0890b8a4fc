"""What the tests' type checks refuse."""

from collections.abc import Callable
from typing import Any, Literal

import jaxtyping
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from hfb.typing import Array, Float
from tests.typechecking import checked

ZEROS = np.zeros


@jaxtyping.jaxtyped(typechecker=checked)
def rows(points: Float[Array, "N 3"], weights: Float[Array, "N"], kind: Literal["x", "y"] = "x") -> Float[Array, "N"]:
    return weights if points.any() or kind == "x" else weights[1:]


@jaxtyping.jaxtyped(typechecker=checked)
def many(parts: list[Float[Array, "_ 3"]], count: int = 1) -> Float[Array, "{count}"]:
    return ZEROS(min(count, 3))


@jaxtyping.jaxtyped(typechecker=checked)
def any_number(parts: tuple[Float[Array, "_ 3"], ...]) -> int:
    return len(parts)


def often(function: Callable[[Any], object], given: Any) -> None:
    """A check looks at one of several items, by chance."""
    for _ in range(100):
        function(given)


@pytest.mark.parametrize(
    ("points", "weights", "kind"),
    [
        (ZEROS((4, 3)), ZEROS(5), "x"),
        (ZEROS((4, 2)), ZEROS(4), "x"),
        (ZEROS((4, 3), dtype=int), ZEROS(4), "x"),
        (ZEROS((4, 3)), ZEROS(4), "z"),
        (ZEROS((4, 3)), [0.0] * 4, "x"),
        (ZEROS((4, 3)), ZEROS(4), "y"),  # what is returned has one row less
    ],
)
def test_what_is_wrong_is_refused(points: Any, weights: Any, kind: Any) -> None:
    rows(ZEROS((4, 3)), ZEROS(4))
    rows(np.ones((4, 3)), weights=ZEROS(4), kind="y")
    with pytest.raises(TypeCheckError):
        rows(points, weights, kind)


def test_lengths_that_are_told_by_numbers() -> None:
    for count in (1, 2, 3):
        many([ZEROS((2, 3))], count)
    with pytest.raises(TypeCheckError):
        many([ZEROS((2, 3))], 4)


def test_one_bad_item_among_good_ones() -> None:
    good, bad = ZEROS((2, 3)), ZEROS((2, 4))
    many([good, good])
    any_number((good, good))
    for function, given in ((many, [good, bad]), (any_number, (good, bad)), (many, [good] * 20 + [bad])):
        with pytest.raises(TypeCheckError):
            often(function, given)
