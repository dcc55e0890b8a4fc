"""The radius of a joint: its law, its model and its features."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hfb.body.skeleton import JOINT_NAMES
from hfb.config import DirectionsConfig
from hfb.fitting.confidence import (
    ConfidenceModel,
    StartKind,
    radius_condition,
    radius_factor,
    shipped_confidence,
    shipped_radius_mm,
    start_kind,
)
from hfb.fitting.directions import search_directions
from hfb.fitting.joint_features import joint_features
from hfb.motion.sampled import SampledMotion, sample_motion
from tests.fitting.scenes import Done, done


@given(st.floats(0.001, 0.999), st.floats(0.3, 5))
def test_the_law(probability: float, exponent: float) -> None:
    factor = radius_factor(probability, exponent)
    assert 1 - 2 ** -(factor**exponent) == pytest.approx(probability, abs=1e-9)
    assert radius_factor(0.5, exponent) == pytest.approx(1)


def test_the_radius_is_log_linear_and_zero_at_the_pelvis() -> None:
    model = ConfidenceModel({"reach": 2.0, "network": 1.0}, 3.0, 1.5, {"reach": 0.1, "network": 0.5})
    reach = np.full((4, 24), 0.25)
    both = model.radius_mm({"reach": reach, "network": np.full((4, 24), 1.0), "more": reach})
    assert both[:, 0].max() == 0
    np.testing.assert_allclose(both[:, 1:], np.exp(3 + 0.5 + 1))
    # what a fit does not know is taken to be as usual
    np.testing.assert_allclose(model.radius_mm({"reach": reach})[:, 1:], np.exp(3 + 0.5 + 0.5))


def test_the_shipped_model_knows_its_features_and_says_something_sensible() -> None:
    model, features = shipped_confidence(), _features(done())[1]
    assert set(model.coefficients) - {"network"} <= set(features)
    radius = model.radius_mm(features)
    assert radius.shape == (6, 24)
    assert np.isfinite(radius).all()
    assert radius[:, 1:].min() > 2
    assert radius.max() < 500
    wrist, hip = JOINT_NAMES.index("left_wrist"), JOINT_NAMES.index("left_hip")
    assert (radius[:, wrist] > 1.5 * radius[:, hip]).all()


def test_features_say_what_their_names_say() -> None:
    case = done()
    motion, features = _features(case)
    assert all(table.shape == (6, 24) and np.isfinite(table).all() for table in features.values())
    name = JOINT_NAMES.index
    reach, moved = np.exp(features["reach"]) - 0.02, np.exp(features["motion"]) - 0.02
    assert reach[0, 0] == pytest.approx(0, abs=1e-9)
    assert reach[0, name("left_hip")] < reach[0, name("left_knee")] < reach[0, name("left_ankle")]
    steps = np.linalg.norm(np.diff(motion.joints[:, 20] - motion.joints[:, 0], axis=0), axis=-1).sum()
    assert moved[0, 20] == pytest.approx(steps, rel=1e-6)
    assert moved[0, name("left_knee")] < 0.01 < 0.2 < moved[0, 20]  # about the pelvis only the arms move
    np.testing.assert_allclose(features["edge"][:, 5], [1, 0.6, 0.2, 0.2, 0.6, 1], atol=1e-6)
    assert 0.2 < features["hidden"].mean() < 0.9  # one side of a body is seen
    worse = replace(
        case.coarse, observation=replace(case.coarse.observation, mattes=case.coarse.observation.mattes / 2)
    )
    assert _features(replace(case, coarse=worse))[1]["misfit"].mean() > features["misfit"].mean()


def _features(case: Done) -> tuple[SampledMotion, dict[str, np.ndarray]]:
    search = DirectionsConfig(search=True, iterations=1, polish=0, refits=1)
    trajectory, alternatives = search_directions(case.found, case.coarse, case.fine, search)
    found, seen = replace(case.found, trajectory=trajectory), case.scene.observation
    motion = sample_motion(
        trajectory,
        case.fine.body.shape(found.betas),
        found.betas,
        6,
        seen.exposure_s,
        seen.interval_s,
        seen.camera.matrix(),
    )
    return motion, joint_features(
        motion, alternatives, found, first_bodies=case.scene.middle, coarse=case.coarse, height_told=False
    )


def test_radii_follow_the_kind_of_start_frame_by_frame() -> None:
    """A typical joint of a fit from an estimated start errs half as much again as one from a simulated start."""
    features = _features(done())[1]
    index = np.array([0, 0, 0, 1, 1, 1])
    both = shipped_radius_mm(features, index, ["simulated", "mediapipe"])
    alone = {kind: shipped_confidence(kind).radius_mm(features) for kind in get_args(StartKind)}
    np.testing.assert_array_equal(both[:3], alone["simulated"][:3])
    np.testing.assert_array_equal(both[3:], alone["network"][3:])
    models = {kind: shipped_confidence(kind) for kind in get_args(StartKind)}
    typical = {
        kind: model.radius_mm({name: np.full((1, 24), value) for name, value in model.typical.items()})[0, 1]
        for kind, model in models.items()
    }
    assert min(typical["network"], typical["matte"]) > 1.5 * typical["simulated"]
    assert [start_kind(name) for name in ("matte", "mediapipe", "WHAM", "between", "metro", "simulated")] == [
        "matte",
        "network",
        "network",
        "network",
        "network",
        "simulated",
    ]


@pytest.mark.parametrize("kind", get_args(StartKind))
def test_what_was_said_happened_on_people_left_out(kind: StartKind) -> None:
    """Of people whom no network had seen; those on whom each figure was counted were not calibrated on."""
    measured = radius_condition(["mediapipe" if kind == "network" else kind])["people_held_out"][kind]
    assert len(measured["people"]) >= 3
    assert measured["n"] >= 30
    for level in (0.25, 0.5, 0.75, 0.9):
        assert measured[f"within_p{100 * level:.0f}"] == pytest.approx(level, abs=0.1)


def test_radii_held_on_people_who_took_no_part_in_any_choice() -> None:
    """From estimated starts no radius held less than it said; they are wide for walks, which most of these are."""
    told = radius_condition(["mediapipe", "matte"])["new_people"]
    for kind in ("network", "matte"):
        assert told[kind]["n"] >= 30
        assert not set(told[kind]["people"]) & {"09", "10", "13"}
        for level in (0.25, 0.5, 0.75, 0.9):
            assert level - 0.05 <= told[kind][f"within_p{100 * level:.0f}"]
        assert told[kind]["within_p90"] < 0.97


def test_a_result_says_under_which_condition_its_radii_hold() -> None:
    told = radius_condition(["mediapipe", "matte", "mediapipe"])
    assert told["starts"] == ["matte", "network"]
    assert "a pose network" in told["holds_for"]
    assert "Real pictures were not part of it" in told["holds_for"]
    assert "not calibrated" not in told["holds_for"]
    assert "Starts by WHAM were not calibrated" in radius_condition(["WHAM"])["holds_for"]
