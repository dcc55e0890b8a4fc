"""The compiled picture losses against the readable ones: values and gradients at every size and number of scales."""

import numpy as np
import pytest
import torch

from hfb.kernels.objective.image_losses import Target
from hfb.objective.pyramid import image_over_scales, matte_over_scales

Scales = tuple[int, int]


def pictures(height: int, width: int, dtype: torch.dtype = torch.float64) -> list[torch.Tensor]:
    """mean, plate, frame, matte; with pixels where the two silhouettes are equal, empty and full."""
    generator = torch.Generator().manual_seed(0)
    mean, plate, frame, matte = (
        torch.rand(height, width, channels, generator=generator, dtype=dtype) for channels in (4, 3, 3, 1)
    )
    matte, alpha = 1.6 * matte[..., 0] - 0.3, 1.6 * mean[..., 3] - 0.3
    mean[..., 3] = torch.where(alpha > 0.9, matte, alpha)
    mean[..., 3].clamp_(0, 1)
    return [mean, plate, frame, matte.clamp(0, 1)]


def readable(leaf: torch.Tensor, *seen: torch.Tensor, scales: Scales) -> tuple[torch.Tensor, torch.Tensor]:
    nothing = leaf.sum() * 0
    image = image_over_scales(leaf, *seen, scales[0]) if scales[0] else nothing
    return image, matte_over_scales(leaf[..., 3], seen[2], scales[1]) if scales[1] else nothing


@pytest.mark.parametrize("scales", [(1, 1), (3, 5), (8, 8), (2, 0), (0, 2)])
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (37, 50)])
def test_values_and_gradients_are_the_readable_ones(size: tuple[int, int], scales: Scales) -> None:
    mean, *seen = pictures(*size)
    results = []
    for fast in (True, False):
        leaf = mean.clone().requires_grad_()
        values = Target(*seen, *scales).losses(leaf) if fast else readable(leaf, *seen, scales=scales)
        (3 * values[0] + 2 * values[1]).backward()
        results.append((torch.stack(values).detach(), leaf.grad))
    for found, expected in zip(*results, strict=True):
        assert (found - expected).norm() <= 1e-12 * expected.norm() + 1e-14


def test_single_precision() -> None:
    mean, *seen = pictures(24, 17, torch.float32)
    leaf = mean.clone().requires_grad_()
    image, overlap = Target(*seen, 2, 3).losses(leaf)
    assert image.dtype == overlap.dtype == torch.float32
    torch.testing.assert_close(image, image_over_scales(mean, *seen, 2))
    overlap.backward()
    assert leaf.grad.dtype == torch.float32
    assert not leaf.grad[..., :3].any()


@pytest.mark.parametrize("scales", [(1, 1), (3, 5), (2, 0), (0, 4)])
@pytest.mark.parametrize("box", [(3, 4, 40, 20), (17, 9, 18, 10), (0, 0, 50, 37), (48, 30, 50, 37), (50, 37, 50, 37)])
def test_a_box_around_what_is_drawn_is_enough(box: tuple[int, int, int, int], scales: Scales) -> None:
    mean, *seen = pictures(37, 50)
    left, top, right, bottom = box
    drawn = torch.zeros_like(mean)
    drawn[top:bottom, left:right] = mean[top:bottom, left:right]
    leaf, target = drawn.clone().requires_grad_(), Target(*seen, *scales)
    values = readable(leaf, *seen, scales=scales)
    (3 * values[0] + 2 * values[1]).backward()
    losses, compared = target.compare(drawn.numpy().copy(), box)
    np.testing.assert_allclose(losses, [one.item() for one in values], rtol=1e-12, atol=1e-14)
    for _ in range(2):  # the way back may be gone twice
        gradient = target.backward(compared, [3.0, 2.0])[top:bottom, left:right]
        np.testing.assert_allclose(gradient, leaf.grad[top:bottom, left:right], rtol=1e-11, atol=1e-14)


def test_a_picture_of_another_size_is_refused() -> None:
    mean, *seen = pictures(9, 8)
    with pytest.raises(ValueError, match="pixels"):
        Target(*seen, 1, 1).losses(mean.transpose(0, 1))


def test_what_is_not_a_number_is_told() -> None:
    for channel in (0, 3):
        mean, *seen = pictures(9, 8)
        mean[4, 4, channel] = float("nan")
        assert any(value.isnan() for value in Target(*seen, 2, 3).losses(mean))
