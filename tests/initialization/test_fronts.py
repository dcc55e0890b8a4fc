"""Which way a person faces: the joint network's doubt, and the body that faces the other way."""

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.fronts import find_other_front, front_doubts, mirrored_in_depth
from hfb.initialization.silhouette_fit import matte_level, overlap
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from tests.scenes import Scene, moving_scene

BODY = load_default_body()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return moving_scene(BODY, size_px=96, step_m=0.1)


def towards_camera(first: FirstBody) -> bool:
    joints = BODY.shape(first.betas).joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0]
    across, up = joints[16] - joints[17], joints[16] + joints[17] - joints[1] - joints[2]
    return bool(torch.linalg.cross(across, up)[2] < 0)


def test_doubts_of_a_body_and_of_its_mirror_image_are_opposite(scene: Scene) -> None:
    turned = [mirrored_in_depth(one) for one in scene.middle]
    doubts, opposite = (front_doubts(scene.observation, bodies, BODY) for bodies in (scene.middle, turned))
    assert doubts.shape == (1,)
    assert doubts[0] > 0.05
    torch.testing.assert_close(doubts, -opposite, atol=1e-3, rtol=0)


def test_the_other_front_faces_away_and_covers_the_matte(scene: Scene) -> None:
    found = scene.middle[0]
    other = find_other_front(scene.observation, [found], BODY)
    assert other is not None
    assert towards_camera(found)
    assert not towards_camera(other.bodies[0])
    level = matte_level(scene.observation.mattes[0].numpy(), scene.observation.camera, 96)
    drawing = make_rasterizer("coverage")
    assert overlap(other.bodies[0], level, BODY, drawing) > overlap(mirrored_in_depth(found), level, BODY, drawing)


def test_a_sure_front_has_no_other(scene: Scene) -> None:
    assert find_other_front(scene.observation, scene.middle, BODY, sure=0.05) is None
