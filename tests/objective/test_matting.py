"""The matting loss: one minus the soft IoU."""

import pytest
import torch

from hfb.objective.matting import matting_loss


def test_by_hand():
    predicted = torch.tensor([[0.5, 1.0, 0.0]], dtype=torch.float64)
    matte = torch.tensor([[1.0, 0.5, 0.0]], dtype=torch.float64)
    assert matting_loss(predicted, matte).item() == pytest.approx(1 - 1.0 / 2.0, abs=1e-6)


def test_zero_where_they_agree_even_between_zero_and_one_and_one_where_they_are_apart():
    matte = torch.rand(5, 6, dtype=torch.float64)
    assert matting_loss(matte, matte).item() == pytest.approx(0, abs=1e-12)
    apart = torch.zeros(5, 6, dtype=torch.float64)
    assert matting_loss(apart, matte).item() == pytest.approx(1, abs=1e-6)
    assert matting_loss(apart, apart).item() == 0


def test_symmetric():
    first, second = torch.rand(2, 4, 4, dtype=torch.float64)
    torch.testing.assert_close(matting_loss(first, second), matting_loss(second, first))


@pytest.mark.parametrize("matte_value", [0.0, 1.0])
def test_an_empty_prediction_has_a_finite_gradient_that_asks_for_a_body_only_where_the_matte_is(matte_value):
    matte = torch.full((3, 3), matte_value)
    predicted = torch.zeros(3, 3, requires_grad=True)
    matting_loss(predicted, matte).backward()
    assert torch.isfinite(predicted.grad).all()
    assert (predicted.grad < 0).all() if matte_value else torch.equal(predicted.grad, torch.zeros(3, 3))


def test_gradients_match_finite_differences():
    generator = torch.Generator().manual_seed(2)
    predicted, matte = torch.rand(2, 3, 4, dtype=torch.float64, generator=generator)
    assert torch.autograd.gradcheck(lambda alpha: matting_loss(alpha, matte), (predicted.requires_grad_(),))
