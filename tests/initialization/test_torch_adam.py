"""Adam without torch's compiler has the bits of torch's own."""

import pytest
import torch

from hfb.initialization.torch_adam import Adam


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("falls", [False, True])
def test_the_bits_of_torch(dtype: torch.dtype, falls: bool) -> None:
    generator = torch.Generator().manual_seed(57)
    starts = [torch.randn(shape, generator=generator, dtype=dtype) for shape in ((7, 23, 3), (7, 3))]
    ours, theirs = ([one.clone().requires_grad_() for one in starts] for _ in range(2))
    optimiser = Adam([(ours[0], 0.03), (ours[1], 0.012)], betas=(0.8, 0.95), cosine=(60, 0.002) if falls else None)
    groups = [{"params": [theirs[0]], "lr": 0.03}, {"params": [theirs[1]], "lr": 0.012}]
    reference = torch.optim.Adam(groups, betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(reference, 60, 0.002)
    for _ in range(60):
        reference.zero_grad()
        for joints, places in (ours, theirs):
            ((joints**2).sum() + torch.sin(3 * places).sum() + (joints[:, 0] * places).sum()).backward()
        optimiser.step()
        reference.step()
        if falls:
            schedule.step()
    assert all(torch.equal(one, other) for one, other in zip(ours, theirs, strict=True))
    assert all(one.grad is None for one in ours)
