"""Distance from what a network saw."""

import pytest
import torch

from hfb.evidence.robust import evidence_loss


def test_zero_at_the_claim_quadratic_near_it_linear_far_away() -> None:
    ones = torch.ones(1, 24, 3, dtype=torch.float64)
    assert float(evidence_loss(0 * ones)) == 0
    assert float(evidence_loss(1e-3 * ones)) == pytest.approx(0.5e-6, rel=1e-3)
    assert float(evidence_loss(1000 * ones)) == pytest.approx(999, rel=1e-5)


def test_gradient_is_that_of_finite_differences_and_zero_at_the_claim() -> None:
    off = torch.randn(2, 24, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.gradcheck(evidence_loss, off)
    still = torch.zeros(1, 24, 3, requires_grad=True)
    evidence_loss(still).backward()
    assert torch.equal(still.grad, torch.zeros_like(still))


def test_a_share_weighs_the_coordinates_it_belongs_to() -> None:
    off = torch.randn(2, 24, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    across, depth = evidence_loss(off[..., :2]), evidence_loss(off[..., 2:])
    share = off.new_tensor([0.2, 0.2, 1.0])
    torch.testing.assert_close(evidence_loss(off, share), (2 * 0.2 * across + depth) / 3)
