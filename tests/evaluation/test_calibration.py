"""Calibration: coefficients that made the errors are found again, and held-out figures are honest."""

import numpy as np
import pytest

from hfb.evaluation.calibration import (
    DirectionCase,
    JointCase,
    fit_confidence,
    fit_direction_odds,
    held_out_reliability,
)
from hfb.fitting.direction_odds import EVIDENCE

EXPONENT, CONSTANT, SLOPES = 1.6, 5.0, {"reach": 0.8, "motion": 0.4}


def joint_cases(count: int = 60, seed: int = 0) -> list[JointCase]:
    rng = np.random.default_rng(seed)
    cases = []
    for number in range(count):
        features = {name: rng.normal(-1, 1, (8, 24)) for name in SLOPES} | {"noise": rng.normal(0, 1, (8, 24))}
        radius = np.exp(CONSTANT + sum(slope * features[name] for name, slope in SLOPES.items()))
        errors = radius * np.log2(1 / rng.uniform(size=(8, 24))) ** (1 / EXPONENT)
        cases.append(JointCase(f"clip {number % 12}", features, errors))
    return cases


def test_the_coefficients_that_made_the_errors_are_found() -> None:
    model = fit_confidence(joint_cases(), ["reach", "motion", "noise"])
    assert model.exponent == pytest.approx(EXPONENT, rel=0.05)
    assert model.constant == pytest.approx(CONSTANT, abs=0.1)
    assert model.coefficients["reach"] == pytest.approx(0.8, abs=0.05)
    assert model.coefficients["motion"] == pytest.approx(0.4, abs=0.05)
    assert model.coefficients["noise"] == pytest.approx(0, abs=0.05)
    assert model.typical["reach"] == pytest.approx(-1, abs=0.1)


def test_radii_on_recordings_left_out_are_honest_and_rank_the_errors() -> None:
    measured = held_out_reliability(joint_cases(), list(SLOPES))
    assert measured["within_p50"] == pytest.approx(0.5, abs=0.03)
    assert measured["within_p90"] == pytest.approx(0.9, abs=0.03)
    assert measured["off"] < 0.02
    assert measured["rank"] > 0.5
    assert abs(held_out_reliability(joint_cases(), ["noise"])["rank"]) < 0.1


def test_the_order_of_the_cases_does_not_matter() -> None:
    cases = joint_cases(20)
    one, other = fit_confidence(cases, list(SLOPES)), fit_confidence(cases[::-1], list(SLOPES))
    assert one.constant == pytest.approx(other.constant, rel=1e-4)
    assert one.exponent == pytest.approx(other.exponent, rel=1e-4)


def direction_cases(body: float, excess: float, count: int = 80) -> list[DirectionCase]:
    """The truth is drawn from the odds: who is likelier is nearer to it."""
    rng = np.random.default_rng(0)
    cases = []
    for number in range(count):
        extra = np.concatenate([[0], rng.uniform(0, 0.5, 4)])
        arrow = rng.normal(0, 2)
        evidence = np.zeros((10, len(EVIDENCE)))
        evidence[:, 0], evidence[:5, 2], evidence[5:, 2] = np.tile(extra, 2), max(arrow, 0), max(-arrow, 0)
        exponent = -(evidence[:, :3] @ [excess, 0, body])
        right = rng.choice(10, p=np.exp(exponent) / np.exp(exponent).sum())
        errors = np.full(10, 60.0)
        errors[right] = 40.0
        cases.append(DirectionCase(f"clip {number}", 1, evidence, errors))
    return cases


def test_odds_follow_what_was_right() -> None:
    found = fit_direction_odds(direction_cases(body=1.0, excess=8.0))
    assert found.keys() == set(EVIDENCE)
    assert found["body_backwards"] == pytest.approx(1.0, abs=0.5)
    assert found["excess"] > 2
    assert found["limbs_backwards"] >= 0
    useless = fit_direction_odds(direction_cases(body=0.0, excess=0.0))
    assert useless["body_backwards"] < 0.3
    assert useless["excess"] < found["excess"] / 2


def test_several_frames_are_judged_by_the_pictures_alone() -> None:
    cases = [DirectionCase(c.recording, 2, c.evidence[:5], c.errors_mm[:5]) for c in direction_cases(1.0, 8.0)]
    found = fit_direction_odds(cases)
    assert found["body_backwards"] == found["limbs_backwards"] == found["network_backwards"] == 0
