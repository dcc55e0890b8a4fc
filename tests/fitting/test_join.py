"""Windows become one motion: continuous in place and velocity, no worse than they were, whatever came first."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.fitting.clip.chain_directions import agree_on_directions
from hfb.fitting.clip.join import JoinedMotion, join_windows
from hfb.fitting.clip.windows import WindowFit
from hfb.fitting.reversal import limb_columns, reverse_columns
from hfb.io.media.timing import Timing
from hfb.motion.clock import subframe_clock
from tests.fitting.chains import INTERVAL_S, PERSON, timing, true_joints, window_fits, with_radius

BODY = load_default_body()
K = np.diag([500.0, 500.0, 1.0])


def joined(fits: list[WindowFit], clock: Timing, subframes: int = 8, longest_fill: int = 0) -> JoinedMotion:
    return join_windows(fits, BODY, PERSON, timing=clock, subframes=subframes, K=K, longest_fill=longest_fill)


def error_mm(found: np.ndarray, true: np.ndarray) -> float:
    return float(1e3 * np.linalg.norm(found - true, axis=-1).mean())


def own_error_mm(fits: list[WindowFit], clock: Timing) -> float:
    """Of all windows' frames, before they are joined."""
    truth, shaped, errors = true_joints(clock).reshape(-1, 8, 24, 3), BODY.shape(PERSON.betas), []
    for found in fits:
        rotations, path = found.trajectory.at(subframe_clock(8))
        joints = shaped.joints_of(rotations.flatten(0, 1), path.flatten(0, 1)).unflatten(0, (-1, 8)).double().numpy()
        errors += [error_mm(joints[place], truth[frame]) for place, frame in enumerate(found.frames)]
    return float(np.mean(errors))


@pytest.mark.parametrize("shutter", [1.0, 0.9, 0.5, 0.3])
@pytest.mark.parametrize("length", [2, 3, 5])
def test_a_true_motion_stays_what_it_is(shutter: float, length: int) -> None:
    clock = timing(9, shutter)
    result = joined(window_fits(clock, length), clock)
    assert error_mm(result.motion.joints, true_joints(clock)) < 3
    assert np.allclose(result.motion.times_s.reshape(9, 8)[:, 0], np.arange(9) * INTERVAL_S)
    assert result.gaps == result.filled == result.turned == ()
    assert result.motion.joint_radius_mm is None


@pytest.mark.parametrize("shutter", [1.0, 0.8])
@pytest.mark.parametrize("length", [2, 3])
def test_no_jump_is_left_and_nothing_gets_worse(shutter: float, length: int) -> None:
    clock = timing(9, shutter)
    fits = window_fits(clock, length, noise=0.03)
    result = joined(fits, clock)
    assert max(edge.jump_mm for edge in result.edges) > 20
    assert max(edge.left_mm for edge in result.edges) < 1e-6
    assert max(edge.left_velocity for edge in result.edges) < 1e-4
    assert error_mm(result.motion.joints, true_joints(clock)) <= own_error_mm(fits, clock)


def test_the_samples_themselves_are_continuous() -> None:
    """Without the module's own measure: fine samples of neighbouring frames meet in value and velocity."""
    clock = timing(6)
    result = joined(window_fits(clock, 2, noise=0.03), clock, subframes=256)
    joints = result.motion.joints.reshape(6, 256, 24, 3)
    step_s = clock.exposure_s / 255
    for frame in range(5):
        before, after = joints[frame, -3:], joints[frame + 1, :3]
        assert 1e3 * np.linalg.norm(after[0] - before[-1], axis=-1).max() < 1e-6
        arriving = (3 * before[2] - 4 * before[1] + before[0]) / (2 * step_s)
        leaving = (4 * after[1] - 3 * after[0] - after[2]) / (2 * step_s)
        speed = np.linalg.norm(arriving, axis=-1)
        assert (np.linalg.norm(leaving - arriving, axis=-1) <= 0.02 * np.maximum(speed, 1.0)).all()
    inside = np.abs(np.diff(joints, 2, axis=1)).max()
    assert inside < 0.01  # and nothing jerks within the frames instead


