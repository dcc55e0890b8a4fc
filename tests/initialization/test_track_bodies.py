"""A body from elsewhere before the clip's camera: what is known is kept, what is not comes from the matte."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rays import between_rays, seen_along
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.silhouette_fit import matte_level, overlap, silhouette
from hfb.interop.readers.pose_track import PoseTrack, pinhole
from hfb.interop.track_bodies import body_at, on_matte
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from tests.angles import angle_between
from tests.scenes import standing_pose

BODY = load_default_body()
CAMERA = PinholeCamera.from_focal(260.0, 160, 200)
RASTERIZER = make_rasterizer()
NOWHERE = torch.full((3,), torch.nan)


def walker(yaw: float) -> FirstBody:
    """Somebody in mid-step, an arm raised forward, turned about the vertical."""
    pose = standing_pose()
    pose[1, 0], pose[2, 0], pose[5, 0] = -0.6, 0.4, 0.6
    pose[16] = torch.tensor([0.0, -1.2, 0.0])
    turn = axis_angle_to_matrix(torch.tensor([0.0, yaw, 0.0]))
    pose[0] = matrix_to_axis_angle(turn @ axis_angle_to_matrix(pose[0]))
    return FirstBody(pose, torch.tensor([0.3, 0.2, 4.0]), torch.zeros(10), "truth")


def test_rays() -> None:
    place = torch.tensor([1.0, -0.5, 3.0])
    along = seen_along(place) @ torch.tensor([0.0, 0, 1])
    torch.testing.assert_close(along, place / place.norm())
    other = torch.tensor([-0.2, 0.1, 2.0])
    torch.testing.assert_close(between_rays(place, place), torch.eye(3))
    torch.testing.assert_close(between_rays(place, other) @ place / place.norm(), other / other.norm())


def test_a_body_without_a_place_finds_it_in_the_matte() -> None:
    true = walker(0.4)
    matte = silhouette(true, CAMERA, BODY, RASTERIZER).numpy()
    found = on_matte(replace(true, translation=NOWHERE), True, matte, CAMERA, BODY, RASTERIZER)
    assert float((found.translation - true.translation).norm()) < 0.25
    assert overlap(found, matte_level(matte, CAMERA, 96), BODY, RASTERIZER) > 0.85


def test_a_body_whose_turn_is_unknown_is_turned() -> None:
    true = walker(1.5)
    matte = silhouette(true, CAMERA, BODY, RASTERIZER).numpy()
    lost = replace(walker(-0.7), translation=NOWHERE)
    found = on_matte(lost, False, matte, CAMERA, BODY, RASTERIZER)
    assert overlap(found, matte_level(matte, CAMERA, 96), BODY, RASTERIZER) > 0.75
    angle = angle_between(axis_angle_to_matrix(found.pose[0]), axis_angle_to_matrix(true.pose[0]))
    assert float(angle) < 0.6
    with pytest.raises(InputError):
        on_matte(lost, False, np.zeros((160, 200), np.float32), CAMERA, BODY, RASTERIZER)


def test_a_good_place_is_not_made_worse() -> None:
    true = walker(0.0)
    matte = silhouette(true, CAMERA, BODY, RASTERIZER).numpy()
    found = on_matte(true, True, matte, CAMERA, BODY, RASTERIZER)
    level = matte_level(matte, CAMERA, 96)
    assert overlap(found, level, BODY, RASTERIZER) >= overlap(true, level, BODY, RASTERIZER)


def test_a_far_camera_at_the_pictures_edge() -> None:
    """Seen by a lens 20 times as long, a body at the edge that faces the lens faces ours too."""
    true = walker(0.0)
    far = pinhole(20 * 260.0, 100.0, 80.0)
    place = np.array([[1.2 * 20 / 20, 0.1, 4.0 * 20]])
    pose = true.pose.double().numpy()[None]
    track = PoseTrack("test", "0", np.array([3]), (160, 200), poses=pose, pelvis=place, K=far[None])
    found = body_at(track, 3, CAMERA, BODY)
    assert found is not None
    pelvis = BODY.rest_joints(found.betas)[0] + found.translation
    assert float(pelvis[2]) == pytest.approx(4.0, rel=0.01)
    wanted = far @ place[0] / place[0, 2]
    assert float((CAMERA.project(pelvis) - torch.from_numpy(wanted[:2]).float()).norm()) < 0.1
    ray = torch.atan2(pelvis[0], pelvis[2]) - np.arctan(place[0, 0] / place[0, 2])
    turn = angle_between(axis_angle_to_matrix(found.pose[0]), axis_angle_to_matrix(true.pose[0]))
    assert float(turn) == pytest.approx(float(ray.abs()), abs=0.03)
    assert body_at(track, 4, CAMERA, BODY) is None
    with pytest.raises(InputError, match="behind its camera"):
        body_at(replace(track, pelvis=-place), 3, CAMERA, BODY)
