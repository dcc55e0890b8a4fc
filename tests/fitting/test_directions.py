"""The search for directions: finds what was turned, changes nothing without a reason, and says what it cannot know."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.config import DirectionsConfig
from hfb.evaluation.metrics import mpjpe_mm
from hfb.fitting.alternatives import LIMB_NAMES
from hfb.fitting.direction_odds import EVIDENCE, probabilities
from hfb.fitting.directions import search_directions
from hfb.priors.motion_prior import load_motion_prior
from tests.fitting.scenes import LIMB, done, true_evidence, true_joints

SEARCH = DirectionsConfig(search=True, iterations=4, polish=2)


def test_without_a_prior_time_has_no_arrow_and_the_fit_stays() -> None:
    case = done()
    trajectory, found = search_directions(case.found, case.coarse, case.fine, SEARCH)
    half = len(found.probability) // 2
    np.testing.assert_allclose(found.probability[:half], found.probability[half:], rtol=1e-5)
    assert found.probability.sum() == pytest.approx(1)
    assert torch.equal(trajectory.rotation, case.found.trajectory.rotation)
    np.testing.assert_allclose(found.body_right(), 0.5, atol=0.15)  # limbs turned against it may count to either side
    # the reverse of each motion is its rows in the opposite order
    np.testing.assert_allclose(found.joints[half:], found.joints[:half, ::-1], atol=1e-5)


def test_an_arm_that_was_turned_is_turned_back() -> None:
    case = done(turned=((0, "left arm"),))
    _, found = search_directions(case.found, case.coarse, case.fine, SEARCH)
    limbs = found.reversed_limbs[found.chosen, 0]
    only_the_arm = np.arange(5) == LIMB["left arm"]
    assert (limbs == only_the_arm).all() or (limbs == ~only_the_arm).all()
    true = true_joints(case.scene, 6)
    errors = [min(mpjpe_mm(one, true), mpjpe_mm(one[::-1], true)) for one in found.joints]
    assert errors[found.chosen] < 0.6 * errors[0]


def test_of_two_frames_the_one_that_ran_backwards_is_found() -> None:
    case = done(frames=2, turned=((1, "all"),))
    _, found = search_directions(case.found, case.coarse, case.fine, replace_limbs(SEARCH, False))
    assert found.reversed_limbs[found.chosen].all(1).tolist() == [False, True]
    true = true_joints(case.scene, 12)
    assert mpjpe_mm(found.joints[found.chosen], true) < mpjpe_mm(found.joints[0], true)
    right = done(frames=2)
    trajectory, kept = search_directions(right.found, right.coarse, right.fine, SEARCH)
    assert kept.chosen == 0
    assert torch.equal(trajectory.translation, right.found.trajectory.translation)


def test_the_motion_prior_gives_time_an_arrow() -> None:
    case = done(prior=load_motion_prior(None))
    _, found = search_directions(case.found, case.coarse, case.fine, SEARCH)
    half = len(found.probability) // 2
    logit = found.scores["body_backwards"][0] - found.scores["body_backwards"][half]
    assert abs(logit) > 1e-4
    np.testing.assert_allclose(found.scores["image"][:half], found.scores["image"][half:])
    ran_backwards = search_directions(done(turned=((0, "all"),)).found, case.coarse, case.fine, SEARCH)[
        1
    ]  # what is said does not depend on which way the fit happened to run
    np.testing.assert_allclose(ran_backwards.probability[half:], found.probability[:half], atol=2e-3)


def test_the_network_that_saw_the_picture_gives_time_an_arrow() -> None:
    for turned in (False, True):
        case = done(turned=((0, "all"),) if turned else ())
        fine, coarse = (replace(one, evidence=true_evidence(case.scene, 20.0)) for one in (case.fine, case.coarse))
        _, found = search_directions(case.found, coarse, fine, SEARCH)
        half = len(found.probability) // 2
        assert (found.chosen >= half) == turned
        assert found.probability[half:].sum() == pytest.approx(float(turned), abs=0.1)
        np.testing.assert_allclose(found.scores["image"][:half], found.scores["image"][half:])


def test_many_that_run_the_other_way_outweigh_the_likeliest(monkeypatch: pytest.MonkeyPatch) -> None:
    def most_run_backwards(evidence: np.ndarray, several: bool) -> np.ndarray:
        half = len(evidence) // 2
        return np.concatenate([[0.3], np.zeros(half - 1), np.full(half, 0.7 / half)])

    monkeypatch.setattr("hfb.fitting.directions.probabilities", most_run_backwards)
    case = done()
    trajectory, found = search_directions(case.found, case.coarse, case.fine, SEARCH)
    half = len(found.probability) // 2
    assert half > 3  # each of them is less likely than the fitted one
    assert found.chosen == half
    assert found.body_right()[0] > 0.5
    assert not torch.equal(trajectory.rotation, case.found.trajectory.rotation)


def test_what_stands_still_has_no_direction() -> None:
    case = done()
    motion = case.found.trajectory
    still = motion.with_coefficients(motion.rotation.clone(), motion.translation.clone())
    still.rotation[:, 1:], still.translation[:, 1:] = 0, 0
    trajectory, found = search_directions(replace(case.found, trajectory=still), case.coarse, case.fine, SEARCH)
    assert len(found.probability) == 2  # as fitted, and its reverse, which is the same
    assert np.isnan(found.limb_right()).all()
    assert np.isnan(found.joint_right()).all()
    assert found.spread_m().max() < 1e-6
    assert torch.equal(trajectory.rotation, still.rotation)


def test_only_moving_limbs_are_asked_about() -> None:
    case = done()
    found = search_directions(case.found, case.coarse, case.fine, SEARCH)[1]
    asked = {LIMB_NAMES[int(np.flatnonzero(one[0])[0])] for one in found.reversed_limbs if one[0].sum() == 1}
    assert asked == {"torso", "left arm", "right arm"}  # legs only ride along with the body


def test_probabilities_follow_the_evidence_and_its_coefficients() -> None:
    evidence = np.array([[0.0, 1.0, 0.0, 0.0], [0.1, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    odds = {"single": dict(zip(EVIDENCE, (10.0, 2.0, 0.0, 0.0), strict=True))}
    first, worse, likelier = probabilities(evidence, False, odds)
    assert worse / first == pytest.approx(np.exp(-1))
    assert likelier / first == pytest.approx(np.exp(2))
    shifted = probabilities(evidence + np.array([5.0, -3.0, 1.0, 2.0]), False, odds)
    np.testing.assert_allclose(shifted, [first, worse, likelier])


def replace_limbs(config: DirectionsConfig, limbs: bool) -> DirectionsConfig:
    return config.model_copy(update={"limbs": limbs})
