"""Poses at increasing instants: the motion's own are kept, those between are where the body really was."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_quaternion
from hfb.interop.writers.keys import even_keys, exact_keys, rest_joints, subframe_rate_hz
from tests.interop.writers.motions import joints_at, motion_of

BODY = load_default_body(torch.float64)


def test_the_motions_own_instants_are_kept_as_they_are() -> None:
    motion = motion_of(BODY)
    keys = exact_keys(motion)
    np.testing.assert_array_equal(keys.times_s, motion.times_s)
    np.testing.assert_allclose(keys.places, motion.joints, atol=1e-9)
    np.testing.assert_allclose(keys.translations, motion.trans, atol=1e-9)
    given = axis_angle_to_quaternion(torch.from_numpy(motion.poses).unflatten(1, (24, 3))).numpy()
    np.testing.assert_allclose(np.abs((keys.quaternions * given).sum(-1)), 1, atol=1e-9)
    assert ((keys.quaternions[1:] * keys.quaternions[:-1]).sum(-1) > 0).all()
    assert ((given[1:] * given[:-1]).sum(-1) < 0).any()  # the file's own angles turn round at pi
    assert keys.observed.all()
    assert keys.present.all()


def test_an_instant_that_two_exposures_share_comes_once() -> None:
    motion = motion_of(BODY, exposure_s=1 / 30)
    moved = replace(motion, trans=motion.trans + 0.002 * (motion.frame_index == 1)[:, None])
    keys = exact_keys(moved)
    assert len(keys.times_s) == len(motion.times_s) - 2
    assert (np.diff(keys.times_s) > 1e-3).all()
    both = moved.trans[7:9]  # the last sub-frame of frame 0 and the first of frame 1
    np.testing.assert_allclose(keys.translations[7], both.mean(0), atol=1e-12)


@pytest.mark.parametrize("rate", [120.0, 350.0, 1000.0])
def test_even_steps_lie_on_the_true_path_within_a_tenth_of_a_millimetre(rate: float) -> None:
    motion = motion_of(BODY)
    keys = even_keys(motion, rate)
    np.testing.assert_allclose(np.diff(keys.times_s)[:-1], 1 / rate, atol=1e-12)
    assert keys.times_s[0] == motion.times_s[0]
    assert motion.times_s[-1] - keys.times_s[-1] < 1 / rate
    true = joints_at(keys.times_s, BODY, motion.betas)
    errors_mm = 1000 * np.linalg.norm(keys.places - true, axis=-1)
    assert errors_mm[keys.observed].max() < 0.1
    assert errors_mm.max() < 0.5  # over the closed shutter nothing was seen
    assert keys.present.all()


def test_the_closed_shutter_is_told_from_the_open_one() -> None:
    motion = motion_of(BODY, exposure_s=0.02, interval_s=0.05)
    keys = even_keys(motion, 1000.0)
    phase = keys.times_s % 0.05
    np.testing.assert_array_equal(keys.observed, (phase < 0.02 + 1e-9) | (phase > 0.05 - 1e-9))


def test_absence_is_marked_and_bridged_without_leaving_the_ends() -> None:
    motion = motion_of(BODY, frames=12, missing=(3, 4, 5, 6, 7))
    keys = even_keys(motion, 300.0)
    gone = (keys.times_s > 2 / 30 + 0.02 + 1e-9) & (keys.times_s < 8 / 30 - 1e-9)
    np.testing.assert_array_equal(keys.present, ~gone)
    assert not keys.observed[gone].any()
    low, high = motion.joints[[23, 24]].min(0) - 1e-9, motion.joints[[23, 24]].max(0) + 1e-9
    assert ((keys.places[gone] >= low) & (keys.places[gone] <= high)).all()
    np.testing.assert_allclose(np.linalg.norm(keys.quaternions, axis=-1), 1, atol=1e-12)


@pytest.mark.parametrize("exposure_s", [0.002, 0.02, 1 / 30])
def test_one_missing_frame_is_an_absence_however_long_the_shutter_is_open(exposure_s: float) -> None:
    keys = even_keys(motion_of(BODY, frames=6, exposure_s=exposure_s, missing=(3,)), 1000.0)
    gone = (keys.times_s > 2 / 30 + exposure_s + 1e-9) & (keys.times_s < 4 / 30 - 1e-9)
    assert gone.any()
    np.testing.assert_array_equal(keys.present, ~gone)


def test_the_rest_pose_is_found_from_the_motion_alone() -> None:
    motion = motion_of(BODY)
    expected = BODY.rest_joints(torch.from_numpy(motion.betas)).numpy()
    np.testing.assert_allclose(rest_joints(motion), expected, atol=1e-9)


def test_the_rate_of_sub_frames() -> None:
    assert subframe_rate_hz(motion_of(BODY, exposure_s=0.02)) == 350.0
    assert subframe_rate_hz(motion_of(BODY, exposure_s=1 / 30)) == 210.0


def test_instants_out_of_order_are_said_so() -> None:
    motion = motion_of(BODY)
    with pytest.raises(InputError, match="not in order"):
        exact_keys(replace(motion, times_s=motion.times_s[::-1].copy()))
    with pytest.raises(InputError, match="nothing to animate"):
        subframe_rate_hz(replace(motion, frame_index=np.arange(len(motion.times_s))))
