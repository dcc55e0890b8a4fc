"""The layer on its way: the compiled mean and its gradient, and mattes that it explains."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from hfb.matting.moving_layer import Smear, explained_matte
from tests.matting.silhouettes import generated_plate


def layers_on_ways(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    layers = torch.rand(2, 9, 11, 4, generator=generator)
    way = torch.randn(2, 9, 11, 2, generator=generator) * 3
    return layers, way


def test_still_layers_stay_and_a_spot_becomes_a_line() -> None:
    layers, way = layers_on_ways(1)
    assert torch.allclose(Smear.apply(layers, torch.zeros_like(way)), layers, atol=1e-6)
    spot = torch.zeros(1, 9, 17, 4)
    spot[0, 4, 8] = 1
    line = Smear.apply(spot, torch.tensor([8.0, 0.0]).expand(1, 9, 17, 2).contiguous())
    assert line.sum().item() == pytest.approx(4, abs=1e-5)
    assert line[0, 4, 4:12, 0].tolist() == pytest.approx([1 / 16, *[1 / 8] * 7], abs=1e-6)


def test_gradient_is_that_of_finite_differences() -> None:
    """float32: the largest step that stays between the same pixels for nearly all instants, and a mean of many."""
    layers, way = layers_on_ways(2)
    given = torch.randn(layers.shape, generator=torch.Generator().manual_seed(3))
    layers.requires_grad_()
    way.requires_grad_()
    (Smear.apply(layers, way) * given).sum().backward()
    for variable, step in ((layers, 1e-1), (way, 1e-3)):
        along = torch.randn(variable.shape, generator=torch.Generator().manual_seed(4))
        assert variable.grad is not None

        def moved(amount: float, variable: torch.Tensor = variable, along: torch.Tensor = along) -> float:
            both = [one.detach() + amount * along if one is variable else one.detach() for one in (layers, way)]
            return (Smear.apply(*both).double() * given).sum().item()

        measured = (moved(step) - moved(-step)) / (2 * step)
        assert (variable.grad * along).sum().item() == pytest.approx(measured, rel=1e-2)


def test_mean_and_gradients_are_those_of_grid_sample() -> None:
    """Also where a way leads out of the picture."""
    layers, way = layers_on_ways(5)
    _, height, width, _ = layers.shape
    instants = (torch.arange(8) + 0.5) / 8 - 0.5
    given = torch.randn(layers.shape, generator=torch.Generator().manual_seed(6))
    found = []
    for ours in (True, False):
        moving, along = layers.clone().requires_grad_(), way.clone().requires_grad_()
        if ours:
            mean = Smear.apply(moving, along)
        else:
            rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
            places = torch.stack([columns, rows], -1) - instants[:, None, None, None, None] * along
            grid = places * torch.tensor([2 / (width - 1), 2 / (height - 1)]) - 1
            pictures = moving.permute(0, 3, 1, 2)
            drawn = [
                functional.grid_sample(pictures, one, padding_mode="border", align_corners=True).permute(0, 2, 3, 1)
                for one in grid
            ]
            mean = torch.stack(drawn).mean(0)
        mean.backward(given)
        found.append((mean.detach(), moving.grad, along.grad))
    for one, other in zip(*found, strict=True):
        assert torch.allclose(one, other, atol=1e-5)


def moved_disc(width_px: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A disc in two colours that moves to the right before stripes: frame, plate, alpha."""
    plate = np.ascontiguousarray(generated_plate("stripes", 128, 160))
    rows, columns = np.mgrid[:128, :160].astype(np.float32)
    frame, alpha = np.zeros_like(plate), np.zeros((128, 160), np.float32)
    colours = np.array([[0.7, 0.15, 0.1], [0.1, 0.2, 0.6]], np.float32)
    for shift in (np.arange(32) + 0.5) / 32 * width_px - width_px / 2:
        inside = np.clip(31 - np.hypot(rows - 64, columns - 80 - shift), 0, 1)
        frame += inside[..., None] * colours[(rows > 64).astype(int)] / 32
        alpha += inside / 32
    return frame + (1 - alpha[..., None]) * plate, plate, alpha


def test_a_ramp_is_found_from_a_worse_matte() -> None:
    """A network's matte that is unsure of the ramp and wrong there: the layer brings back most of it."""
    frame, plate, alpha = moved_disc(24)
    band = (alpha > 0.05) & (alpha < 0.95)
    rough = np.where(band, np.clip(alpha + 0.25 * np.sin(np.arange(160) / 3)[None], 0, 1), alpha).astype(np.float32)
    doubt = np.where(band, np.log(0.25), -6).astype(np.float32)
    found = explained_matte(frame, plate, rough, doubt)
    assert found.dtype == np.float32
    assert np.abs(rough - alpha)[band].mean() > 0.1
    assert np.abs(found - alpha)[band].mean() < 0.03
    assert np.abs(found - alpha)[~band].max() < 0.1
    assert np.array_equal(found, explained_matte(frame, plate, rough, doubt))
    surer = explained_matte(frame, plate, rough, doubt - 2)
    assert (np.abs(surer - rough) <= np.exp(doubt - 2) + 1e-6).all()


def test_a_sure_matte_stays() -> None:
    frame, plate, alpha = moved_disc(12)
    sure = np.full_like(alpha, -6)
    assert np.abs(explained_matte(frame, plate, alpha, sure) - alpha).mean() < 0.005


@pytest.mark.parametrize("size", [(2, 3), (1, 40), (64, 9)])
def test_any_size(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    frame, plate = rng.random((2, *size, 3)).astype(np.float32)
    alpha = rng.random(size).astype(np.float32)
    found = explained_matte(frame, plate, alpha, np.full_like(alpha, -2))
    assert found.shape == size
    assert np.isfinite(found).all()
