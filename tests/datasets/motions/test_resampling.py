"""Resampling: the clip's own frames to the bit of a rotation, straight lines straight, smooth and inside the clip."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.resampling import has_jump, resample


def _clip(frames: int = 12, seed: int = 0, step: float = 0.2, fps: float = 60.0) -> MotionClip:
    """A random walk over rotations and places."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(24, rng=rng)
    poses = [turns]
    for _ in range(frames - 1):
        poses.append(poses[-1] * Rotation.from_rotvec(step * rng.normal(size=(24, 3))))
    stacked = np.stack([pose.as_rotvec() for pose in poses])
    return MotionClip("walk", stacked, np.cumsum(0.1 * rng.normal(size=(frames, 3)), 0), fps)


def _angles(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    turn = Rotation.from_rotvec(left.reshape(-1, 3)).inv() * Rotation.from_rotvec(right.reshape(-1, 3))
    return turn.magnitude().reshape(left.shape[:-1])


def test_the_clips_own_frames_come_back():
    clip = _clip()
    poses, translations = resample(clip, np.arange(12) / clip.fps)
    assert _angles(poses, clip.poses).max() < 1e-7
    np.testing.assert_array_equal(translations, clip.translations)


def test_a_steady_spin_and_a_straight_path_stay_so():
    frames, fps = 40, 30.0
    poses = np.zeros((frames, 24, 3))
    poses[:, :, 1] = 0.3 * np.arange(frames)[:, None]  # passes pi: the axis-angle itself would jump
    clip = MotionClip("spin", poses, np.arange(frames)[:, None] * np.array([0.1, 0.0, -0.2]), fps)
    times = np.random.default_rng(1).uniform(0, 39 / fps, 200)
    resampled, translations = resample(clip, times)
    expected = np.zeros((200, 24, 3))
    expected[:, :, 1] = (0.3 * fps * times)[:, None]
    assert _angles(resampled, expected).max() < 5e-4  # radians, of a step of 0.3
    np.testing.assert_allclose(translations, fps * times[:, None] * np.array([0.1, 0.0, -0.2]), atol=1e-12)


@pytest.mark.parametrize("step", [0.05, 0.6])
def test_continuous_also_across_frames_and_fast_turns(step):
    clip = _clip(step=step)
    times = np.linspace(0, 11 / clip.fps, 11 * 400 + 1)
    poses, translations = resample(clip, times)
    assert np.isfinite(poses).all()
    steps = _angles(poses[1:], poses[:-1])
    between = _angles(clip.poses[1:], clip.poses[:-1])
    assert steps.max() < 5 * between.max() / 400
    assert np.linalg.norm(np.diff(translations, axis=0), axis=1).max() < 0.01


def test_velocity_is_continuous_at_the_frames():
    clip = _clip(step=0.1)
    knots, h = np.arange(1, 11) / clip.fps, 1e-6
    before, at, after = (resample(clip, knots + shift)[1] for shift in (-h, 0.0, h))
    np.testing.assert_allclose((at - before) / h, (after - at) / h, atol=1e-2)
    left, right = (resample(clip, knots + shift)[0] for shift in (-h, h))
    here = resample(clip, knots)[0]
    np.testing.assert_allclose(_angles(left, here), _angles(here, right), rtol=0.02, atol=1e-9)


def test_order_and_company_of_the_instants_do_not_matter():
    clip = _clip(30)
    times = np.random.default_rng(2).uniform(0, 29 / clip.fps, 50)
    together, places = resample(clip, times)
    for i in (0, 7, 49):
        alone, place = resample(clip, times[i : i + 1])
        assert _angles(alone, together[i : i + 1]).max() < 1e-9
        np.testing.assert_allclose(place[0], places[i], atol=1e-12)


def test_two_frames_are_enough():
    clip = _clip(2)
    _, translations = resample(clip, np.array([0.5 / clip.fps]))
    np.testing.assert_allclose(translations[0], clip.translations.mean(0))


@pytest.mark.parametrize("times", [[-0.01], [0.0, 0.19], [np.nan]])
def test_instants_outside_the_clip_are_refused(times):
    with pytest.raises(ValueError, match="outside"):
        resample(_clip(), np.array(times))


def test_a_jump_is_found_where_it_is_and_nowhere_else():
    poses = np.zeros((60, 24, 3))
    poses[:, 4, 0] = 0.3 * np.arange(60)  # 18 radians per second, through several turns
    poses[30:, 7, 1] += 3.0
    clip = MotionClip("glitch", poses, np.zeros((60, 3)), 60.0)
    assert has_jump(clip, 0.0, 59 / 60)
    assert has_jump(clip, 29 / 60, 30 / 60)
    assert not has_jump(clip, 0.0, 29 / 60)
    assert not has_jump(clip, 30 / 60, 59 / 60)
    assert not has_jump(clip, 0.5, 0.5)


def test_a_leap_of_the_whole_person_is_a_jump():
    places = np.outer(np.arange(60), [0.15, 0, 0])  # 9 m/s
    places[30:, 2] += 1.5  # the second of two takes that were joined
    clip = MotionClip("joined", np.zeros((60, 24, 3)), places, 60.0)
    assert has_jump(clip, 29 / 60, 30 / 60)
    assert not has_jump(clip, 0.0, 29 / 60)
    assert not has_jump(clip, 30 / 60, 59 / 60)
