"""The compiled anatomical prior against the readable one."""

import pytest
import torch

from hfb.kernels.objective import anatomy_operators as operators
from hfb.priors.anatomy import AnatomicalPrior, _tables

PRIOR = AnatomicalPrior()


def poses(kind: str) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(40, 23, 3, generator=generator, dtype=torch.float64), dim=-1)
    lengths = torch.rand(40, 23, 1, generator=generator, dtype=torch.float64)
    if kind == "about an axis":  # pure twists and pure swings
        directions = torch.eye(3, dtype=torch.float64)[torch.randint(3, (40, 23), generator=generator)]
    longest = {"rest": 0.0, "tiny": 1e-4, "small": 2e-2, "ordinary": 2.0, "beyond a turn": 9.0, "about an axis": 3.0}
    return lengths * longest[kind] * directions


@pytest.mark.parametrize("kind", ["rest", "tiny", "small", "ordinary", "beyond a turn", "about an axis"])
def test_values_and_gradients_are_the_readable_ones(kind: str) -> None:
    asked = torch.rand(40, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    results = []
    for prior in (PRIOR, PRIOR.readable):
        leaf = poses(kind).requires_grad_()
        values = prior(leaf)
        (values * asked).sum().backward()
        results.append((values.detach(), leaf.grad))
    for found, expected in zip(*results, strict=True):
        assert (found - expected).norm() <= 1e-9 * expected.norm()


def test_half_a_turn_of_swing_stays_finite() -> None:
    """Where twist is undefined."""
    leaf = torch.zeros(1, 23, 3)
    for joint, (twist, *_) in enumerate(_tables(torch.float32, torch.device("cpu")).order.tolist()):
        leaf[0, joint, (twist + 1) % 3] = torch.pi
    leaf.requires_grad_()
    PRIOR(leaf).sum().backward()
    assert leaf.grad is not None
    assert leaf.grad.isfinite().all()


def test_single_precision_and_the_operator_is_well_formed() -> None:
    pose = poses("ordinary")[:3]
    torch.testing.assert_close(PRIOR(pose.float()), PRIOR(pose).float())
    tables = _tables(torch.float64, torch.device("cpu"))
    arguments = (pose.requires_grad_(), tables.order, tables.angles, 0.07)
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(operators.anatomy.registered, arguments, test_utils=checks)
