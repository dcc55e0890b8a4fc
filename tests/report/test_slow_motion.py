"""The de-blurred video: every panel shows what it says, at the time it says."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.evaluation.protocol import reblur
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.report.films import slow_motion as films
from tests.interop.writers.motions import motion_of
from tests.scenes import moving_scene

RASTERIZER = make_rasterizer("coverage", "cpu", 1)
BODY = load_default_body()
_TOP_PX, _GAP_PX = 22, 4  # a caption above every panel, a margin beside and below


@pytest.fixture(scope="module")
def shot() -> films.Shot:
    """Two frames that the motion explains exactly."""
    scene = moving_scene(BODY, size_px=90, frames=2, instants=4)
    texture = torch.full((8, 8, 3), 0.6)
    means = reblur(scene.truth.motion, texture, scene.observation, BODY, RASTERIZER)
    frames = compose(means, scene.observation.plate_linear)
    camera, plate = scene.observation.camera, scene.observation.plate_linear
    return films.Shot(scene.truth.motion, BODY, texture, RASTERIZER, camera, plate, lambda number: frames[number])


def panels(picture: np.ndarray) -> list[np.ndarray]:
    """Blurred, de-blurred, re-blurred."""
    filled = np.flatnonzero((picture[_TOP_PX : _TOP_PX + 360] < 1).any((0, 2)))[-1] + 1  # white to the right of it
    width = (filled + _GAP_PX) // 3
    return [picture[_TOP_PX : _TOP_PX + 360, at * width : (at + 1) * width - _GAP_PX] for at in range(3)]


def test_sub_frames_come_at_their_true_times(shot: films.Shot) -> None:
    shown = list(films.exact_sub_frames(shot))
    assert [time_s for time_s, _ in shown] == shot.motion.times_s.tolist()
    assert len(shown) == films.picture_count(shot.motion, "exact")
    for _, picture in shown:
        assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
        assert picture.min() >= 0
        assert picture.max() <= 1
        seen, _, again = panels(picture)
        assert np.abs(seen - again).mean() < 0.01  # the true motion makes the blur that was seen
        assert np.abs(seen - again).max() < 0.5
    instants = [panels(picture)[1] for _, picture in shown]
    blurred = [panels(picture)[0] for _, picture in shown]
    assert np.abs(instants[0] - instants[3]).mean() > 0.003  # the body moves while the shutter is open
    assert np.abs(blurred[0] - blurred[3]).max() == 0  # and the picture is one
    assert np.abs(blurred[3] - blurred[4]).mean() > 0.003
    mean = np.mean([to_linear(one) for one in instants[:4]], 0)
    assert np.abs(mean - to_linear(blurred[0])).mean() < 0.003  # what is shown adds up to what was seen


def to_linear(srgb: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, written out again."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def test_slow_motion_runs_at_an_even_pace_and_holds_its_end(shot: films.Shot) -> None:
    lasts = shot.motion.times_s[-1]
    assert films.film_slow_factor(shot.motion) == pytest.approx(2.0 / lasts)
    instants = films.film_instants(shot.motion)
    assert instants[0] == 0
    assert instants[-1] == lasts
    np.testing.assert_allclose(np.diff(instants)[:-1], lasts / 60, rtol=1e-6)
    long = replace(shot.motion, times_s=np.arange(8) * 0.5)
    assert films.film_slow_factor(long) == 1.0  # never faster than it was
    shapes = [picture.shape for picture in films.slow_motion(shot)]
    assert len(shapes) == films.picture_count(shot.motion, "slowmotion")
    assert len(set(shapes)) == 1


def test_overlay_shows_the_body_over_the_blurred_picture(shot: films.Shot) -> None:
    pictures = films.overlay(shot)
    first = next(pictures)
    assert films.picture_count(shot.motion, "overlay") == len(films.film_instants(shot.motion))
    seen = panels(next(films.exact_sub_frames(shot))[1])[0]
    over = first[_TOP_PX : _TOP_PX + 360, : seen.shape[1]]
    changed = np.abs(over - seen).max(-1) > 0.02
    assert 0.02 < changed.mean() < 0.4  # a body, and the picture around it as it was


def test_a_long_clips_overlay_runs_as_fast_as_it_was() -> None:
    motion = motion_of(BODY, frames=90)
    assert films.overlay_rate(motion) == pytest.approx(30)
    assert films.picture_count(motion, "overlay") == 90
    assert films.overlay_rate(motion_of(BODY, frames=3)) == films.FILM_FPS


def test_one_long_exposure_has_no_pace_of_its_own() -> None:
    motion = motion_of(BODY, frames=1)
    motion = replace(motion, times_s=motion.times_s * 5 / motion.times_s[-1])
    assert films.overlay_rate(motion) == films.FILM_FPS
    assert films.picture_count(motion, "overlay") == len(films.film_instants(motion)) > 5 * films.FILM_FPS


def test_stretches_without_the_person_are_cut_out() -> None:
    motion = motion_of(BODY, frames=12, missing=(3, 4, 5, 6, 7))
    instants = films.film_instants(motion)
    assert not ((instants > 2 / 30 + 0.02 + 1e-6) & (instants < 8 / 30 - 1e-6)).any()
    assert (instants > 8 / 30).any()
