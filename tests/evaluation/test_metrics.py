"""The metrics: cases small enough to compute by hand, and the laws that make them metrics of a motion."""

import math

import numpy as np
import pytest
import torch

from hfb.body.skeleton import H36M_14
from hfb.evaluation import metrics
from hfb.geometry.procrustes import best_rotation
from hfb.geometry.rotations import axis_angle_to_matrix


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


def test_the_offset_of_one_joint_counts_once_among_all(truth):
    # Along the joint's own arm from the pelvis, where it is nearly out of reach of the one rotation.
    still = np.repeat(truth[:1] - truth[0, 0], 4, axis=0)
    arm = still[0, 20] / np.linalg.norm(still[0, 20])
    predicted = still.copy()
    predicted[:, 20] += 1e-3 * arm
    assert metrics.mpjpe_mm(predicted, still) == pytest.approx(1 / 24, rel=1e-6)
    errors = metrics.joint_errors_mm(predicted, still)
    assert errors[20] == pytest.approx(1)
    assert np.delete(errors, 20) == pytest.approx(0, abs=1e-9)


def test_joint_errors_are_the_parts_of_mpjpe(truth):
    noisy = truth + np.random.default_rng(6).normal(0, 0.02, truth.shape)
    errors = metrics.joint_errors_mm(noisy, truth)
    assert errors.shape == (24,)
    assert errors[0] == 0  # the pelvis
    assert errors.mean() == pytest.approx(metrics.mpjpe_mm(noisy, truth))
    for joint in (3, 17):
        assert errors[joint] == pytest.approx(metrics.mpjpe_mm(noisy, truth, [joint]))


def test_with_every_joint_known_a_subset_is_judged_as_the_whole(truth):
    noisy = truth @ _rotation(0.2, 0.1, 0).T + np.random.default_rng(7).normal(0, 0.02, truth.shape)
    found = metrics.subset_errors(noisy, truth, [0])
    assert found.mpjpe_mm == pytest.approx(metrics.mpjpe_mm(noisy, truth))
    assert found.pa_mpjpe_mm == pytest.approx(metrics.pa_mpjpe_mm(noisy, truth))
    assert (found.in_plane_mm, found.depth_mm) == pytest.approx(metrics.in_plane_depth_mm(noisy, truth))
    np.testing.assert_allclose(found.joints_mm, metrics.joint_errors_mm(noisy, truth))


def test_a_subset_by_hand_around_the_middle_of_its_hips():
    truth = np.array([[[1, 0, 5], [-1, 0, 5], [0, 1, 5], [0, -1, 5]]] * 2, dtype=float)
    predicted = truth + np.array([0.3, 0, 1.0])  # elsewhere in space: does not count
    predicted[0, 2, 1] += 0.04  # along its arm: no rotation mends that
    found = metrics.subset_errors(predicted, truth, [0, 1])
    assert found.mpjpe_mm == pytest.approx(40 / 8)
    assert found.joints_mm == pytest.approx([0, 0, 20, 0], abs=1e-9)
    assert (found.in_plane_mm, found.depth_mm) == pytest.approx((5, 0))


def test_unknown_joints_count_nowhere(truth):
    rng = np.random.default_rng(8)
    noisy = truth + rng.normal(0, 0.03, truth.shape)
    gaps = truth.copy()
    gaps[2, 5:] = np.nan
    gaps[:, 23] = np.nan
    elsewhere = noisy.copy()
    elsewhere[2, 5:] += 100  # whatever the prediction says there
    elsewhere[:, 23] = -3
    one, other = (metrics.subset_errors(each, gaps, [1, 2]) for each in (noisy, elsewhere))
    np.testing.assert_allclose(one.joints_mm, other.joints_mm)
    assert one.mpjpe_mm == pytest.approx(other.mpjpe_mm)
    assert one.pa_mpjpe_mm == pytest.approx(other.pa_mpjpe_mm)
    assert math.isnan(one.joints_mm[23])
    # A joint that is never known is as good as one that is not asked for.
    assert metrics.subset_errors(noisy[:, :23], gaps[:, :23], [1, 2]).mpjpe_mm == pytest.approx(one.mpjpe_mm)
    exact = metrics.subset_errors(2 * truth @ _rotation(0.5, 1, 0).T, gaps, [1, 2])
    assert exact.pa_mpjpe_mm == pytest.approx(0, abs=1e-9)


