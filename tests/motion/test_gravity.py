"""Up, from feet that stand and a trunk that leans, where a walk tells it; and how far standing feet slide."""

from dataclasses import replace

import numpy as np
import pytest

from hfb.geometry.placement import up_of_angles, world_of_up, z_up
from hfb.motion.clock import subframe_times_s
from hfb.motion.footing import foot_skate_mm, standing_feet
from hfb.motion.gravity import world_of_walk
from hfb.motion.sampled import SampledMotion

TILT_DEG, ROLL_DEG = 24.0, -6.0
_STEP_S, _SUBFRAMES = 0.5, 6
_TRUE = z_up(world_of_up(up_of_angles(TILT_DEG, ROLL_DEG)))


def walk(path: np.ndarray, lean_deg: float = 8.0, noise_m: float = 0.02) -> SampledMotion:
    """Somebody who sets one foot after the other onto a path (N, 2) on the floor, seen by a tilted camera."""
    seconds = (len(path) - 2) * _STEP_S
    times_s, frames = subframe_times_s(int(seconds * 20), _SUBFRAMES, 0.04, 0.05)
    step = times_s / _STEP_S
    joints = np.zeros((len(times_s), 24, 3))
    for foot, first in ((10, 0), (11, 1)):
        prints = path[first::2]
        along = np.clip((step - first) / 2 + 0.5, 0, len(prints) - 1)
        moved = np.clip(2 * (along % 1) - 0.5, 0, 1)  # it stands for half of the time
        here = np.floor(along).astype(int)
        there = np.minimum(here + 1, len(prints) - 1)
        joints[:, foot, :2] = prints[here] + moved[:, None] * (prints[there] - prints[here])
        joints[:, foot, 2] = 0.3 * np.sin(np.pi * moved)
    joints[:, 0] = joints[:, [10, 11]].mean(1) + (0, 0, 0.9)
    ahead = np.gradient(joints[:, 0], axis=0)[:, :2]
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True) + 1e-9
    lean = np.radians(lean_deg)
    joints[:, 12] = joints[:, 0] + 0.5 * np.concatenate(
        [np.sin(lean) * ahead, np.full((len(step), 1), np.cos(lean))], 1
    )
    seen = (joints - (0, 5, 1.5)) @ _TRUE.R  # the inverse of camera to world
    seen += np.repeat(np.random.default_rng(0).normal(0, noise_m, (frames[-1] + 1, 24, 3)), _SUBFRAMES, 0)
    return SampledMotion(
        np.zeros((len(seen), 72)), np.zeros((len(seen), 3)), np.zeros(10), seen, times_s, frames, np.eye(3)
    )


def around(count: int = 14) -> np.ndarray:
    """Footprints on a circle of 1.2 m radius."""
    angle = np.linspace(0, 1.6 * np.pi, count)
    radius = 1.2 + 0.1 * (-1.0) ** np.arange(count)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)


def off_deg(motion: SampledMotion) -> float:
    world = world_of_walk(motion)
    assert world is not None
    assert world.source == "person"
    return float(np.degrees(np.arccos(z_up(world).R[2] @ _TRUE.R[2])))


@pytest.mark.parametrize("lean_deg", [0.0, 8.0])
def test_a_walk_around_tells_up(lean_deg: float) -> None:
    assert off_deg(walk(around(), lean_deg)) < 2


def test_what_does_not_tell_it() -> None:
    """Footprints on a line leave the axis across it open; standing leaves both; crooked floors are none."""
    straight = np.stack([np.linspace(-1.5, 1.5, 8), 0.03 * (-1.0) ** np.arange(8)], 1)
    assert world_of_walk(walk(straight)) is None
    assert world_of_walk(walk(np.tile([[0.1, 0.0], [-0.1, 0.0]], (5, 1)))) is None
    assert world_of_walk(walk(around(), lean_deg=40)) is None  # the trunk contradicts the floor
    assert world_of_walk(walk(around(), noise_m=0.3)) is None
    assert world_of_walk(walk(around()[:4])) is None


def test_feet_stand_where_they_are_still_and_down() -> None:
    motion = walk(around(), noise_m=0.0)
    standing = standing_feet(motion, _TRUE.R[2])
    height = _TRUE.points(motion.joints[:, [10, 11]])[..., 2]
    assert 0.4 < standing.mean() < 0.75
    assert np.ptp(height[standing]) < 0.03
    assert standing.any(1).all()


def test_how_far_standing_feet_slide() -> None:
    """A person who glides along at 0.1 m/s: 4 mm in each exposure of 40 ms; a rise is no sliding."""
    motion, up = walk(around(), noise_m=0.0), _TRUE.R[2]
    assert foot_skate_mm(motion, up) == pytest.approx(0, abs=1e-9)
    aside = np.array([0.1, 0, 0]) @ _TRUE.R  # along the floor
    glided = replace(motion, joints=motion.joints + motion.times_s[:, None, None] * aside)
    assert foot_skate_mm(glided, up) == pytest.approx(4, abs=0.2)
    risen = replace(motion, joints=motion.joints + motion.times_s[:, None, None] * 0.1 * up)
    assert foot_skate_mm(risen, up) == pytest.approx(0, abs=1e-6)
    assert foot_skate_mm(replace(motion, joints=motion.joints + 3 * motion.times_s[:, None, None] * up), up) is None
