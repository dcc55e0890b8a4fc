"""The layer on its way: the compiled objective against torch's, and mattes that it explains."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch.nn import functional

from hfb.kernels import matting_layer as kernels_layer
from hfb.matting.moving_layer import explained_matte
from tests.matting.silhouettes import generated_plate


def room(height: int, width: int, cells: tuple[int, int]) -> list[np.ndarray]:
    shapes = (height, width, 2), (4, height, width, 4), (height, width), (height, width, 3), (height, width, 2)
    return [np.empty(shape, np.float32) for shape in (*shapes, (2, *cells))]


@dataclass
class Case:
    """A layer that does not fit a scene; float64 for the reference."""

    scene: torch.Tensor
    base: torch.Tensor
    outline: torch.Tensor
    roots: torch.Tensor
    bend: torch.Tensor
    weights: torch.Tensor

    @staticmethod
    def drawn(seed: int, height: int = 14, width: int = 11) -> "Case":
        rng = torch.Generator().manual_seed(seed)

        def uniform(*shape: int) -> torch.Tensor:
            return torch.rand(*shape, generator=rng, dtype=torch.float64).float().double()

        scene = uniform(height, width, 11)
        scene[..., 6:9] *= 30
        base = 6 * (uniform(height, width, 2) - 0.5)  # some lead out of the picture
        weights = torch.tensor([1.5, 2.0, 5.0, 2.5, 1.0], dtype=torch.float64)
        return Case(scene, base, uniform(height, width), uniform(height, width, 3), uniform(2, 3, 2) - 0.5, weights)

    def compiled(self) -> tuple[float, list[np.ndarray]]:
        """The kernel's loss, the smeared layer, and gradients of outline, roots and bend."""
        given = [
            one.float().numpy() for one in (self.scene, self.weights, self.base, self.outline, self.roots, self.bend)
        ]
        arrays = room(*self.outline.shape, tuple(self.bend.shape[1:]))
        loss = kernels_layer.objective(*given, *arrays)
        return loss, [arrays[1][1], arrays[2], arrays[3], arrays[5]]

    def logits(self) -> torch.Tensor:
        """Of the outline, as a descent begins with them."""
        return torch.logit(self.outline.clamp(0.1, 0.9)).float().double()

    def descended(self, rates: np.ndarray, steps: int) -> tuple[float, list[np.ndarray]]:
        """The kernel's last loss; logits, roots and bend after those steps."""
        mine = [one.float().numpy().copy() for one in (self.logits(), self.roots, self.bend)]
        shape, cells = self.outline.shape, self.bend.shape[1:]
        shapes = (*shape, 2), (4, *shape, 4), (4, *shape), (3, *shape, 3), (*shape, 2), (3, 2, *cells)
        work = [np.empty(one, np.float32) for one in shapes]
        given = [one.float().numpy() for one in (self.scene, self.weights, self.base)]
        return kernels_layer.descend(*given, rates, steps, *mine, *work), mine

    def reference(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The same, written for reading: the loss and the smeared layer."""
        height, width = self.outline.shape
        grid = functional.interpolate(self.bend[None], (height, width), mode="bilinear", align_corners=True)[0]
        smeared = smear(
            torch.cat([self.outline[..., None], self.outline[..., None] * self.roots**2], -1),
            self.base + grid.permute(1, 2, 0),
        )
        frame, plate, surety = self.scene[..., :9].split(3, -1)
        alpha, trust = self.scene[..., 9], self.scene[..., 10]
        robust, soft, changes, edges, bends = self.weights
        apart = (frame - smeared[..., 1:] - (1 - smeared[..., :1]) * plate) * surety
        loss = (robust * (torch.sqrt(1 + (apart**2).sum(-1) / robust**2) - 1)).sum()
        loss = loss + (trust * torch.sqrt((smeared[..., 0] - alpha) ** 2 + 1e-4)).sum()
        loss = loss + soft * (self.outline * (1 - self.outline)).sum()
        for axis in (0, 1):
            loss = loss + changes * torch.sqrt((self.roots.diff(dim=axis) ** 2).sum(-1) + 1e-4).sum()
            loss = loss + edges * torch.sqrt(self.outline.diff(dim=axis) ** 2 + 1e-4).sum()
            loss = loss + bends * (self.bend.diff(dim=1 + axis) ** 2).sum()
        return loss, smeared


def smear(layer: torch.Tensor, way: torch.Tensor) -> torch.Tensor:
    """By torch: the mean over the instants s of a layer (H, W, 4) at x - s way(x)."""
    height, width, _ = layer.shape
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    instants = (torch.arange(8, dtype=torch.float64) + 0.5) / 8 - 0.5
    places = torch.stack([columns, rows], -1) - instants[:, None, None, None] * way
    grid = places * torch.tensor([2 / (width - 1), 2 / (height - 1)], dtype=torch.float64) - 1
    pictures = layer.permute(2, 0, 1).expand(8, -1, -1, -1)
    drawn = functional.grid_sample(pictures, grid, padding_mode="border", align_corners=True)
    return drawn.mean(0).permute(1, 2, 0)


@pytest.mark.parametrize("seed", range(3))
def test_loss_and_gradients_are_those_of_torch(seed: int) -> None:
    """The compiled objective in float32 against autograd in float64; also where a way leads out of the picture."""
    case = Case.drawn(seed)
    loss, (smeared, *gradients) = case.compiled()
    variables = [case.outline.requires_grad_(), case.roots.requires_grad_(), case.bend.requires_grad_()]
    wanted, mean = case.reference()
    wanted.backward()
    assert loss == pytest.approx(wanted.item(), rel=1e-5)
    assert np.allclose(smeared, mean.detach(), atol=1e-5)
    for mine, variable in zip(gradients, variables, strict=True):
        assert variable.grad is not None
        theirs = variable.grad.numpy()
        assert np.linalg.norm(mine - theirs) < 1e-4 * np.linalg.norm(theirs)


def test_still_layers_stay_and_a_spot_becomes_a_line() -> None:
    still, spot = Case.drawn(1), Case.drawn(2, 9, 17)
    still.base.zero_()
    still.bend.zero_()
    _, (smeared, *_) = still.compiled()
    assert np.allclose(smeared[..., 0], still.outline, atol=1e-6)
    spot.outline.zero_()
    spot.outline[4, 8] = 1
    spot.base[:] = torch.tensor([8.0, 0.0])
    spot.bend.zero_()
    _, (line, *_) = spot.compiled()
    assert line[..., 0].sum() == pytest.approx(1, abs=1e-5)
    assert line[4, 4:12, 0].tolist() == pytest.approx([1 / 16, *[1 / 8] * 7], abs=1e-6)


def test_descent_is_adam() -> None:
    """Its variables after a few steps against torch's optimiser on the reference."""
    case = Case.drawn(4)
    rates = np.array([0.15, 0.02, 0.3], np.float32)
    loss, mine = case.descended(rates, 4)
    logits = case.logits()
    variables = [one.clone().requires_grad_() for one in (logits, case.roots, case.bend)]
    groups = [{"params": [one], "lr": float(rate)} for one, rate in zip(variables, rates, strict=True)]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.95))
    for _ in range(4):
        optimizer.zero_grad()
        case.outline, case.roots, case.bend = torch.sigmoid(variables[0]), variables[1], variables[2]
        wanted, _ = case.reference()
        wanted.backward()
        optimizer.step()
    assert loss == pytest.approx(wanted.item(), rel=1e-5)
    for one, other in zip(mine, variables, strict=True):
        assert np.abs(one - other.detach().numpy()).max() < 2e-3


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
    far = 24 / 160  # no pixel goes further than its expected error, more where the way is long
    surer = explained_matte(frame, plate, rough, doubt - 4)
    assert (np.abs(surer - rough) <= np.exp(doubt - 4) * (1 + 1.5 * far / 0.03) + 1e-6).all()


def test_what_stands_still_goes_no_further_than_the_expected_error() -> None:
    """A disc at rest and, for a shadow, a gray stripe of the plate beside it, of which the matte knows nothing."""
    frame, plate, alpha = moved_disc(0)
    frame[100:110, 60:100] *= 0.7
    doubt = np.full_like(alpha, np.log(0.02))
    found = explained_matte(frame, plate, alpha, doubt)
    assert np.abs(found - alpha).max() < 0.02 * 1.7


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