def test_without_its_centre_a_sub_frame_counts_for_pa_mpjpe_alone(truth):
    noisy = truth + np.random.default_rng(9).normal(0, 0.03, truth.shape)
    gaps = truth.copy()
    gaps[4:, 1] = np.nan  # one hip of two
    found = metrics.subset_errors(noisy, gaps, [1, 2])
    assert found.mpjpe_mm == pytest.approx(metrics.subset_errors(noisy[:4], truth[:4], [1, 2]).mpjpe_mm)
    assert found.pa_mpjpe_mm != pytest.approx(metrics.subset_errors(noisy[:4], truth[:4], [1, 2]).pa_mpjpe_mm)


def test_of_nothing_known_nothing_is_said(truth):
    found = metrics.subset_errors(truth, np.full_like(truth, np.nan), [1, 2])
    assert all(math.isnan(value) for value in (found.mpjpe_mm, found.pa_mpjpe_mm, found.in_plane_mm, found.depth_mm))
    assert np.isnan(found.joints_mm).all()
    with_a_broken_prediction = truth.copy()
    with_a_broken_prediction[0, 3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        metrics.subset_errors(with_a_broken_prediction, truth, [1, 2])


def test_ssim_of_equal_pictures_is_one_and_of_noise_near_zero():
    rng = np.random.default_rng(10)
    picture = rng.random((24, 30, 3))
    assert metrics.ssim(picture, picture) == pytest.approx(1)
    assert metrics.ssim(picture, picture, np.ones((24, 30))) == pytest.approx(1)
    assert abs(metrics.ssim(rng.random((24, 30, 3)), picture)) < 0.15
    assert metrics.ssim(picture, 1 - picture) < -0.9  # the opposite structure


def test_ssim_is_that_of_scikit_image():
    """The implementation that researchers know, to the last bit; hfb does not depend on its 40 MB."""
    structural_similarity = pytest.importorskip("skimage.metrics").structural_similarity
    rng = np.random.default_rng(12)
    for height, width in [(11, 11), (40, 33), (120, 90)]:
        truth = rng.random((height, width, 3))
        mask = rng.random((height, width))
        for predicted in (truth * 0.8, rng.random(truth.shape), np.zeros_like(truth), truth.astype(np.float32)):
            whole, per_pixel = structural_similarity(
                predicted.astype(np.float64),
                truth,
                gaussian_weights=True,
                sigma=1.5,
                use_sample_covariance=False,
                data_range=1.0,
                channel_axis=-1,
                full=True,
            )
            assert metrics.ssim(predicted, truth) == whole
            assert metrics.ssim(predicted, truth, mask) == np.average(per_pixel.mean(-1), weights=mask)


def test_a_picture_without_room_for_the_window_is_refused():
    with pytest.raises(ValueError, match="smaller than SSIM's window"):
        metrics.ssim(np.zeros((10, 40, 3)), np.zeros((10, 40, 3)))


def test_ssim_of_flat_pictures_by_hand():
    # Without structure only the luminance term is left: (2 a b + C1) / (a^2 + b^2 + C1), C1 = .01^2.
    one, other = np.full((16, 16, 3), 0.5), np.full((16, 16, 3), 0.3)
    assert metrics.ssim(one, other) == pytest.approx((2 * 0.15 + 1e-4) / (0.34 + 1e-4))


def test_ssim_under_a_mask_sees_the_mask_alone():
    rng = np.random.default_rng(11)
    truth = rng.random((40, 40, 3))
    predicted = truth.copy()
    predicted[:, 25:] = rng.random((40, 15, 3))
    left, right = np.zeros((2, 40, 40))
    left[:, :18], right[:, 34:] = 0.4, 1  # half a window (5 px) away from the border between good and bad
    assert metrics.ssim(predicted, truth, left) == pytest.approx(1)
    assert metrics.ssim(predicted, truth, right) < 0.3
    assert metrics.ssim(predicted, truth, 0 * left) == metrics.ssim(predicted, truth)
