"""From a silhouette alone to a body that covers it and stands like a person."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.config import InitConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.initializer import make_initializer
from hfb.initialization.matte_search import search_by_matte
from hfb.initialization.pose_bank import bank_rotations
from hfb.initialization.silhouette_fit import (
    SilhouetteStage,
    Stay,
    matte_level,
    overlap,
    refine,
    refine_all,
    refine_swept,
    silhouette,
)
from hfb.motion.static_pose import FirstBody
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer

BODY = load_default_body()
CAMERA = PinholeCamera.from_focal(420.0, 360, 300)
RASTERIZER = make_rasterizer()


def blurred_matte(
    name: str, yaw: float, place: tuple[float, float, float], drift_m: float = 0.0
) -> tuple[np.ndarray, FirstBody]:
    """The mean silhouette of a body that drifts sideways, and its middle; the pose is a bank pose, disturbed."""
    names, poses = bank_rotations()
    disturbance = 0.08 * torch.randn(23, 3, generator=torch.Generator().manual_seed(1))
    upright = axis_angle_to_matrix(torch.tensor([torch.pi, 0, 0])) @ axis_angle_to_matrix(torch.tensor([0, yaw, 0]))
    pose = torch.cat([matrix_to_axis_angle(upright)[None], poses[names.index(name)] + disturbance])
    shares = []
    for t in (-0.5, -0.25, 0.0, 0.25, 0.5):
        now = torch.tensor([place[0] + t * drift_m, *place[1:]])
        shares.append(silhouette(FirstBody(pose, now, torch.zeros(10), "truth"), CAMERA, BODY, RASTERIZER))
    return torch.stack(shares).mean(0).numpy(), FirstBody(pose, torch.tensor(place), torch.zeros(10), "truth")


def assert_human(first: FirstBody) -> None:
    joints = BODY.shape(first.betas).joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0]
    at = {joint: index for index, joint in enumerate(JOINT_NAMES)}
    assert torch.isfinite(joints).all()
    assert joints[at["head"], 1] < joints[at["pelvis"], 1] < joints[at["left_ankle"], 1]  # y points down
    assert float(AnatomicalPrior().limit_penalty(first.pose[None, 1:])[0]) < 25
    assert float(first.betas.abs().max()) < 2.5


@pytest.mark.parametrize(("name", "yaw", "drift"), [("stride", 1.5, 0.05), ("one arm up", -0.6, 0.1)])
def test_covers_a_silhouette(name: str, yaw: float, drift: float) -> None:
    matte, truth = blurred_matte(name, yaw, (0.1, 0.15, 3.2), drift)
    first, shared = search_by_matte(matte, CAMERA, BODY, RASTERIZER)
    # No static body covers a blurred silhouette fully: the truth's own middle sets the scale.
    assert shared > 0.87 * overlap(truth, matte_level(matte, CAMERA, 128), BODY, RASTERIZER)
    assert shared > 0.6
    assert abs(float(first.translation[2]) - 3.2) < 0.5
    assert first.source == "matte"
    assert_human(first)


def test_a_person_at_the_edge() -> None:
    """Half the body is outside: no crash, a human body, and the seen half is covered."""
    matte, _ = blurred_matte("standing", 0.3, (-0.95, 0.1, 2.6))
    assert matte[:, 0].max() > 0.5
    first, shared = search_by_matte(matte, CAMERA, BODY, RASTERIZER)
    assert shared > 0.6
    assert_human(first)


def test_refinement_never_ends_worse() -> None:
    matte, _ = blurred_matte("lunge", 0.9, (0.0, 0.1, 3.0))
    names, poses = bank_rotations()
    standing = torch.cat([torch.tensor([[torch.pi, 0.0, 0.0]]), poses[names.index("standing")]])
    start = FirstBody(standing, torch.tensor([0.1, 0.0, 3.3]), torch.zeros(10), "x")
    level = matte_level(matte, CAMERA, 64)
    ended = refine(start, matte, CAMERA, BODY, RASTERIZER, [SilhouetteStage(64, 8, 0.03)], Stay(pose=0.01))
    assert overlap(ended, level, BODY, RASTERIZER) > overlap(start, level, BODY, RASTERIZER)
    assert ended.source == "x"


def test_initializer_takes_tensors() -> None:
    matte = torch.from_numpy(blurred_matte("star", 0.0, (0.0, 0.1, 3.2), 0.05)[0])
    frame = matte[..., None].expand(-1, -1, 3) * 0.5 + 0.2
    first = make_initializer(InitConfig(method="matte"))(frame, torch.full_like(frame, 0.2), matte, CAMERA, BODY)
    assert first.pose.shape == (24, 3)
    assert overlap(first, matte_level(matte.numpy(), CAMERA, 128), BODY, RASTERIZER) > 0.7


def test_deterministic() -> None:
    matte, truth = blurred_matte("stride", 1.0, (0.0, 0.1, 3.2))
    ended = [refine(truth, matte, CAMERA, BODY, RASTERIZER, [SilhouetteStage(48, 6, 0.05)], Stay()) for _ in range(2)]
    assert torch.equal(ended[0].pose, ended[1].pose)
    assert torch.equal(ended[0].betas, ended[1].betas)


def test_several_at_once_are_each_by_itself() -> None:
    matte, truth = blurred_matte("stride", 1.0, (0.0, 0.1, 3.2), 0.2)
    beside = replace(truth, translation=truth.translation + torch.tensor([0.3, 0.0, 0.2]))
    lying = replace(truth, pose=torch.cat([torch.tensor([[0.0, 0.0, 1.5]]), truth.pose[1:]]))
    firsts, travels = [truth, beside, lying], torch.tensor([[0.1, 0.0, 0.0], [0.0, 0.3, 0.0], [0.2, 0.1, 0.0]])
    scene, stage, stay = (matte, CAMERA, BODY, RASTERIZER), SilhouetteStage(40, 6, 0.05, shape=False), Stay()
    for one, together in zip(firsts, refine_all(firsts, None, *scene, [stage], stay)[0], strict=True):
        alone = refine(one, *scene, [stage], stay)
        assert torch.equal(together.pose, alone.pose)
        assert torch.equal(together.translation, alone.translation)
    found, moved = refine_all(firsts, travels, *scene, [stage], stay)
    assert moved is not None
    for number, one in enumerate(firsts):
        swept, way = refine_swept(one, travels[number], *scene, [stage], stay)
        assert torch.equal(found[number].pose, swept.pose)
        assert torch.equal(moved[number], way)
        assert not torch.equal(way, travels[number])


def test_several_at_once_have_one_shape_and_keep_it() -> None:
    matte, truth = blurred_matte("stride", 1.0, (0.0, 0.1, 3.2))
    scene = (matte, CAMERA, BODY, RASTERIZER)
    with pytest.raises(ValueError, match="keep their shape"):
        refine_all([truth, truth], None, *scene, [SilhouetteStage(40, 2, 0.05)], Stay())
    taller = replace(truth, betas=truth.betas + 0.1)
    with pytest.raises(ValueError, match="same betas"):
        refine_all([truth, taller], None, *scene, [SilhouetteStage(40, 2, 0.05, shape=False)], Stay())


def test_an_empty_matte_is_a_sentence() -> None:
    blank = torch.zeros(360, 300)
    frame = blank[..., None].expand(-1, -1, 3)
    with pytest.raises(InputError, match="matte is empty"):
        make_initializer(InitConfig(method="matte"))(frame, frame, blank, CAMERA, BODY)
