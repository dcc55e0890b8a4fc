"""The metrics: cases small enough to compute by hand, and the laws that make them metrics of a motion."""

import math

import numpy as np
import pytest
import torch

from hfb.body.skeleton import H36M_14
from hfb.evaluate import metrics
from hfb.evaluate.alignment import best_rotation
from hfb.rotations import axis_angle_to_matrix


def _rotation(*axis_angle: float) -> np.ndarray:
    return axis_angle_to_matrix(torch.tensor(axis_angle, dtype=torch.float64)).numpy()


@pytest.fixture
def truth() -> np.ndarray:
    """A body-sized random skeleton that moves smoothly, 6 sub-frames."""
    rng = np.random.default_rng(0)
    start, velocity = rng.normal(0, 0.4, (2, 24, 3))
    return start + 0.3 * np.linspace(0, 1, 6)[:, None, None] * velocity + np.array([0.1, 0.2, 3.0])


def test_mpjpe_by_hand():
    # Three joints on the axes; every sub-frame moves one joint by 30 mm along its own arm, which no rotation mends.
    truth = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 2, dtype=float)
    predicted = truth.copy()
    predicted[0, 1, 0] += 0.03
    assert metrics.mpjpe_mm(predicted, truth) == pytest.approx(30 / 6)
    assert metrics.mpjpe_mm(predicted, truth, [1]) == pytest.approx(30 / 2)
    assert metrics.mpjpe_mm(predicted, truth, [0, 2]) == pytest.approx(0, abs=1e-9)


def test_mpjpe_forgives_one_rotation_and_every_translation_but_no_scale(truth):
    turned = truth @ _rotation(0.4, -1.0, 0.3).T + np.random.default_rng(1).normal(0, 1, (6, 1, 3))
    assert metrics.mpjpe_mm(turned, truth) == pytest.approx(0, abs=1e-9)
    centred = truth - truth[:, :1]
    assert metrics.mpjpe_mm(1.1 * truth, truth) == pytest.approx(100 * np.linalg.norm(centred, axis=-1).mean())


def test_mpjpe_sees_a_wrong_turn_within_the_sequence_and_pa_mpjpe_does_not(truth):
    turning = np.stack([frame @ _rotation(0, 0.2 * k, 0).T for k, frame in enumerate(truth)])
    assert metrics.mpjpe_mm(turning, truth) > 50
    assert metrics.pa_mpjpe_mm(turning, truth) == pytest.approx(0, abs=1e-9)


def test_a_rigid_motion_and_a_scale_per_sub_frame_leave_pa_mpjpe_at_zero(truth):
    rng = np.random.default_rng(2)
    moved = np.stack(
        [rng.uniform(0.5, 2) * frame @ _rotation(*rng.normal(size=3)).T + rng.normal(size=3) for frame in truth]
    )
    assert metrics.pa_mpjpe_mm(moved, truth) == pytest.approx(0, abs=1e-9)
    assert metrics.pa_mpjpe_mm(moved, truth, H36M_14) == pytest.approx(0, abs=1e-9)


def test_pa_mpjpe_is_never_above_the_error_without_alignment_in_square(truth):
    noisy = truth + np.random.default_rng(3).normal(0, 0.05, truth.shape)
    plain = np.sqrt((np.linalg.norm(noisy - truth, axis=-1) ** 2).mean())
    assert 0 < metrics.pa_mpjpe_mm(noisy, truth) < 1000 * plain


def test_no_reflection_even_where_it_would_fit_better(truth):
    mirrored = truth * np.array([-1.0, 1, 1])
    assert metrics.pa_mpjpe_mm(mirrored, truth) > 50
    assert metrics.mpjpe_mm(mirrored, truth) > 50
    centred = mirrored[0] - mirrored[0, 0]
    assert np.linalg.det(best_rotation(centred, truth[0] - truth[0, 0])) == pytest.approx(1)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), [1, 2, 3]), np.eye(3)[[0, 1, 1, 0]]])
def test_flat_clouds_still_give_a_proper_rotation(points):
    target = points @ _rotation(0.3, 0.2, -1.0).T
    rotation = best_rotation(points, target)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(points @ rotation.T, target, atol=1e-12)


