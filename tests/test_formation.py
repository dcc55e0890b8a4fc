"""Laws of eq. (1)."""

import torch

from hfb.rendering.formation import compose


def test_nobody_leaves_the_plate_and_a_full_cover_hides_it() -> None:
    plate = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(compose(torch.zeros(4, 5, 4), plate), plate)
    full = torch.rand(4, 5, 4, generator=torch.Generator().manual_seed(1))
    full[..., 3] = 1
    torch.testing.assert_close(compose(full, plate), full[..., :3])


def test_blur_is_the_mean_of_the_composites() -> None:
    """Averaging sub-frames before or after compositing is the same: eq. (1) is linear."""
    generator = torch.Generator().manual_seed(0)
    plate = torch.rand(4, 5, 3, generator=generator)
    alpha = torch.rand(6, 4, 5, 1, generator=generator)
    foreground = torch.cat([alpha * torch.rand(6, 4, 5, 3, generator=generator), alpha], -1)
    each = torch.stack([compose(one, plate) for one in foreground])
    torch.testing.assert_close(compose(foreground.mean(0), plate), each.mean(0))
