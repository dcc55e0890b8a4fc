"""A height that is told, or that of a body that a network saw: the fit holds it, and the size of everything follows."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import as_tall, height_m
from hfb.config import FitConfig, Stage, preset
from hfb.fitting.confidence import shipped_confidence
from hfb.fitting.fit import FitResult, fit
from hfb.fitting.identity import Identity
from hfb.motion.static_pose import rescale_first_body
from hfb.priors.anatomy import AnatomicalPrior
from tests.scenes import moving_scene

BODY = load_default_body()
TRUE_M = 1.70
"""How tall the scene's person is, to the centimetre."""


def told(height: float | None, rotation: str = "quaternion") -> FitConfig:
    return preset("best").fit.model_copy(
        update={
            "stages": (Stage(size_px=48, iterations=25),),
            "subframes": 3,
            "texture_px": 16,
            "height_m": height,
            "rotation": rotation,
        }
    )


def found(config: FitConfig, person: Identity | None = None, source: str = "test") -> FitResult:
    """From a first body of the true pose and place in the picture, whose size is a fifth too large."""
    scene = moving_scene(BODY, size_px=64)
    large = as_tall(torch.zeros(10), BODY, 1.2 * TRUE_M)
    starts = [rescale_first_body(first, person.betas if person else large, BODY) for first in scene.middle]
    starts = [replace(first, source=source) for first in starts]
    return fit(scene.observation, starts, BODY, config, 0, AnatomicalPrior(), identity=person)


def tall(result: FitResult) -> float:
    return float(height_m(BODY, torch.from_numpy(result.motion.betas)))


def too_large(result: FitResult) -> float:
    """How far the joints spread about the pelvis, over the truth's; 1 where the size is right."""
    truth = moving_scene(BODY, size_px=64).truth.motion.joints
    spread, true = (
        float(np.linalg.norm(joints - joints[:, :1], axis=-1).mean()) for joints in (result.motion.joints, truth)
    )
    return spread / true


@pytest.mark.parametrize("rotation", ["quaternion", "axis-angle"])
def test_the_height_is_held_and_the_size_follows(rotation: str) -> None:
    unknown, known = found(told(None, rotation)), found(told(TRUE_M, rotation))
    assert tall(unknown) > 1.05 * TRUE_M  # a picture does not show it
    assert too_large(unknown) > 1.05
    assert tall(known) == pytest.approx(TRUE_M, abs=1e-4)
    assert too_large(known) == pytest.approx(1, abs=0.02)


def test_the_person_keeps_the_place_in_the_picture() -> None:
    """Who is smaller stands nearer; the first body that was given may have any height."""
    unknown, known = found(told(None)), found(told(1.4))
    ratio = tall(known) / tall(unknown)
    near, far = (float(result.motion.joints[:, 0, 2].mean()) for result in (known, unknown))
    assert near / far == pytest.approx(ratio, abs=0.03)


def test_joints_are_surer_where_the_height_is_told() -> None:
    unknown, known = found(told(None)), found(told(TRUE_M))
    assert not unknown.joint_features["told"].any()
    assert (known.joint_features["told"] == 1).all()
    assert shipped_confidence().coefficients["told"] < -0.05


@pytest.mark.parametrize("rotation", ["quaternion", "axis-angle"])
def test_a_body_that_a_network_saw_keeps_its_height(rotation: str) -> None:
    """A fit takes clothed people for short ones; of the matte's own body the joint network knows more."""
    config = told(None, rotation)
    seen, free = found(config, source="mediapipe"), found(config, source="matte")
    assert tall(seen) == pytest.approx(1.2 * TRUE_M, abs=1e-4)
    assert abs(tall(free) - 1.2 * TRUE_M) > 0.005
    assert not seen.joint_features["told"].any()  # kept, not known
    as_before = found(config.model_copy(update={"keep_height": False}), source="mediapipe")
    assert abs(tall(as_before) - 1.2 * TRUE_M) > 0.005


def test_a_person_who_is_known_is_left_alone() -> None:
    person = Identity(as_tall(torch.zeros(10), BODY, 1.6), torch.full((16, 16, 3), 0.5))
    assert tall(found(told(TRUE_M), person)) == pytest.approx(1.6, abs=1e-4)


def test_the_shape_but_for_its_height_is_free() -> None:
    """Nothing but the height is held: proportions still move."""
    known = found(told(TRUE_M))
    betas = torch.from_numpy(known.motion.betas).float()
    assert float((betas - as_tall(torch.zeros(10), BODY, TRUE_M)).norm()) > 0.01
