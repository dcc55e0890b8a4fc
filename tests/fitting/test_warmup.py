"""Settling moves the skeleton to where the joints were seen, without any picture."""

from dataclasses import replace

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import as_tall
from hfb.config import Weights, preset
from hfb.fitting.reversal import limb_columns, reverse_columns
from hfb.fitting.variables import start_variables
from hfb.fitting.warmup import fit_skeleton
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.trajectory import Trajectory
from hfb.objective.objective import Objective
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from tests.fitting.scenes import done, true_evidence
from tests.scenes import moving_scene


def test_a_skeleton_settles_where_the_joints_were_seen() -> None:
    body = load_default_body()
    scene = moving_scene(body, size_px=64)
    seen, truth = scene.observation, scene.truth.motion
    evidence = true_evidence(scene)
    pose = scene.middle[0].pose.clone()
    pose[16, 2] += 0.8
    pose[4, 0] += 0.6
    start = replace(scene.middle[0], pose=pose, translation=scene.middle[0].translation + torch.tensor([0.3, 0.1, 0.2]))
    config = preset("best").fit
    variables = start_variables([start], seen, config, torch.Generator().manual_seed(0))
    first = axis_angle_to_matrix(start.pose)[None]
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    objective = Objective(
        seen,
        body,
        rasterizer,
        AnatomicalPrior(),
        config.weights,
        8,
        first,
        evidence=evidence,
        xy_weight=0.0,  # that is for pictures, of which there are none here
    )

    def error_mm() -> tuple[float, float]:
        """Of the joints at mid-exposure, and of their way during the exposure, relative to the pelvis."""
        with torch.no_grad():
            at = variables.trajectory.at(torch.tensor([0.0, 0.5, 1.0]))
            joints = body.shape(variables.betas).joints_of(at[0][0], at[1][0])
        true = torch.from_numpy(truth.joints[[0, len(truth.joints) // 2, -1]]).float()
        still = (joints[1] - joints[1, :1]) - (true[1] - true[1, :1])
        way = (joints[2] - joints[0]) - (true[2] - true[0])
        return float(still.norm(dim=-1).mean() * 1000), float(way.norm(dim=-1).mean() * 1000)

    before, way_before = error_mm()
    fit_skeleton(variables, objective, config)
    after, way_after = error_mm()
    assert before > 60
    assert after < 25
    assert way_after < 0.5 * way_before


@pytest.mark.parametrize("frames", [1, 2])
def test_one_picture_leaves_the_way_open_and_several_frames_know_it_themselves(frames: int) -> None:
    case = done(frames)
    weights = Weights(image=0, matte=0, boundary=0, path=1)
    objective = replace(case.fine, evidence=true_evidence(case.scene), weights=weights)
    shaped = objective.body.shape(case.found.betas)
    forth = case.found.trajectory
    back = reverse_columns(forth, limb_columns(torch.ones(frames, 5, dtype=torch.bool)))

    def path(motion: Trajectory, warm_up: bool) -> float | None:
        terms = replace(objective, warm_up=warm_up).body_terms(motion, case.found.betas, shaped)
        return float(terms["path"]) if "path" in terms else None

    right = path(forth, warm_up=True)
    assert right is not None
    assert path(back, warm_up=True) > 3 * right
    assert path(back, warm_up=False) == (pytest.approx(right, rel=1e-4) if frames == 1 else None)


@pytest.mark.parametrize("across", [0.0, 0.2, 1.0])
def test_a_share_of_the_claim_counts_across_the_view_and_all_of_its_depth(across: float) -> None:
    case = done(1)
    evidence = true_evidence(case.scene)
    weights = Weights(image=0, matte=0, boundary=0, joints=1)
    shaped = case.fine.body.shape(case.found.betas)

    def term(beside: tuple[float, float, float]) -> float:
        elsewhere = replace(evidence, middle=evidence.middle + 1e4 * evidence.scale * torch.tensor(beside))
        objective = replace(case.fine, evidence=elsewhere, weights=weights, xy_weight=across)
        return float(objective.body_terms(case.found.trajectory, case.found.betas, shaped)["joints"])

    assert term((1, 1, 0)) == pytest.approx(2e4 / 3 * across, rel=1e-2, abs=1)
    assert term((0, 0, 1)) == pytest.approx(1e4 / 3, rel=1e-2)


def test_a_claimed_height_is_taken_over_and_no_pose_moves_for_it() -> None:
    """The claim is of the body's size alone: it pulls on betas, along the one direction that makes a body taller."""
    case = done()
    evidence = replace(true_evidence(case.scene), log_height=torch.tensor(1.9).log())
    weights = Weights(image=0, matte=0, boundary=0, height=1)
    betas = torch.zeros(10, requires_grad=True)
    body = case.fine.body
    terms = replace(case.fine, evidence=evidence, weights=weights).body_terms(
        case.found.trajectory, betas, body.shape(betas)
    )
    assert list(terms) == ["height"]
    terms["height"].backward()
    assert betas.grad is not None
    taller = as_tall(torch.zeros(10), body, 1.9)
    assert float(torch.cosine_similarity(-betas.grad, taller, dim=0)) == pytest.approx(1, abs=1e-5)
    there = replace(case.fine, evidence=evidence, weights=weights).body_terms(
        case.found.trajectory, taller, body.shape(taller)
    )
    assert float(there["height"]) == pytest.approx(0, abs=1e-6)
