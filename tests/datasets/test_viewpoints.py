"""Cameras face the person, frame them, and see the motion that happened."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from hfb.body.assets import load_default_body
from hfb.datasets.synthetic.viewpoints import View, draw_view, front_of, in_camera, place
from hfb.geometry.rotations import axis_angle_to_matrix

_SIZE = 200


def standing_points() -> np.ndarray:
    """A box about as large as a person, somewhere in the world."""
    return np.random.default_rng(0).uniform((-0.4, 0, -0.2), (0.4, 1.7, 0.2), (500, 3)) + (3.0, 0.2, -5.0)


def project(camera, points: np.ndarray) -> np.ndarray:
    here = points @ camera.R_camera_world.T + camera.offset
    return camera.lens.project(torch.from_numpy(here)).numpy()


def test_the_person_fills_the_picture_as_drawn() -> None:
    rng, points = np.random.default_rng(1), standing_points()
    for _ in range(50):
        view = draw_view(rng)
        camera = place(view, np.array([0.0, 0.0, 1.0]), points, _SIZE)
        pixels = project(camera, points)
        low, high = pixels.min(0), pixels.max(0)
        assert abs((high - low).max() / _SIZE - view.filled) < 0.01
        assert low.min() > 0.04 * _SIZE
        assert high.max() < 0.96 * _SIZE
        assert 0.55 <= view.filled <= 0.85
        field = 2 * np.rad2deg(np.arctan(np.hypot(_SIZE, _SIZE) / 2 / camera.lens.fx))
        assert abs(field - view.diagonal_field_deg) < 1e-6
        np.testing.assert_allclose(camera.R_camera_world @ camera.R_camera_world.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.R_camera_world) > 0


def test_upright_and_from_the_front() -> None:
    """Azimuth 0: the head is above, the person's left (+x) on the right; from above the camera looks down."""
    points, front = standing_points(), np.array([0.0, 0.0, 1.0])
    camera = place(View(0, 10, 0, 50, 0.7, (0, 0)), front, points, _SIZE)
    centre = points.mean(0)
    here = project(camera, np.stack([centre, centre + (0, 0.5, 0), centre + (0.3, 0, 0)]))
    assert here[1, 1] < here[0, 1] - 20
    assert here[2, 0] > here[0, 0] + 10
    lens_in_world = -camera.R_camera_world.T @ camera.offset
    assert lens_in_world[2] > points[:, 2].max()
    assert lens_in_world[1] > centre[1]


def test_front_follows_the_turn_of_the_person() -> None:
    for yaw in (-2.0, 0.0, 0.7):
        np.testing.assert_allclose(front_of(np.array([0, yaw, 0])), [np.sin(yaw), 0, np.cos(yaw)], atol=1e-12)
    # Bent forward until the face looks down: still the direction the person walks in, which is where the head is.
    np.testing.assert_allclose(front_of(np.array([np.pi / 2, 0, 0])), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(front_of(np.array([-np.pi / 2, 0, 0])), [0, 0, 1], atol=1e-9)


def test_the_motion_in_the_camera_is_the_motion_seen() -> None:
    """Bodies posed in the world and then seen agree with bodies posed in camera coordinates.

    SMPL's root turns about the pelvis at rest.
    """
    body = load_default_body(torch.float64)
    rng = np.random.default_rng(2)
    betas = torch.from_numpy(rng.normal(size=10))
    poses, translations = rng.normal(0, 0.5, (3, 24, 3)), rng.normal(0, 1, (3, 3))
    shaped = body.shape(betas)
    world = shaped.pose(axis_angle_to_matrix(torch.from_numpy(poses)), torch.from_numpy(translations))
    camera = place(draw_view(rng), front_of(poses[1, 0]), world.vertices.flatten(0, 1).numpy(), _SIZE)
    turned, moved = in_camera(camera, poses, translations, shaped.joints[0].numpy())
    seen = shaped.pose(axis_angle_to_matrix(torch.from_numpy(turned)), torch.from_numpy(moved))
    for there, here in ((world.vertices, seen.vertices), (world.joints, seen.joints)):
        expected = there.numpy() @ camera.R_camera_world.T + camera.offset
        np.testing.assert_allclose(here.numpy(), expected, atol=1e-9)


def test_cameras_differ() -> None:
    rng = np.random.default_rng(3)
    views = [draw_view(rng) for _ in range(400)]
    azimuth = np.array([view.azimuth_deg for view in views])
    assert azimuth.min() < -60
    assert azimuth.max() > 60
    assert abs(azimuth).max() <= 70
    assert all(-5 <= view.elevation_deg <= 20 for view in views)
    assert all(35 <= view.diagonal_field_deg <= 65 for view in views)


def test_front_is_unit_and_level_for_any_turn() -> None:
    for root in Rotation.random(200, random_state=0).as_rotvec():
        front = front_of(root)
        assert abs(front[1]) < 1e-12
        assert abs(np.linalg.norm(front) - 1) < 1e-9
