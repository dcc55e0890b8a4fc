"""What the joint network sees to differ between a picture and the fit's own."""

from dataclasses import replace

import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.config import preset
from hfb.fit.comparison import beside_the_fit
from hfb.fit.variables import Variables, start_variables
from hfb.formation import compose
from hfb.initialize.first_body import FirstBody
from hfb.initialize.joint_evidence import look_for_joints
from hfb.objective import Objective
from hfb.observation import Observation
from hfb.priors.anatomy import AnatomicalPrior
from hfb.render.rasterizer import make_rasterizer
from hfb.rotations import axis_angle_to_matrix
from tests.scenes import Scene, moving_scene

BODY = load_default_body()
CONFIG = preset("best").fit


def at_rest(first: FirstBody, seen: Observation) -> Variables:
    return start_variables([first], seen, CONFIG, torch.Generator().manual_seed(0))


def objective_of(seen: Observation, first: FirstBody) -> Objective:
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    return Objective(
        seen, BODY, rasterizer, AnatomicalPrior(), CONFIG.weights, 8, axis_angle_to_matrix(first.pose)[None]
    )


def picture_of(variables: Variables, seen: Observation) -> Observation:
    with torch.no_grad():
        (vertices,) = variables.vertices(BODY, 8)
        drawn = make_rasterizer("coverage", "cpu", 1).render_mean(vertices, variables.texture, seen.camera, BODY.mesh)
    return replace(seen, frames_linear=compose(drawn, seen.plate_linear)[None], mattes=drawn[None, ..., 3])


def raised_arm(scene: Scene) -> FirstBody:
    pose = scene.middle[0].pose.clone()
    pose[16, 2] += 0.7
    return replace(scene.middle[0], pose=pose)


def test_a_fit_that_shows_the_picture_is_left_alone() -> None:
    scene = moving_scene(BODY, size_px=128)
    seen = scene.observation
    evidence = look_for_joints(seen, scene.middle, BODY)
    fitted = at_rest(scene.middle[0], seen)
    shown = picture_of(fitted, seen)
    told = beside_the_fit(evidence, evidence.of(shown), fitted, objective_of(shown, scene.middle[0]), 0.7)
    assert torch.equal(told.middle, evidence.middle)
    torch.testing.assert_close(told.log_height, height_m(BODY, fitted.betas.detach()).log())
    assert float(told.height_scale) < float(evidence.height_scale)


def test_what_differs_points_at_the_picture() -> None:
    scene = moving_scene(BODY, size_px=192, step_m=0.1)
    seen, wrong = scene.observation, raised_arm(scene)
    evidence = look_for_joints(seen, [wrong], BODY)
    fitted = at_rest(wrong, seen)
    moved = beside_the_fit(evidence, evidence, fitted, objective_of(seen, wrong), 1.0).middle - evidence.middle
    window, true = evidence.windows[0], at_rest(scene.middle[0], seen)
    missing = window.to_units(true.joints_at_middle(BODY)[0]) - window.to_units(fitted.joints_at_middle(BODY)[0])
    assert float(torch.cosine_similarity(moved.flatten(), missing.flatten(), dim=0)) > 0.6
    assert float((moved[0] - missing).norm()) < 0.9 * float(missing.norm())


def test_one_frame_tells_its_height_at_the_first_comparison_alone_and_several_at_each() -> None:
    for frames in (1, 2):
        scene = moving_scene(BODY, frames=frames, size_px=96)
        seen, first = scene.observation, scene.middle
        evidence = look_for_joints(seen, first, BODY)
        smaller = replace(first[0], betas=first[0].betas - 1)
        fits = [start_variables([one] * frames, seen, CONFIG, torch.Generator()) for one in (smaller, first[0])]
        objective = replace(objective_of(seen, first[0]), evidence=evidence)
        once = beside_the_fit(evidence, evidence, fits[0], objective, 0.7)
        twice = beside_the_fit(evidence, evidence, fits[1], replace(objective, evidence=once), 0.7)
        assert torch.equal(twice.log_height, once.log_height) == (frames == 1)
        assert torch.equal(twice.height_scale, once.height_scale)
        assert not torch.equal(twice.middle, once.middle)
