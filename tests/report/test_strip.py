"""The strip: every cell where it belongs, and the truth leaves no residual."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.evaluation.protocol import reblur
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.report.images.strip import StripRow, draw_strip, lay_out
from tests.scenes import moving_scene

RASTERIZER = make_rasterizer("coverage", "cpu", 1)


def _row(height: int, width: int, value: float) -> StripRow:
    flat = np.full((height, width, 3), value, dtype=np.float32)
    return StripRow(flat, flat[..., 0], (flat, flat), ("1/2", "2/2"), flat, 0 * flat, flat)


def test_cells_stand_side_by_side_and_frames_below_each_other():
    one, two = lay_out([_row(50, 40, 0.2)]), lay_out([_row(50, 40, 0.2), _row(50, 40, 0.7)])
    assert two.shape == (2 * one.shape[0], one.shape[1], 3)
    assert one.shape[1] == 7 * (40 + 4)
    assert one.shape[0] > 50
    for column in (0, 1, 2, 3, 4, 6):
        np.testing.assert_allclose(one[-40:-10, column * 44 + 5 : column * 44 + 35], 0.2, atol=1e-6)
    np.testing.assert_allclose(one[-40:-10, 5 * 44 + 5 : 5 * 44 + 35], 0.5)  # no residual is middle gray


def test_captions_are_written_dark_on_white_and_stay_in_their_cell():
    strip = lay_out([_row(50, 60, 1.0)])
    captions = strip[:20]
    for column in range(7):
        cell = captions[:, column * 64 : (column + 1) * 64]
        assert cell.min() < 0.4
        assert cell.mean() > 0.7
        assert cell[:, -3:].min() == 1


@pytest.mark.parametrize("frames", [1, 2])
def test_the_truth_leaves_no_residual_and_every_frame_has_its_row(frames):
    body = load_default_body()
    scene = moving_scene(body, size_px=72, frames=frames, instants=5)
    texture = torch.full((8, 8, 3), 0.6)
    observation = _repainted(scene.observation, scene.truth.motion, texture, body)
    strip = draw_strip(observation, scene.truth.motion, texture, body, RASTERIZER)
    assert np.isfinite(strip).all()
    assert strip.min() >= 0
    assert strip.max() <= 1
    height, width = strip.shape[0] // frames, strip.shape[1] // 10
    assert 256 <= height <= 300
    residual = strip[30 : height - 10, 8 * width + 2 : 9 * width - 6]
    assert np.abs(residual - 0.5).mean() < 0.02
    sub_frames = [strip[30 : height - 10, k * width + 2 : (k + 1) * width - 6] for k in range(2, 7)]
    assert all(np.abs(a - b).mean() > 0.005 for a, b in itertools.pairwise(sub_frames))


def _repainted(observation: Observation, motion, texture: torch.Tensor, body) -> Observation:
    """The same scene with a body of this texture."""
    means = reblur(motion, texture, observation, body, RASTERIZER)
    return replace(observation, frames_linear=compose(means, observation.plate_linear), mattes=means[..., 3])


def test_a_note_is_written_below_in_as_many_lines_as_it_needs():
    body = load_default_body()
    scene = moving_scene(body, size_px=48, instants=3)
    given = scene.observation, scene.truth.motion, torch.full((8, 8, 3), 0.6), body, RASTERIZER
    plain, noted = draw_strip(*given), draw_strip(*given, note="a sentence about what is not known " * 12)
    np.testing.assert_array_equal(noted[: len(plain)], plain)
    assert noted.shape[1] == plain.shape[1]
    below = noted[len(plain) :]
    assert len(below) % 22 == 0
    assert len(below) > 22
    assert all(below[start : start + 22].min() < 0.4 for start in range(0, len(below), 22))
    assert below[:, -2:].min() == 1
