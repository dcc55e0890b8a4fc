"""L_A as a term of the joint loss: with one frame alone, and it pulls a motion the way people move."""

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import Stage, Weights, preset
from hfb.datasets.motions.sources import open_motions
from hfb.fitting.fit import fit
from hfb.geometry.rotations import in_hemisphere_of
from hfb.motion.trajectory import Trajectory, trajectory_at_rest
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.motion_prior import load_motion_prior
from tests.priors.motions import backwards
from tests.scenes import moving_scene


@pytest.mark.parametrize(("name", "frames"), [("best", 1), ("best", 2), ("paper", 1)])
def test_a_single_frame_has_the_term_and_several_have_not(name: str, frames: int) -> None:
    scene = moving_scene(load_default_body(), size_px=48, frames=frames)
    stages = (Stage(size_px=32, iterations=2),)
    weights = Weights(adversarial=1)
    changes = {"stages": stages, "subframes": 2, "texture_px": 16, "weights": weights}
    config = preset(name).fit.model_copy(update=changes)
    result = fit(scene.observation, scene.middle, load_default_body(), config, 0, AnatomicalPrior())
    assert ("adversarial" in result.history) == (frames == 1)


def walking(phases: int = 12) -> Trajectory:
    """The built-in walk, a quarter of a second of it per frame; the frames have nothing to do with each other."""
    clip = open_motions(None, 0).load(0)
    step = round(clip.fps / 8)
    middles = torch.linspace(step, len(clip.poses) - step - 1, phases).long()
    poses, places = (torch.from_numpy(one).float() for one in (clip.poses, clip.translations))
    early, motion, late = (
        trajectory_at_rest(poses[middles + shift], places[middles + shift], 2, "quaternion", 0.5)
        for shift in (-step, 0, step)
    )
    rotation, translation = motion.rotation.clone(), motion.translation.clone()
    first, last = (in_hemisphere_of(one.rotation[:, 0], rotation[:, 0]) for one in (early, late))
    rotation[:, 1], translation[:, 1] = last - first, late.translation[:, 0] - early.translation[:, 0]
    return motion.with_coefficients(rotation, translation)


def test_a_walk_is_likelier_forwards() -> None:
    """Nobody has ever seen this walk: neither D nor G learned from built-in motions."""
    prior, shaped = load_motion_prior(None), load_default_body().shape(torch.zeros(10))
    forwards, reverse = walking(), backwards(walking())
    assert (prior.whole_body_logit(forwards) < 0).float().mean() > 0.8
    assert prior(reverse, shaped) > 1.3 * prior(forwards, shaped)


def test_descent_turns_a_reversed_walk_round() -> None:
    """Where nothing else knows the direction, going down L_A finds it, or at least stops what people do not do."""
    prior, shaped = load_motion_prior(None), load_default_body().shape(torch.zeros(10))
    reverse = backwards(walking())
    rotation, translation = (one.clone().requires_grad_() for one in (reverse.rotation, reverse.translation))
    optimizer = torch.optim.Adam([rotation, translation], lr=0.01)
    before = prior(reverse, shaped).item()
    for _ in range(100):
        optimizer.zero_grad()
        prior(reverse.with_coefficients(rotation, translation), shaped).backward()
        optimizer.step()
    found = reverse.with_coefficients(rotation.detach(), translation.detach())
    assert prior(found, shaped) < 0.3 * before
    true = walking().translation[:, 1, :3]
    along = (found.translation[:, 1, :3] * true).sum(-1) / (true * true).sum(-1)  # 1 is the true walk, -1 the start
    assert along.mean() > -0.4
    assert (along > 0).sum() >= 4
