"""Synthesise, fit, recover: the method finds motions that it did not know."""

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import FitConfig, Stage, preset
from hfb.evaluation.protocol import at_rest, truth_scores
from hfb.fitting.fit import FitResult, fit
from hfb.motion.static_pose import FirstBody
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from tests.scenes import Scene, moving_scene


def small(**changes: object) -> FitConfig:
    """The best preset, small enough for a test."""
    stages = (Stage(size_px=48, iterations=60), Stage(size_px=96, iterations=60, cosine=True))
    return preset("best").fit.model_copy(update={"stages": stages, "subframes": 5, "texture_px": 32} | changes)


def displaced(first: FirstBody, seed: int = 3) -> FirstBody:
    generator = torch.Generator().manual_seed(seed)
    pose = first.pose + 0.12 * torch.randn(24, 3, generator=generator)
    translation = first.translation + torch.tensor([0.04, -0.03, 0.05])
    return FirstBody(pose, translation, first.betas, "displaced")


def run(scene: Scene, starts: list[FirstBody], config: FitConfig, seed: int = 0) -> FitResult:
    return fit(scene.observation, starts, load_default_body(), config, seed, AnatomicalPrior())


def ratio(scene: Scene, starts: list[FirstBody], result: FitResult) -> float:
    body, rasterizer = load_default_body(), make_rasterizer("coverage", "cpu", 1)
    before = truth_scores(at_rest(starts, result.motion, body), scene.truth, body, rasterizer)
    after = truth_scores(result.motion, scene.truth, body, rasterizer)
    assert after["iou"] > before["iou"]
    return after["better_mpjpe_mm"] / before["better_mpjpe_mm"]


def test_one_frame() -> None:
    scene = moving_scene(load_default_body())
    starts = [displaced(first) for first in scene.middle]
    result = run(scene, starts, small())
    assert ratio(scene, starts, result) < 0.75
    assert result.history["total"][result.best_iteration] <= min(result.history["total"][60:]) + 1e-12


def test_two_frames_know_the_direction() -> None:
    scene = moving_scene(load_default_body(), frames=2)
    starts = [displaced(first) for first in scene.middle]
    result = run(scene, starts, small())
    assert ratio(scene, starts, result) < 0.75
    moved = result.motion.trans[-1, 0] - result.motion.trans[0, 0]
    assert moved > 0.15  # the truth steps 0.3 m to +x


def test_the_same_seed_gives_the_same_bits_for_any_thread_count() -> None:
    scene = moving_scene(load_default_body(), size_px=48)
    config = small(stages=(Stage(size_px=48, iterations=12),))
    one = run(scene, scene.middle, config)
    two = run(scene, scene.middle, config.model_copy(update={"threads": 2}))
    np.testing.assert_array_equal(one.motion.poses, two.motion.poses)
    np.testing.assert_array_equal(one.texture, two.texture)


def test_the_paper_preset_runs_every_term() -> None:
    scene = moving_scene(load_default_body(), size_px=48)
    config = preset("paper").fit.model_copy(
        update={"stages": (Stage(size_px=48, iterations=5),), "subframes": 3, "texture_px": 32}
    )
    result = run(scene, scene.middle, config)
    assert set(result.history) == {
        "total",
        "image",
        "matte",
        "texture",
        "pose",
        "shape",
        "motion",
        "background",
        "adversarial",
    }
    assert np.isfinite(result.history["total"]).all()


def test_a_body_per_frame_is_asked_for() -> None:
    scene = moving_scene(load_default_body(), size_px=48)
    with pytest.raises(ValueError, match="2 first bodies for 1 frames"):
        run(scene, scene.middle * 2, small())
