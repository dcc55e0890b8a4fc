"""Eight and four numbers at a time: each sign and choice against numpy's."""

import numpy as np
import pytest
from numba import njit

from hfb.kernels.simd import (
    LANES,
    four,
    if_equal,
    if_less,
    insert_sorted,
    lane_numbers,
    lanes,
    last_lane,
    last_of,
    load_four,
    load_lanes,
    positive_part,
    smaller,
    store_lanes,
    sum_lanes,
    sum_three,
    widen_four,
    with_last,
)

LEFT = np.array([0.0, -1.0, 2.5, 3.0, np.nan, np.inf, -0.0, 7.0])
RIGHT = np.array([1.0, -1.0, 2.0, np.nan, 4.0, np.inf, 0.0, 8.0])
OPERATIONS = 10


@njit
def everything(left, right, results):
    a, b = load_lanes(left, 0), load_lanes(right, 0)
    values = (
        a + b,
        a - b,
        a * b,
        2.0 * a + (b - 1.0),
        if_less(a, b, a, 5.0),
        if_equal(a, b, 1.0, b),
        smaller(a, b),
        lane_numbers(),
        lanes(3.5),
        lanes(7),
    )
    for number, value in enumerate(values):
        store_lanes(results, number * LANES, value)
    return sum_lanes(lane_numbers() * lane_numbers())


def test_lanes_do_what_numpy_does() -> None:
    results = np.empty(OPERATIONS * LANES)
    total = everything(LEFT, RIGHT, results)
    with np.errstate(invalid="ignore"):  # infinity from infinity
        difference = LEFT - RIGHT
    expected = [
        LEFT + RIGHT,
        difference,
        LEFT * RIGHT,
        2 * LEFT + (RIGHT - 1),
        np.where(LEFT < RIGHT, LEFT, 5.0),
        np.where(LEFT == RIGHT, 1.0, RIGHT),
        np.where(LEFT < RIGHT, LEFT, RIGHT),
        np.arange(8.0),
        np.full(8, 3.5),
        np.full(8, 7.0),
    ]
    np.testing.assert_array_equal(results.reshape(OPERATIONS, LANES), expected)
    assert total == (np.arange(8.0) ** 2).sum()


@njit
def shifted(numbers, results):
    for at in range(0, results.shape[0], LANES):
        store_lanes(results, at, load_lanes(numbers, at + 1))


def test_lanes_are_read_and_written_from_any_number_on() -> None:
    numbers, results = np.arange(1.0 + 3 * LANES), np.zeros(3 * LANES)
    shifted(numbers, results)
    np.testing.assert_array_equal(results, numbers[1:])


@njit
def everything_with_four(left, right, number, results, wide):
    a, b = load_four(left, 1), load_four(right, 4)
    values = (a + b, a - b, a * b, number * a - (b - number), with_last(a, number), positive_part(a))
    for place, value in enumerate(values):
        store_lanes(results, 4 * place, value)
    store_lanes(wide, 0, widen_four(b) + four(0.1))
    return sum_three(a), last_of(b)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_four_lanes_do_what_numpy_does(dtype: type) -> None:
    left, right, number = LEFT.astype(dtype), np.array([*range(5), 0.3, -2.0, 5.0], dtype), dtype(1.7)
    results, wide = np.zeros((6, 4), dtype), np.zeros(4)
    total, last = everything_with_four(left, right, number, results, wide)
    a, b = left[1:5], right[4:]
    positive = np.where(a > 0, a, 0)  # of what is not a number, too, zero
    expected = [a + b, a - b, a * b, number * a - (b - number), np.append(a[:3], number), positive]
    np.testing.assert_array_equal(results, np.array(expected, dtype))
    np.testing.assert_array_equal(wide, b.astype(np.float64) + 0.1)
    assert total == left[1] + left[2] + left[3]
    assert last == right[7]


@njit
def insert_all(numbers, largest, fallen):
    held = lanes(largest)
    for n in range(numbers.shape[0]):
        fallen[n] = max(last_lane(held), numbers[n])
        held = insert_sorted(held, numbers[n])
    result = np.empty(LANES)
    store_lanes(result, 0, held)
    return result


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 30])
def test_the_smallest_numbers_stay_sorted_and_the_others_fall_out(count: int) -> None:
    """Equal ones among them; what falls out is the largest of all that were there."""
    numbers = np.random.default_rng(count).integers(0, 12, count) / 12
    fallen = np.empty(count)
    found = insert_all(numbers, 1.0, fallen)
    everything = np.sort(np.append(numbers, np.ones(LANES)))
    np.testing.assert_array_equal(found, everything[:LANES])
    np.testing.assert_array_equal(np.sort(fallen), everything[LANES:])
