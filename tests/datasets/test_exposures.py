"""Clocks of synthetic cases."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hfb.datasets.synthetic.exposures import shutter_of


@given(
    name=st.sampled_from(["bt-amass", "bc-cape"]),
    position=st.floats(0, 1),
    start_s=st.floats(0, 20),
    gap=st.one_of(st.just(0.0), st.floats(0, 0.25)),
    frames=st.integers(1, 4),
    motion_px=st.floats(0, 500),
)
def test_every_clock_is_possible(
    name: str, position: float, start_s: float, gap: float, frames: int, motion_px: float
) -> None:
    shutter = shutter_of(name)
    exposure = int(position * (len(shutter.exposures_s) - 1))
    clock = shutter.clock(exposure, start_s, gap, frames, motion_px)
    assert clock.exposure_s <= clock.interval_s <= 1.2501 * clock.exposure_s
    assert 1 / clock.fps == clock.interval_s  # what clip.toml says is what happened
    assert 36 <= clock.instants <= 71
    assert (clock.instants - 1) % 7 == 0
    times = clock.times_s()
    assert len(times) == frames * clock.instants
    assert times[0] == clock.start_s <= start_s
    if shutter.grid_hz is not None:
        np.testing.assert_allclose(times * 600, np.round(times * 600), atol=1e-6)
    if name == "bt-amass" and motion_px <= 140:
        assert motion_px / (clock.instants - 1) <= 2


def test_exposures_are_the_papers() -> None:
    amass = np.array(shutter_of("bt-amass").exposures_s) * 120
    np.testing.assert_allclose(amass, np.arange(5, 61))
    cape = np.array(shutter_of("bc-cape").exposures_s) * 600
    np.testing.assert_allclose(cape % 7, 0, atol=1e-9)
    assert 0.05 < cape[0] / 600 < cape[-1] / 600 < 0.5


@pytest.mark.parametrize("name", ["bt-amass", "bc-cape"])
def test_the_nearest_exposure_is_nearest_by_ratio(name: str) -> None:
    shutter = shutter_of(name)  # type: ignore[arg-type]
    for wanted in (0.01, 0.06, 0.11, 0.3, 2.0):
        chosen = shutter.exposures_s[shutter.nearest(wanted)]
        best = min(shutter.exposures_s, key=lambda length: abs(math.log(length / wanted)))
        assert chosen == pytest.approx(best)
