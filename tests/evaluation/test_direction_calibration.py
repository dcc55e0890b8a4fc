"""How far odds of directions can be trusted is found from what was right, and how often they held is counted."""

from collections.abc import Sequence

import numpy as np
import pytest

from hfb.evaluation.direction_calibration import (
    DirectionEvent,
    direction_events,
    fit_trust,
    reliability_groups,
    said_and_right,
    wilson_ci95,
)
from hfb.fitting.direction_trust import SIGNS
from tests.fitting.test_alternatives import ARM, swinging


def events(doubt: float, trouble: float = 0.0, count: int = 1500) -> list[DirectionEvent]:
    """The truth follows the odds, once a doubt is taken from them; the first sign of trouble adds to it."""
    rng, found = np.random.default_rng(0), []
    for number in range(count):
        said, sign = rng.uniform(0.5, 0.98), rng.normal()
        log_odds = max(0.0, np.log(said / (1 - said)) - max(0.0, doubt + trouble * sign))
        right = bool(rng.random() < 1 / (1 + np.exp(-log_odds)))
        odds, signs = np.array([said, 1 - said]), dict(zip(SIGNS, (sign, 0.0, 0.0), strict=True))
        found.append(DirectionEvent(str(number), odds, odds, np.array([1.0, 0.0]), right, True, said, signs))
    return found


def test_the_doubt_is_found() -> None:
    told = fit_trust({"simulated": events(0.2), "network": events(0.7), "matte": events(1.2)})
    doubts = {kind: trust.constant for kind, trust in told.items()}
    assert doubts["simulated"] == pytest.approx(0.2, abs=0.15)
    assert doubts["network"] == pytest.approx(0.7, abs=0.15)
    assert doubts["matte"] == pytest.approx(1.2, abs=0.2)
    said, right = said_and_right(events(1.2), told["matte"])
    for group in reliability_groups(said, right):
        assert group["low"] <= group["said"] + 0.02
        assert group["said"] - 0.02 <= group["high"]


def test_what_a_sign_of_trouble_says_is_found() -> None:
    trust = fit_trust({"network": events(0.6, trouble=0.4)})["network"]
    assert trust.coefficients[SIGNS[0]] == pytest.approx(0.4, abs=0.15)
    assert all(trust.coefficients[name] < 0.1 for name in SIGNS[1:])


def test_few_cases_leave_what_was_known_before() -> None:
    """A kind of which nearly nothing is known stays near the common doubt, however lucky its few cases were."""
    lucky = [event for event in events(0.7, count=30) if event.right][:4]
    trust = fit_trust({"network": events(0.7), "matte": lucky})
    assert trust["matte"].constant == pytest.approx(trust["network"].constant, abs=0.15)
    alone = fit_trust({"matte": lucky})["matte"]
    assert alone.constant == pytest.approx(0.73, abs=0.15)


@pytest.mark.parametrize(
    ("turned", "right"), [((), (True, True)), (("all",), (False, False)), (("arm",), (True, False))]
)
def test_the_questions_of_a_fit(turned: Sequence[str], right: tuple[bool, bool]) -> None:
    """About the body and each limb, of a truth that lies elsewhere in the scene."""
    found = swinging((0.4, 0.3, 0.2, 0.1))
    motions = {(): 0, ("arm",): 1, ("all",): 2}
    true = found.joints[motions[tuple(turned)]] + np.array([0.3, 0, 2.0])
    features = {name: np.zeros((5, 24)) for name in SIGNS}
    asked = list(direction_events("someone", found, features, true))
    (body,) = (event for event in asked if event.whole)
    limbs = [event for event in asked if not event.whole]
    assert len(limbs) == 5
    assert (body.right, limbs[ARM].right) == right
    assert said_and_right([body, limbs[ARM]], None)[0] == pytest.approx([0.7, 0.5])


def test_groups_and_their_intervals() -> None:
    """Wilson's interval of 8 in 10, as textbooks have it."""
    assert wilson_ci95(8, 10) == (0.49, 0.943)
    assert wilson_ci95(0, 10) == (0.0, 0.278)
    said = np.array([0.52, 0.58, 0.75, 0.8, 1.0])
    right = np.array([True, False, True, True, True])
    groups = reliability_groups(said, right, (0.0, 0.6, 0.8, 1.0))
    assert [(group["n"], group["right"]) for group in groups] == [(2, 0.5), (1, 1.0), (2, 1.0)]
    assert groups[0]["said"] == pytest.approx(0.55)
