"""How tall a shape stands, and the nearest shape of a given height."""

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import as_tall, height_m

BODY = load_default_body()


def test_it_is_the_extent_of_the_rest_pose() -> None:
    generator = torch.Generator().manual_seed(1)
    for betas in torch.randn(30, 10, generator=generator):
        upright = BODY.shape(betas).vertices[:, 1]
        assert float(height_m(BODY, betas)) == pytest.approx(float(upright.max() - upright.min()), abs=0.01)


def test_many_at_once() -> None:
    betas = torch.randn(4, 3, 10, generator=torch.Generator().manual_seed(3))
    one_by_one = torch.stack([height_m(BODY, one) for row in betas for one in row])
    assert torch.allclose(height_m(BODY, betas).flatten(), one_by_one, atol=1e-6)


@pytest.mark.parametrize("wanted", [1.0, 1.5, 1.93, 2.4])
def test_the_nearest_shape_of_a_height(wanted: float) -> None:
    generator = torch.Generator().manual_seed(2)
    betas, other = torch.randn(2, 10, generator=generator)
    found = as_tall(betas, BODY, wanted)
    assert float(height_m(BODY, found)) == pytest.approx(wanted, abs=1e-5)
    assert torch.allclose(as_tall(found, BODY, wanted), found, atol=1e-6)
    # The way there is at right angles to every way that keeps the height.
    along = as_tall(other, BODY, wanted) - found
    assert abs(float((found - betas) @ along)) < 1e-4 * float((found - betas).norm() * along.norm())


def test_it_is_in_the_precision_of_the_betas() -> None:
    assert as_tall(torch.zeros(10, dtype=torch.float64), BODY, 1.8).dtype == torch.float64
