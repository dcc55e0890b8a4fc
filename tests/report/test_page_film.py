"""The page's film: cut to the person, at most as wide and as long as said, and faithful to the motion."""

from dataclasses import replace

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.rendering.backends import make_rasterizer
from hfb.report.films.page_film import around_person, page_picture_count, page_pictures, page_slow_factor
from hfb.report.films.slow_motion import FILM_FPS, Shot
from tests.interop.writers.motions import motion_of
from tests.scenes import moving_scene

BODY = load_default_body()
RASTERIZER = make_rasterizer("coverage", "cpu", 1)


def test_a_film_is_small_and_shows_the_motion() -> None:
    scene = moving_scene(BODY, size_px=90, frames=2, instants=4, step_m=0.4)
    camera, plate = scene.observation.camera, scene.observation.plate_linear
    frames = scene.observation.frames_linear
    motion = scene.truth.motion
    shot = Shot(motion, BODY, torch.full((8, 8, 3), 0.6), RASTERIZER, camera, plate, lambda number: frames[number])
    pictures = list(page_pictures(shot))
    assert len(pictures) == page_picture_count(motion)
    height, width = pictures[0].shape[:2]
    assert width <= 640
    assert height % 2 == width % 2 == 0
    instants = [picture[22:, width // 2 : -4] for picture in pictures]
    assert np.abs(instants[0] - instants[-1]).mean() > 0.005
    assert np.abs(pictures[0][22:-40, : width // 2 - 4] - pictures[-1][22:-40, : width // 2 - 4]).mean() > 0.003


def test_it_is_cut_to_the_person_and_the_camera_with_it() -> None:
    scene = moving_scene(BODY, size_px=90)
    wide = torch.zeros(200, 300, 3)
    camera = replace(scene.observation.camera, cx=150.0, cy=100.0, height=200, width=300)
    shot = Shot(scene.truth.motion, BODY, torch.zeros(8, 8, 3), RASTERIZER, camera, wide, lambda number: wide)
    cut = around_person(shot)
    assert cut.plate_linear.shape[1] < 150
    assert cut.frame_linear(0).shape == cut.plate_linear.shape == (cut.camera.height, cut.camera.width, 3)
    joints = torch.from_numpy(scene.truth.motion.joints)
    left, top = camera.cx - cut.camera.cx, camera.cy - cut.camera.cy
    torch.testing.assert_close(
        cut.camera.project(joints), camera.project(joints) - torch.tensor([left, top], dtype=torch.float64)
    )
    seen = cut.camera.project(joints)
    assert seen.min() > 0
    assert seen[..., 0].max() < cut.camera.width
    assert seen[..., 1].max() < cut.camera.height


def test_a_long_clip_gives_a_film_of_twenty_seconds() -> None:
    for frames in (1, 300):
        motion = motion_of(BODY, frames=frames)
        assert page_picture_count(motion) <= 20 * FILM_FPS + 1
        assert page_picture_count(motion) >= 2 * FILM_FPS
    assert page_slow_factor(motion_of(BODY, frames=1)) > 50
