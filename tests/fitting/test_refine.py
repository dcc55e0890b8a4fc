"""What networks see once the fit's own picture lies beside the real one: joints that differ, and a better matte."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.config import FitConfig, preset
from hfb.datasets.synthetic.backgrounds import room_background
from hfb.datasets.synthetic.textures import clothes_texture
from hfb.evidence.joint_evidence import predict_joint_evidence
from hfb.fitting.refine import (
    InitialEvidence,
    compose_blurred,
    predict_initial_evidence,
    refine_evidence,
    refine_mattes,
    refine_stage_inputs,
    render_blurred,
)
from hfb.fitting.variables import Variables, start_variables
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.static_pose import FirstBody
from hfb.objective.objective import Objective
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from tests.scenes import Scene, moving_scene

BODY = load_default_body()
CONFIG = preset("best").fit
SHARES = CONFIG.model_copy(update={"fuse_depth": False})
"""Depth by fixed shares."""


def sharing(compare: float) -> FitConfig:
    return SHARES.model_copy(update={"compare": compare})


def at_rest(first: FirstBody, seen: Observation) -> Variables:
    return start_variables([first], seen, CONFIG, torch.Generator().manual_seed(0))


def objective_of(seen: Observation, first: FirstBody) -> Objective:
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    return Objective(
        seen, BODY, rasterizer, AnatomicalPrior(), CONFIG.weights, 8, axis_angle_to_matrix(first.pose)[None]
    )


def blurred_of(variables: Variables, seen: Observation) -> torch.Tensor:
    return render_blurred(
        variables, seen.camera, body=BODY, rasterizer=make_rasterizer("coverage", "cpu", 1), subframes=8
    )


def raised_arm(scene: Scene) -> FirstBody:
    pose = scene.middle[0].pose.clone()
    pose[16, 2] += 0.7
    return replace(scene.middle[0], pose=pose)


def test_a_fit_that_shows_the_picture_is_left_alone() -> None:
    scene = moving_scene(BODY, size_px=128)
    seen = scene.observation
    evidence = predict_joint_evidence(seen, scene.middle, BODY)
    fitted = at_rest(scene.middle[0], seen)
    blurred = blurred_of(fitted, seen)
    there = compose_blurred(blurred, seen)
    told = refine_evidence(
        evidence,
        evidence.predict_for(there),
        objective_of(there, scene.middle[0]),
        variables=fitted,
        blurred=blurred,
        config=sharing(0.7),
    )
    assert torch.equal(told.middle, evidence.middle)
    torch.testing.assert_close(told.log_height, height_m(BODY, fitted.betas.detach()).log())
    assert float(told.height_scale) < float(evidence.height_scale)


def test_what_differs_points_at_the_picture() -> None:
    scene = moving_scene(BODY, size_px=192, step_m=0.1)
    seen, wrong = scene.observation, raised_arm(scene)
    evidence = predict_joint_evidence(seen, [wrong], BODY)
    fitted = at_rest(wrong, seen)
    blurred = blurred_of(fitted, seen)
    told = refine_evidence(
        evidence, evidence, objective_of(seen, wrong), variables=fitted, blurred=blurred, config=sharing(1.0)
    )
    moved = told.middle - evidence.middle
    window, true = evidence.windows[0], at_rest(scene.middle[0], seen)
    missing = window.to_units(true.joints_at_middle(BODY)[0]) - window.to_units(fitted.joints_at_middle(BODY)[0])
    assert float(torch.cosine_similarity(moved.flatten(), missing.flatten(), dim=0)) > 0.6
    assert float((moved[0] - missing).norm()) < 0.9 * float(missing.norm())


def test_what_differs_across_the_view_is_moved_by_its_share_and_depth_is_fused() -> None:
    scene = moving_scene(BODY, size_px=96)
    seen, wrong = scene.observation, raised_arm(scene)
    evidence = predict_joint_evidence(seen, [wrong], BODY)
    fitted = at_rest(wrong, seen)
    blurred = blurred_of(fitted, seen)
    objective = objective_of(seen, wrong)
    lifted = evidence.lift(fitted.joints_at_middle(BODY), CONFIG.lifting)
    fused, shared = (
        refine_evidence(lifted, evidence, objective, variables=fitted, blurred=blurred, config=config)
        for config in (CONFIG, SHARES)
    )
    again = evidence.predict_for(compose_blurred(blurred, seen))
    assert torch.equal(fused.middle[..., :2], shared.middle[..., :2])
    assert torch.equal(fused.middle[..., 2], evidence.fuse(again, fitted.joints_at_middle(BODY)).middle[..., 2])
    assert not torch.equal(fused.middle[..., 2], shared.middle[..., 2])
    assert torch.equal(fused.scale, evidence.scale)


@pytest.mark.parametrize(("source", "moves"), [("simulated", True), ("matte", True), ("mediapipe", False)])
@pytest.mark.parametrize("full_size", [False, True])
def test_joints_are_corrected_from_every_start_but_a_pose_networks(source: str, moves: bool, full_size: bool) -> None:
    scene = moving_scene(BODY, size_px=96)
    first = replace(raised_arm(scene), source=source)
    config = CONFIG.model_copy(update={"matte_again": False})
    initial = predict_initial_evidence(scene.observation, [first], BODY, config, square=False)
    assert initial.joints is not None
    objective = replace(objective_of(initial.observation, first), evidence=initial.joints)
    again = refine_stage_inputs(initial, objective, at_rest(first, initial.observation), config, full_size=full_size)
    assert again.evidence is not None
    assert torch.equal(again.evidence.middle, initial.joints.middle) == (not moves)


def test_one_frame_tells_its_height_at_the_first_comparison_alone_and_several_at_each() -> None:
    for frames in (1, 2):
        scene = moving_scene(BODY, frames=frames, size_px=96)
        seen, first = scene.observation, scene.middle
        evidence = predict_joint_evidence(seen, first, BODY)
        smaller = replace(first[0], betas=first[0].betas - 1)
        fits = [start_variables([one] * frames, seen, CONFIG, torch.Generator()) for one in (smaller, first[0])]
        objective = replace(objective_of(seen, first[0]), evidence=evidence)
        blurred = [blurred_of(one, seen) for one in fits]
        once = refine_evidence(evidence, evidence, objective, variables=fits[0], blurred=blurred[0], config=CONFIG)
        twice = refine_evidence(
            evidence, evidence, replace(objective, evidence=once), variables=fits[1], blurred=blurred[1], config=CONFIG
        )
        assert torch.equal(twice.log_height, once.log_height) == (frames == 1)
        assert torch.equal(twice.height_scale, once.height_scale)
        assert not torch.equal(twice.middle, once.middle)


@pytest.mark.parametrize("light", ["linear", "srgb"])
def test_a_matte_is_found_again_beside_the_fit(light: Literal["linear", "srgb"]) -> None:
    """The new matte is better than a first one without a hand and with an object, and a fit that is displaced."""
    still, rng = moving_scene(BODY, size_px=192), np.random.default_rng(3)
    true, fitted = (at_rest(still.middle[0], still.observation) for _ in range(2))
    with torch.no_grad():
        for one, aside in ((true, 0.0), (fitted, 0.012)):
            one.texture.copy_(clothes_texture(BODY, CONFIG.texture_px, np.random.default_rng(1)))
            one.trajectory.translation[0, 0, 0] += aside
            one.trajectory.translation[0, 1, :3] = torch.tensor([0.12, 0.0, 0.0])
    plate = torch.from_numpy(srgb_to_linear(room_background(192, 192, rng)).astype(np.float32))
    blurred = blurred_of(true, still.observation)
    alpha = blurred[0, ..., 3]
    frame = compose(blurred, plate) + 0.004 * torch.from_numpy(rng.standard_normal((1, 192, 192, 3), np.float32))
    seen = replace(still.observation, frames_linear=frame.clamp(0, 1), plate_linear=plate)
    rows, columns = (index.float() for index in torch.nonzero(alpha > 0.5, as_tuple=True))
    first = alpha.clone()
    first[: int(rows.mean()), int(columns.quantile(0.93)) :] = 0
    first[int(rows.max()) - 12 : int(rows.max()), int(columns.mean()) + 25 :][:, :12] = 0.8
    aside = blurred_of(fitted, seen)
    if light == "srgb":  # the same pictures, in the light of a set whose blur was averaged in sRGB
        over = linear_to_srgb(compose(aside, plate)) - (1 - aside[..., 3:]) * linear_to_srgb(plate)
        aside = torch.cat([over, aside[..., 3:]], -1)
        frame, plate = linear_to_srgb(seen.frames_linear), linear_to_srgb(plate)
        seen = replace(seen, frames_linear=frame, plate_linear=plate, light=light)
    before = InitialEvidence(replace(seen, mattes=first[None]), matting_px=288)
    again = refine_mattes(aside, before)
    off = [float((one - alpha).abs().sum() / alpha.sum()) for one in (again.mattes[0], first, aside[0, ..., 3])]
    assert off[0] < 0.7 * min(off[1:]), off
    assert torch.equal(again.frames_linear, seen.frames_linear)
    other = refine_mattes(0.5 * aside, before)
    assert not torch.equal(other.mattes, again.mattes)
    assert torch.equal(refine_mattes(aside, before).mattes, again.mattes)  # nothing of one fit's picture in the next