def test_time_reversal_leaves_the_better_of_both_unchanged(truth):
    noisy = truth + np.random.default_rng(4).normal(0, 0.01, truth.shape)
    backward = metrics.reverse_time(noisy)
    for metric in (metrics.mpjpe_mm, metrics.pa_mpjpe_mm):
        assert metrics.better_of_both(metric, noisy, truth) == pytest.approx(
            metrics.better_of_both(metric, backward, truth)
        )
        assert metrics.better_of_both(metric, backward, truth) == pytest.approx(metric(noisy, truth))
    assert metrics.wrong_direction(backward, truth).tolist() == [True]
    assert metrics.wrong_direction(noisy, truth).tolist() == [False]


def test_each_frame_has_its_own_direction(truth):
    half_wrong = np.concatenate([truth[:3], truth[3:][::-1]])
    assert metrics.wrong_direction(half_wrong, truth, frames=2).tolist() == [False, True]
    assert metrics.better_of_both(metrics.mpjpe_mm, half_wrong, truth, frames=2) == pytest.approx(0, abs=1e-9)
    assert metrics.mpjpe_mm(half_wrong, truth) > 1


def test_a_static_prediction_has_no_wrong_direction(truth):
    static = np.repeat(truth[2:3], 6, axis=0)
    assert not metrics.wrong_direction(static, truth).any()


def test_in_plane_and_depth_are_the_parts_of_one_residual():
    # Joints far out and symmetric: the best rotation stays the identity.
    truth = np.array([[[0, 0, 5], [1, 0, 5], [-1, 0, 5], [0, 1, 5], [0, -1, 5]]], dtype=float)
    predicted = truth.copy()
    predicted[0, 1:] += np.array([0.0, 0, 0.04])  # all outer joints further away: no rotation mends that
    in_plane, depth = metrics.in_plane_depth_mm(predicted, truth)
    assert in_plane == pytest.approx(0, abs=1e-9)
    assert depth == pytest.approx(40 * 4 / 5)


def test_motion_errors_of_the_truth_are_zero(truth):
    errors = metrics.motion_errors(truth, truth, frames=2)
    assert all(getattr(errors, name) == pytest.approx(0, abs=1e-9) for name in errors.__dataclass_fields__)


def test_blur_rate_by_hand():
    silhouettes = np.zeros((3, 4, 8), dtype=np.float32)
    for k in range(3):
        silhouettes[k, :, k : k + 4] = 1  # 4 wide, moves 2 columns
    assert metrics.blur_rate(silhouettes) == pytest.approx(0.5)
    silhouettes[2] = 0
    silhouettes[2, :, 4:] = 1  # no overlap between the first and the last
    assert metrics.blur_rate(silhouettes) == pytest.approx(1.0)


def test_a_still_body_has_no_blur_and_no_body_no_blur_rate():
    still = np.repeat(np.random.default_rng(5).random((1, 6, 5), dtype=np.float32), 4, axis=0)
    assert metrics.blur_rate(still) == 0
    with pytest.raises(ValueError, match="empty"):
        metrics.blur_rate(np.zeros((2, 3, 3)))


def test_iou_by_hand_and_at_its_ends():
    left, right = np.zeros((2, 2, 4))
    left[:, :3], right[:, 1:] = 1, 1
    assert metrics.soft_iou(left, right) == 0.5
    assert metrics.soft_iou(0.5 * left, 0.5 * left) == 1  # a soft mask equals itself
    assert metrics.soft_iou(0 * left, 0 * left) == 1
    assert metrics.soft_iou(0 * left, left) == 0
    assert metrics.silhouette_iou(np.stack([left, left]), np.stack([left, right])) == 0.75


def test_psnr_by_hand_and_under_a_mask():
    truth = np.zeros((2, 4, 3), dtype=np.float32)
    predicted = truth.copy()
    predicted[:, :2] = 0.1
    assert metrics.psnr_db(predicted, truth) == pytest.approx(10 * math.log10(2 / 0.01), abs=1e-5)
    mask = np.zeros((2, 4))
    mask[:, 0] = 0.3
    assert metrics.psnr_db(predicted, truth, mask) == pytest.approx(20, abs=1e-5)
    assert metrics.psnr_db(truth, truth) == math.inf
