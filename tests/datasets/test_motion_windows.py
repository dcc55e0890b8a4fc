"""What priors learn from: exposures and poses drawn from recordings."""

import numpy as np
import pytest

from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.motion_windows import (
    LONGEST_S,
    SHORTEST_S,
    draw_columns,
    draw_exposures,
    split_motions,
    take_poses,
)
from hfb.datasets.motions.sources import open_motions
from hfb.errors import InputError
from hfb.priors.motion_columns import at_instants

U = np.array([0.0, 0.5, 1.0])


def turning(frames: int = 61, fps: float = 60.0, rad_per_s: float = 1.0) -> MotionClip:
    """A person who walks sideways at 1 m/s and bends the left elbow evenly."""
    times_s = np.arange(frames) / fps
    poses = np.zeros((frames, 24, 3))
    poses[:, 18, 1] = -rad_per_s * times_s
    translations = np.stack([times_s, 0 * times_s, 0 * times_s], 1)
    return MotionClip("turning", poses, translations, fps)


class Source:
    """Some clips as a source; None stands for a damaged file."""

    def __init__(self, *clips: MotionClip | None) -> None:
        self._clips = clips

    def names(self) -> list[str]:
        return [f"clip {number}" for number in range(len(self._clips))]

    def load(self, index: int) -> MotionClip:
        clip = self._clips[index]
        if clip is None:
            raise InputError("this one is damaged")
        return clip


def test_exposures_lie_within_the_clip_and_follow_it() -> None:
    poses, translations, exposure_s = draw_exposures(turning(), U, 200, np.random.default_rng(0))
    assert len(poses) == len(translations) == len(exposure_s) == 200
    assert SHORTEST_S <= exposure_s.min() < 0.05 < 0.4 < exposure_s.max() <= LONGEST_S
    assert translations.min() >= 0
    assert translations[:, :, 0].max() <= 1
    np.testing.assert_allclose(translations[:, 2, 0] - translations[:, 0, 0], exposure_s, atol=1e-9)
    np.testing.assert_allclose(poses[:, 0, 18, 1] - poses[:, 2, 18, 1], exposure_s, atol=1e-6)
    assert 0.4 < (exposure_s < np.sqrt(SHORTEST_S * LONGEST_S)).mean() < 0.6


def test_jumps_and_short_clips_are_left_out() -> None:
    clip = turning()
    broken = clip.poses.copy()
    broken[30:, 18, 1] += 2.5
    poses, _, exposure_s = draw_exposures(
        MotionClip("broken", broken, clip.translations, clip.fps), U, 100, np.random.default_rng(0)
    )
    assert 10 < len(exposure_s) < 100
    assert np.abs(np.diff(poses[:, :, 18, 1], axis=1)).max() < 1
    assert len(draw_exposures(turning(frames=2), U, 100, np.random.default_rng(0))[2]) == 0


def test_what_is_drawn_from_a_motion_is_its_own() -> None:
    bad: dict[str, str] = {}
    alone = draw_columns(Source(turning()), [0], 50, 7, {})
    among = draw_columns(Source(None, turning(), turning(91)), [0, 1, 2], 50, 7, bad)
    assert bad == {"clip 0": "this one is damaged"}
    np.testing.assert_array_equal(among[0][: len(alone[0])], alone[0])
    assert not np.array_equal(draw_columns(Source(turning()), [0], 50, 8, {})[0], alone[0])


def test_columns_are_those_of_the_motion() -> None:
    import torch

    columns, exposure_s = draw_columns(Source(turning()), [0], 50, 0, {})
    _, path = at_instants(torch.from_numpy(columns), torch.tensor([0.0, 1.0]))
    np.testing.assert_allclose((path[:, 1] - path[:, 0])[:, 0], exposure_s, atol=1e-4)


def test_poses_at_regular_times() -> None:
    poses = take_poses(Source(turning()), [0], 10, {})
    assert poses.shape == (10, 69)
    np.testing.assert_allclose(poses[:, 17 * 3 + 1], -np.arange(10) / 10, atol=1e-6)


def test_every_fourth_is_held_out() -> None:
    names = [f"walk_{n}" for n in range(8)] + ["run_0", "run_1"]
    split = split_motions(names, ["run_*"])
    assert split.tested == (8, 9)
    assert split.held_out == (3, 7)
    assert split.trained == (0, 1, 2, 4, 5, 6)
    for patterns in (["jump*"], []), (["run_*"], ["jump*"]):
        with pytest.raises(InputError, match=r"'jump\*'"):
            split_motions(names, *patterns)
    with pytest.raises(InputError, match="learn from"):
        split_motions(names, ["*"])


def test_what_is_named_is_held_out() -> None:
    names = [f"walk_{n}" for n in range(5)] + ["run_0", "run_1"]
    split = split_motions(names, ["run_1"], ["run_*", "walk_2"])
    assert (split.tested, split.held_out, split.trained) == ((6,), (2, 5), (0, 1, 3, 4))


def test_built_in_motions_will_do() -> None:
    columns, _ = draw_columns(open_motions(None, 0), [0, 1], 5, 0, {})
    assert np.isfinite(columns).all()
    assert len(columns) > 5
