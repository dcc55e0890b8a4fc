"""Odds of directions as they are said: drawn to even ones by the start and by trouble, and held on new people."""

from typing import get_args

import numpy as np
import pytest

from hfb.fitting.confidence import StartKind
from hfb.fitting.direction_odds import shipped_odds
from hfb.fitting.direction_trust import (
    SIGNS,
    direction_condition,
    group_probability,
    power_of,
    shipped_trust,
    signs_of,
    temper,
    trusted,
)
from tests.fitting.test_alternatives import swinging

SOURCES: dict[StartKind, str] = {"simulated": "simulated", "network": "mediapipe", "matte": "matte"}


def features(kind: StartKind, trouble: float = 0.0, rows: int = 5) -> dict[str, np.ndarray]:
    """Those of a typical fit, or of one with so many spreads more of every sign of trouble."""
    trust = shipped_trust(kind)
    return {name: np.full((rows, 24), trust.typical[name] + trouble * trust.spread[name]) for name in SIGNS}


@pytest.mark.parametrize("kind", get_args(StartKind))
def test_what_is_said_is_drawn_to_even_odds(kind: StartKind) -> None:
    """Never surer than the evidence, most where the evidence is weak; the same motion stays the result."""
    for probability in ((0.35, 0.25, 0.22, 0.18), (0.5, 0.25, 0.15, 0.1), (0.9, 0.05, 0.03, 0.02)):
        raw = swinging(probability)
        said = trusted(raw, features(kind), [SOURCES[kind]])
        assert said.chosen == raw.chosen
        assert said.probability.sum() == pytest.approx(1)
        assert 0.5 <= said.body_right()[0] < raw.body_right()[0]
        assert np.abs(said.limb_right()[0] - 0.5).max() <= np.abs(raw.limb_right()[0] - 0.5).max()
    weak = trusted(swinging((0.35, 0.25, 0.22, 0.18)), features(kind), [SOURCES[kind]])
    assert weak.body_right()[0] < 0.56  # of 0.6
    sure = trusted(swinging((0.9, 0.05, 0.03, 0.02)), features(kind), [SOURCES[kind]])
    assert sure.body_right()[0] > 0.85  # of 0.95


@pytest.mark.parametrize("kind", get_args(StartKind))
def test_trouble_in_a_fit_makes_less_sure(kind: StartKind) -> None:
    raw = swinging((0.5, 0.25, 0.15, 0.1))
    well, badly = (trusted(raw, features(kind, trouble), [SOURCES[kind]]) for trouble in (-1, 2))
    assert badly.body_right()[0] < well.body_right()[0]
    assert shipped_trust(kind).discount(signs_of(features(kind, -99), slice(None))) == 0.0
    assert trusted(raw, features(kind, 99), [SOURCES[kind]]).body_right()[0] == pytest.approx(0.5)


def test_a_start_from_the_matte_alone_is_trusted_least() -> None:
    typical = {kind: shipped_trust(kind).constant for kind in get_args(StartKind)}
    assert typical["matte"] == max(typical.values())
    assert all(0.2 < doubt < 0.8 for doubt in typical.values())


def test_several_frames() -> None:
    """The frame that is trusted least counts; with nothing known each frame's direction is as likely as not."""
    raw = swinging((0.5, 0.25, 0.15, 0.1), frames=2)
    both = {name: np.concatenate([features("matte", 0)[name], features("matte", 1)[name]]) for name in SIGNS}
    worse = {name: np.concatenate([features("matte", 1)[name]] * 2) for name in SIGNS}
    said, other = (trusted(raw, one, ["matte", "matte"]) for one in (both, worse))
    np.testing.assert_allclose(said.probability, other.probability)
    agrees = np.array([[1, 0, 1, 0, 1, 1, 1], [1, 1, 0, 0, 1, 1, 1]], float)  # as found, each frame, both, three limbs
    known = np.array([0.3, 0.1, 0.15, 0.05, 0.2, 0.15, 0.05])
    np.testing.assert_allclose(agrees @ temper(known, group_probability(known, agrees), np.array(0.0)), 0.5)


def test_what_the_image_tells_of_limbs_is_kept() -> None:
    """With nothing known of the body, a limb's reversal that the image refutes is as unlikely as before."""
    known = np.array([0.4995, 0.0005, 0.4995, 0.0005])  # as fitted, a limb reversed; both backwards
    said = temper(known, group_probability(known, np.array([[1.0, 1, 0, 0]])), np.array(0.0))
    np.testing.assert_allclose(said, known, atol=1e-12)
    leaning = temper(np.array([0.6, 0.1, 0.2, 0.1]), np.array([0.7, 0.7, 0.3, 0.3]), np.array(0.0))
    np.testing.assert_allclose(leaning, [3 / 7, 0.5 / 7, 1 / 3, 1 / 6])


def test_the_power() -> None:
    right = np.array([0.9, 0.9, 0.1, 0.6, 0.5, np.nan])  # of NaN nothing is said
    doubt = np.array([0.0, np.log(9.0) / 2, np.log(9.0) / 2, 2.0, 0.0, 2.0])
    np.testing.assert_allclose(power_of(right, doubt), [1, 0.5, 0.5, 0, 0, 1], atol=1e-9)
    two = np.array([0.9, 0.1])
    np.testing.assert_allclose(temper(two, two, np.array(0.0)), 0.5)
    np.testing.assert_allclose(temper(two, two, np.array(1.0)), two)
    told = temper(two, two, np.asarray(power_of(np.array(0.9), np.array(np.log(3.0)))))
    np.testing.assert_allclose(told, [0.75, 0.25])  # of log odds log 9 the doubt log 3 is taken away


@pytest.mark.parametrize("kind", get_args(StartKind))
def test_what_was_said_happened_on_other_people(kind: StartKind) -> None:
    """In no group was less right than was said, beyond chance: of people left out in turn, and of new ones."""
    told = shipped_odds()["trust"][kind]
    assert told["people"] == ["09", "10", "13"]
    groups = list(told["people_held_out"])
    for new in (one for one in told["new_people"].values() if one is not None):
        assert not set(told["people"]) & set(new["people"])
        groups += [*new["body"], *new["limbs"]]
    assert sum(group["n"] for group in groups) >= 28
    for group in groups:
        assert group["high"] >= group["said"], group


def test_estimated_starts_were_counted_on_people_who_took_no_part_in_any_choice() -> None:
    for kind in ("network", "matte"):
        new = direction_condition([SOURCES[kind]])["new_people"][kind]
        assert new["n"] >= 30
        assert len(new["people"]) >= 7


def test_a_result_says_under_which_condition_its_odds_hold() -> None:
    told = direction_condition(["mediapipe", "mediapipe"])
    assert told["starts"] == ["network"]
    single = direction_condition(["matte"])
    assert "starts by the matte alone: said 5" in single["holds_for"]
    assert "real pictures were not part of it" in single["holds_for"]
    assert single["holds_for"] != direction_condition(["matte", "matte"])["holds_for"]
