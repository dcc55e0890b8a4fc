"""The distance of two motions: zero with itself, what they were moved apart by, and nothing invented between frames."""

from dataclasses import replace

import numpy as np
import pytest

from hfb.evaluation.motion_difference import motion_difference
from hfb.motion.sampled import SampledMotion


def linear_motion(subframes: int, frames: tuple[int, ...] = (0, 1), seed: int = 0) -> SampledMotion:
    """Joints on straight lines at constant speed within every exposure of half an interval."""
    rng = np.random.default_rng(seed)
    start, velocity = rng.normal(size=(2, 24, 3))
    u = np.linspace(0, 1, subframes)
    rows = len(frames) * subframes
    return SampledMotion(
        poses=rng.normal(size=(1, 72)).repeat(rows, 0),
        trans=np.zeros((rows, 3)),
        betas=np.zeros(10),
        joints=np.concatenate([start + (frame + u[:, None, None]) * velocity for frame in frames]),
        times_s=np.concatenate([(2 * frame + u) / 60 for frame in frames]),
        frame_index=np.repeat(frames, subframes),
        K=np.eye(3),
    )


def test_a_motion_is_itself() -> None:
    found = motion_difference(linear_motion(4), linear_motion(4))
    assert found.bit_equal
    assert (found.mean_mm, found.max_mm) == (0, 0)
    assert found.joints_mm.shape == (8, 24)


def test_a_shift_is_measured_where_it_is() -> None:
    one = linear_motion(4)
    joints = one.joints.copy()
    joints[2, 7] += (0.003, 0, -0.004)
    found = motion_difference(one, replace(one, joints=joints))
    assert not found.bit_equal
    assert found.max_mm == pytest.approx(5)
    assert found.mean_mm == pytest.approx(5 / (8 * 24))
    assert found.joints_mm.argmax() == 2 * 24 + 7


def test_the_last_bit_counts() -> None:
    one = linear_motion(4)
    negative = replace(one, trans=-one.trans)  # zeros with a sign
    assert not motion_difference(one, negative).bit_equal
    assert not motion_difference(one, replace(one, joint_radius_mm=np.zeros((8, 24)))).bit_equal
    undefined = replace(one, joint_radius_mm=np.full((8, 24), np.nan))
    assert motion_difference(undefined, undefined).bit_equal


def test_other_subframes_of_the_same_straight_motion_are_no_difference() -> None:
    found = motion_difference(linear_motion(4), linear_motion(7))
    assert not found.bit_equal
    assert found.max_mm == pytest.approx(0, abs=1e-9)


def test_only_shared_frames_count() -> None:
    one, other = linear_motion(4, (0, 1, 4)), linear_motion(4, (1, 4, 5))
    found = motion_difference(one, other)
    assert found.joints_mm.shape == (8, 24)
    assert found.max_mm == pytest.approx(0, abs=1e-9)
    np.testing.assert_array_equal(found.instants_s, one.times_s[4:])


def test_nothing_shared_is_said_so() -> None:
    found = motion_difference(linear_motion(4, (0,)), linear_motion(4, (3,)))
    assert not found.bit_equal
    assert found.mean_mm is found.max_mm is None
    assert not len(found.instants_s)
