"""Our Adam takes torch's steps."""

import pytest
import torch

from hfb.kernels.adam import Adam


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-5)])
def test_steps_are_those_of_torch(dtype: torch.dtype, tolerance: float) -> None:
    """Rates that change, a tensor that nobody asks anything of, and gradients of many sizes, zero among them."""
    generator = torch.Generator().manual_seed(0)
    shapes = (3, 24, 4), (10,), (5, 5, 3), (2,)
    starts = [torch.randn(shape, generator=generator, dtype=dtype) for shape in shapes]
    starts[0] = starts[0].transpose(0, 2)  # not one number after the other
    mine, theirs = ([one.clone().requires_grad_() for one in starts] for _ in range(2))
    assert not mine[0].is_contiguous()
    for one in mine:
        one.grad = torch.ones_like(one)  # another optimiser's, whose last gradients are still there
    ours = Adam(mine, 1e-6)
    torchs = torch.optim.Adam([{"params": [one], "lr": 0.0} for one in theirs], eps=1e-6)
    for step in range(50):
        rates = [0.1 / (step + 1), 0.01, 0.3, 1.0]
        for one, other in zip(mine[:3], theirs[:3], strict=True):
            size = 10.0 ** torch.randint(-6, 3, one.shape, generator=generator)
            given = (
                torch.randn(one.shape, generator=generator) * size * (torch.rand(one.shape, generator=generator) < 0.8)
            ).to(dtype)
            one.grad, other.grad = given, given.clone()
        for group, rate in zip(torchs.param_groups, rates, strict=True):
            group["lr"] = rate
        ours.step(rates)
        torchs.step()
        assert all(one.grad is None for one in mine)
    for one, other, start in zip(mine, theirs, starts, strict=True):
        assert (one - other).norm() <= tolerance * other.norm()
        assert (one - start).norm() > 0.1 or one is mine[3]
    assert torch.equal(mine[3], starts[3])
