"""The image loss: its formula by hand, and what it does not depend on."""

import pytest
import torch

from hfb.objective.image import image_loss, robust_image_loss


def test_one_wrong_channel_by_hand():
    observed = torch.zeros(2, 2, 3)
    predicted = observed.clone()
    predicted[0, 1, 2] = 0.5
    assert image_loss(predicted, observed, torch.tensor(2.0)).item() == pytest.approx(0.25 / 3 / 2)


@pytest.mark.parametrize("loss", [image_loss, robust_image_loss])
def test_more_background_around_the_person_changes_nothing(loss):
    generator = torch.Generator().manual_seed(0)
    observed, predicted = torch.rand(2, 6, 5, 3, generator=generator)
    wide = torch.nn.functional.pad
    around = (0, 0, 4, 4, 3, 3)
    area = torch.tensor(7.0)
    torch.testing.assert_close(
        loss(predicted, observed, area), loss(wide(predicted, around), wide(observed, around), area)
    )


@pytest.mark.parametrize("loss", [image_loss, robust_image_loss])
def test_a_perfect_prediction_costs_nothing_and_has_no_gradient(loss):
    observed = torch.rand(3, 4, 3, dtype=torch.float64)
    predicted = observed.clone().requires_grad_()
    value = loss(predicted, observed, torch.zeros((), dtype=torch.float64))
    value.backward()
    assert value.item() == 0
    assert torch.equal(predicted.grad, torch.zeros_like(observed))


@pytest.mark.parametrize("loss", [image_loss, robust_image_loss])
def test_gradients_match_finite_differences(loss):
    generator = torch.Generator().manual_seed(1)
    predicted, observed = torch.rand(2, 2, 3, 3, dtype=torch.float64, generator=generator)
    area = torch.tensor(4.0, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda picture: loss(picture, observed, area), (predicted.requires_grad_(),))


def test_the_robust_loss_is_a_line_far_out():
    observed, area = torch.zeros(1, 1, 3, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)
    far = [robust_image_loss(torch.full_like(observed, d), observed, area, scale=1e-3).item() for d in (0.5, 1.0)]
    assert far == pytest.approx([0.5, 1.0], abs=1.1e-3)
