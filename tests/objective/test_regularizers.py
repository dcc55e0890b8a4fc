"""Pose, shape, polynomial and background terms: by hand, and at the points where such terms go NaN."""

import pytest
import torch

from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.motion.trajectory import Trajectory
from hfb.objective.regularizers import (
    background_loss,
    motion_loss,
    polynomial_loss,
    pose_loss,
    shape_loss,
    typical_sizes,
)


def test_the_pose_loss_is_the_mean_over_sub_frames():
    poses = torch.arange(2 * 69, dtype=torch.float64).reshape(2, 23, 3)
    assert pose_loss(lambda axis_angle: axis_angle[:, 0, 0], poses).item() == 69 / 2


def test_the_shape_loss_by_hand():
    assert shape_loss(torch.tensor([1.0, -2.0, 0.5])).item() == 5.25


def test_the_polynomial_loss_by_hand():
    assert polynomial_loss(torch.tensor([[3.0, -4.0]], dtype=torch.float64)).item() == pytest.approx(7 + 5, abs=1e-5)


def test_no_motion_costs_nothing_and_its_gradient_is_zero_not_nan():
    coefficients = torch.zeros(2, 25, 4, requires_grad=True)
    value = polynomial_loss(coefficients)
    value.backward()
    assert value.item() == 0
    assert torch.equal(coefficients.grad, torch.zeros(2, 25, 4))


def test_polynomial_gradients_match_finite_differences():
    coefficients = torch.randn(3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).requires_grad_()
    assert torch.autograd.gradcheck(polynomial_loss, (coefficients,))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # compiled and as written
def test_only_quaternions_count_in_units_of_their_typical_size(dtype: torch.dtype):
    generator = torch.Generator().manual_seed(1)
    rotation = torch.randn(2, 4, 24, 4, dtype=dtype, generator=generator)
    translation = torch.randn(2, 4, 4, dtype=dtype, generator=generator)
    plain = polynomial_loss(torch.cat([rotation[:, 1:].flatten(), translation[:, 1:].flatten()]))
    assert motion_loss(Trajectory(rotation, translation, "axis-angle")).item() == pytest.approx(plain.item(), rel=1e-6)
    sizes = typical_sizes(4, dtype, rotation.device)
    in_units = Trajectory(rotation * sizes[:, :-1, None], translation * sizes[:, -1:])
    assert motion_loss(in_units).item() == pytest.approx(plain.item(), rel=1e-6)


def test_typical_sizes_are_alike_left_and_right_and_of_mean_one():
    for count in (2, 3, 4, 7):
        sizes = typical_sizes(count, torch.float64, torch.device("cpu"))
        assert sizes.shape == (count, 25)
        assert torch.equal(sizes[:, :-1], sizes[:, list(MIRROR)])
        assert sizes[1:, :-1].mean().item() == pytest.approx(1)
        assert (sizes[:, JOINT_NAMES.index("left_shoulder")] > 3 * sizes[:, JOINT_NAMES.index("spine2")]).all()


def _subframes(colour: float, covered: float = 1.0) -> torch.Tensor:
    """One sub-frame whose left half shows a body of one colour."""
    picture = torch.zeros(1, 2, 4, 4, dtype=torch.float64)
    picture[:, :, :2, 3] = covered
    picture[:, :, :2, :3] = colour * covered
    return picture


def test_the_background_loss_by_hand_inside_the_silhouette_only():
    background = torch.full((2, 4, 3), 0.2, dtype=torch.float64)
    background[:, 2:] = 0.9  # beside the body: must not count
    assert background_loss(background, _subframes(0.7)).item() == pytest.approx(1 / 0.5, rel=1e-5)
    # Half-covered pixels show the same appearance.
    assert background_loss(background, _subframes(0.7, covered=0.5)).item() == pytest.approx(1 / 0.5, rel=1e-5)
    both = torch.cat([_subframes(0.7), _subframes(0.3)])
    assert background_loss(background, both).item() == pytest.approx((1 / 0.5 + 1 / 0.1) / 2, rel=1e-4)


def test_one_matching_pixel_does_not_explode():
    background = torch.full((2, 4, 3), 0.2, dtype=torch.float64)
    background[0, 0] = 0.7
    assert background_loss(background, _subframes(0.7)).item() == pytest.approx(1 / (0.5 * 3 / 4), rel=1e-5)


def test_sub_frames_without_a_body_count_as_zero_and_get_no_gradient():
    background = torch.full((2, 4, 3), 0.2, dtype=torch.float64)
    empty = torch.zeros(1, 2, 4, 4, dtype=torch.float64)
    pictures = torch.cat([_subframes(0.7), empty]).requires_grad_()
    value = background_loss(background, pictures)
    value.backward()
    assert value.item() == pytest.approx(1 / 0.5 / 2, rel=1e-5)
    assert torch.isfinite(pictures.grad).all()
    assert torch.equal(pictures.grad[1], empty[0])


def test_background_gradients_match_finite_differences():
    generator = torch.Generator().manual_seed(4)
    background = torch.rand(2, 3, 3, dtype=torch.float64, generator=generator)
    pictures = torch.rand(2, 2, 3, 4, dtype=torch.float64, generator=generator).requires_grad_()
    assert torch.autograd.gradcheck(lambda subframes: background_loss(background, subframes), (pictures,))
