"""The static estimate, and interpolation over real time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.evaluation.baselines.build import make_method
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.evaluation.baselines.rows import points_at, poses_at
from hfb.evaluation.metrics import mpjpe_mm
from hfb.evaluation.protocol import at_rest
from tests.evaluation.baselines.cases import bare_case
from tests.scenes import moving_scene


def test_a_turn_is_taken_at_a_constant_rate() -> None:
    poses = torch.zeros(2, 24, 3)
    poses[1, 5, 2] = torch.pi / 2
    between = poses_at(np.array([-1.0, 0.0, 1 / 3, 0.5, 1.0, 9.0]), np.array([0.0, 1.0]), poses)
    angles = [0, 0, torch.pi / 6, torch.pi / 4, torch.pi / 2, torch.pi / 2]
    assert torch.allclose(between[:, 5, 2], torch.tensor(angles), atol=1e-6)
    assert torch.allclose(between[:, :5], torch.zeros(6, 5, 3))


def test_the_shorter_way_round() -> None:
    poses = torch.zeros(2, 24, 3)
    poses[0, 0, 0], poses[1, 0, 0] = 3.0, -3.0  # 0.28 rad apart across pi
    middle = poses_at(np.array([0.5]), np.array([0.0, 1.0]), poses)[0, 0]
    assert abs(float(middle.norm()) - torch.pi) < 1e-5


def test_points_between_three() -> None:
    points = torch.tensor([[0.0, 0, 0], [2.0, 0, 0], [2.0, 4, 0]])
    at = points_at(np.array([0.5, 1.0, 2.0, 5.0]), np.array([0.0, 1.0, 3.0]), points)
    assert at.tolist() == [[1, 0, 0], [2, 0, 0], [2, 2, 0], [2, 4, 0]]


def test_static_is_the_start_at_rest(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), 32, frames=2)
    prediction = make_method(method_spec("static"), body)(bare_case(tmp_path, 2), scene.observation, scene.middle)
    assert prediction.motion is not None
    expected = at_rest(scene.middle, prediction.motion, body)
    for name in ("poses", "trans", "joints", "betas"):
        assert np.allclose(getattr(prediction.motion, name), getattr(expected, name), atol=1e-6), name
    assert prediction.motion.frame_index.tolist() == [0] * 8 + [1] * 8
    assert np.allclose(prediction.motion.times_s[8], scene.observation.interval_s)


def test_one_frame_has_nothing_to_interpolate(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), 32)
    case = bare_case(tmp_path)
    still, moving = (
        make_method(method_spec(name), body)(case, scene.observation, scene.middle).motion
        for name in ("static", "interpolated")
    )
    assert still is not None
    assert moving is not None
    assert np.allclose(still.joints, moving.joints, atol=1e-6)  # the same turn may have two axis-angles at pi


@pytest.mark.parametrize("frames", [2, 3])
def test_interpolation_finds_an_even_motion(tmp_path: Path, frames: int) -> None:
    """The truth turns and moves at a constant rate: between the first and the last middle, interpolation is exact."""
    body, scene = load_default_body(), moving_scene(load_default_body(), 32, frames=frames)
    method = make_method(method_spec("interpolated"), body)
    motion = method(bare_case(tmp_path, frames), scene.observation, scene.middle).motion
    assert motion is not None
    true = scene.truth.motion
    nearest = np.abs(true.times_s[None] - motion.times_s[:, None]).argmin(1)
    middles = scene.observation.exposure_s / 2 + np.arange(frames) * scene.observation.interval_s
    inside = (motion.times_s > middles[0]) & (motion.times_s < middles[-1])
    assert np.allclose(motion.joints[inside], true.joints[nearest[inside]], atol=4e-3)
    outside = motion.times_s < middles[0]
    assert np.ptp(motion.joints[outside], axis=0).max() == 0
    still = make_method(method_spec("static"), body)(
        bare_case(tmp_path, frames), scene.observation, scene.middle
    ).motion
    assert still is not None
    assert mpjpe_mm(motion.joints, true.joints[nearest]) < 0.8 * mpjpe_mm(still.joints, true.joints[nearest])


def test_the_gap_between_exposures_counts(tmp_path: Path) -> None:
    """With the shutter open a quarter of the time, the body moves a quarter as far during it."""
    body, scene = load_default_body(), moving_scene(load_default_body(), 32, frames=3)
    short = replace(scene.observation, exposure_s=scene.observation.interval_s / 4)
    method = make_method(method_spec("interpolated"), body)
    whole, part = (method(bare_case(tmp_path, 3), seen, scene.middle).motion for seen in (scene.observation, short))
    assert whole is not None
    assert part is not None
    travelled = [np.linalg.norm(one.trans[15] - one.trans[8]) for one in (whole, part)]
    ratio = short.exposure_s / scene.observation.exposure_s
    assert travelled[1] == pytest.approx(ratio * travelled[0], rel=1e-4)