def test_the_order_of_the_windows_does_not_matter() -> None:
    clock = timing(7)
    fits = with_radius(window_fits(clock, 2, noise=0.02))
    one, other = joined(fits, clock), joined(fits[::-1], clock)
    for name in ("poses", "trans", "joints", "times_s", "frame_index", "joint_radius_mm"):
        assert np.array_equal(getattr(one.motion, name), getattr(other.motion, name))
    assert one.edges == other.edges


def test_radii_pass_from_window_to_window() -> None:
    clock = timing(3)
    radius = joined(with_radius(window_fits(clock)), clock).motion.joint_radius_mm
    assert radius is not None
    by_frame = radius.reshape(3, 8, 24)[..., 5]
    assert np.allclose(by_frame[[0, 2]], [[10], [11]])
    assert np.allclose(by_frame[1, [0, -1]], [10, 11])


def test_limbs_that_a_window_saw_backwards_are_turned() -> None:
    clock = timing(8)
    fits = window_fits(clock, 2, noise=0.003)
    limbs = torch.zeros(2, 5, dtype=torch.bool)
    limbs[1, 3] = limbs[0, 1] = True
    wrong = replace(fits[3], trajectory=reverse_columns(fits[3].trajectory, limb_columns(limbs)))
    shaped = BODY.to(torch.float64).shape(PERSON.betas.double())
    mended, turned = agree_on_directions([*fits[:3], wrong, *fits[4:]], shaped, np.zeros(8))
    assert {(one.frame, one.limb) for one in turned} == {(4, "left arm"), (3, "left leg")}
    assert {one.window for one in turned} == {(3, 4)}
    assert torch.allclose(mended[3].trajectory.rotation, fits[3].trajectory.rotation, atol=1e-6)
    _, nothing = agree_on_directions(fits, shaped, np.zeros(8))
    assert nothing == ()


def test_true_times_of_a_varying_rate() -> None:
    openings = np.array([0, 1, 2, 3.6, 4.6, 5.6]) * INTERVAL_S
    clock = timing(6, 0.9, openings)
    result = joined(window_fits(clock, 2, noise=0.01), clock)
    assert np.allclose(result.motion.times_s.reshape(6, 8)[:, 0], openings)
    assert max(edge.left_mm for edge in result.edges) < 1e-6
    assert [edge.frame for edge in result.edges] == [0, 1, 2, 3, 4]


def test_short_absences_are_bridged_and_long_ones_are_gaps() -> None:
    usable = np.array([1, 1, 1, 0, 1, 1, 0, 0, 0, 0, 1, 1], bool)
    clock = timing(12)
    fits = with_radius(window_fits(clock, 2, usable=usable))
    result = joined(fits, clock, longest_fill=2)
    assert result.filled == (3,)
    assert result.gaps == ((6, 9),)
    assert sorted(set(result.motion.frame_index.tolist())) == [0, 1, 2, 3, 4, 5, 10, 11]
    rows = result.motion.rows_of(3)
    assert np.isnan(result.motion.joint_radius_mm[rows]).all()
    assert error_mm(result.motion.joints[rows], true_joints(clock).reshape(12, 8, 24, 3)[3]) < 25
    joints = result.motion.joints.reshape(8, 8, 24, 3)
    for place in (2, 3):  # a bridge begins and ends where its neighbours do
        assert np.linalg.norm(joints[place + 1, 0] - joints[place, -1], axis=-1).max() < 1e-6
    assert joined(fits, clock).gaps == ((3, 3), (6, 9))


def test_a_clip_of_one_frame() -> None:
    clock = timing(1)
    result = joined(window_fits(clock), clock)
    assert result.edges == ()
    assert len(result.motion.poses) == 8
    with pytest.raises(ValueError, match="none"):
        joined([], clock)


def test_instants_stay_in_order_where_stamps_vary_under_a_shutter_that_is_always_open() -> None:
    openings = np.arange(9) * INTERVAL_S + np.array([0, 1, 0, -1, 1, 0, 0, 1, 0]) * 4e-4
    times_s = joined(window_fits(clock := timing(9, 1.0, openings)), clock).motion.times_s
    assert np.all(np.diff(times_s) > -1e-12)
    assert np.allclose(times_s.reshape(9, 8)[:, 0], openings)
    assert times_s[-1] == pytest.approx(openings[-1] + INTERVAL_S)
