"""The compiled picture losses against the readable ones: values and gradients at every size and number of scales."""

import pytest
import torch

from hfb.losses import operators
from hfb.losses.operators import compare_mattes, compare_pictures
from hfb.losses.scales import image_over_scales, matte_over_scales


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


@pytest.mark.parametrize("scales", [(1, 1), (3, 5), (8, 8), (2, 0), (0, 2)])
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (37, 50)])
def test_values_and_gradients_are_the_readable_ones(size: tuple[int, int], scales: tuple[int, int]) -> None:
    mean, plate, frame, matte = pictures(*size)
    results = []
    for fast in (True, False):
        leaf = mean.clone().requires_grad_()
        nothing = leaf.sum() * 0
        if fast:
            values = compare_pictures(leaf, plate, frame, matte, *scales)
        else:
            image = image_over_scales(leaf, plate, frame, matte, scales[0]) if scales[0] else nothing
            values = image, matte_over_scales(leaf[..., 3], matte, scales[1]) if scales[1] else nothing
        (3 * values[0] + 2 * values[1]).backward()
        results.append((torch.stack(values).detach(), leaf.grad))
    for found, expected in zip(*results, strict=True):
        assert (found - expected).norm() <= 1e-12 * expected.norm() + 1e-14


def test_a_silhouette_alone_and_single_precision() -> None:
    mean, plate, frame, matte = pictures(24, 17, torch.float32)
    alpha = mean[..., 3].clone().requires_grad_()
    compare_mattes(alpha, matte, 3).backward()
    leaf = mean.clone().requires_grad_()
    image, overlap = compare_pictures(leaf, plate, frame, matte, 2, 3)
    assert image.dtype == overlap.dtype == torch.float32
    torch.testing.assert_close(image, image_over_scales(mean, plate, frame, matte, 2))
    overlap.backward()
    assert torch.equal(leaf.grad[..., 3], alpha.grad)
    assert not leaf.grad[..., :3].any()


def test_the_operator_is_well_formed() -> None:
    mean, plate, frame, matte = pictures(6, 5)
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    for scales in ((2, 3), (0, 1), (1, 0)):
        arguments = (mean.clone().requires_grad_(), plate, frame, matte, *scales)
        torch.library.opcheck(operators._compare.registered, arguments, test_utils=checks)
