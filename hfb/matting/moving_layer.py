"""A matte that a moving layer explains: a sharp outline and its colours, averaged on their way, before the plate.

I = mean_s (m c)(x - s v) + (1 - mean_s m(x - s v)) B, -1/2 < s < 1/2: the formation model of fast moving objects
(Rozumnyi et al., "The World of Fast Moving Objects", CVPR 2017), with a way v that may differ from place to place.
Where a ramp of the matte hides the body's colours, the layer has them from where the way leads inside. A network's
matte says where to begin and, by its doubt, how far to go from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch.nn import functional

from hfb.determinism import one_torch_thread
from hfb.matting import kernels_smear
from hfb.matting.matte_network import quiet_noise
from hfb.matting.second_look import unmixed_colours
from hfb.photometry import linear_to_srgb
from hfb.shapes import Array, Float, Shaped, Tensor

_LENGTHS = (0.03, 0.08, 0.15, 0.27)
"""Of the straight ways to begin with, as shares of the picture's longer side."""
_DIRECTIONS = 8
_INSTANTS = 8
_CELL_PX = 24
"""Of the grid that the way is interpolated from."""


class _Round(NamedTuple):
    """So many of the best candidates go so many steps at a size [px^2]; a free way may bend."""

    area: int
    kept: int
    steps: int
    free: bool


_SMALL, _LARGE = 2_500, 10_000
_ROUNDS = (
    _Round(_SMALL, 32, 8, False),
    _Round(_SMALL, 8, 12, True),
    _Round(_LARGE, 3, 20, True),
    _Round(_LARGE, 1, 50, True),
)
"""The first are short: longer ones would choose a soft outline that stands still, which explains a picture, too."""

_COLOUR_POWER = 4  # the first colours are of where the body covers most
_MODEL_ERROR = 0.005  # of the light: what the model leaves out
_ROBUST = 1.5  # standard deviations from where on errors count singly
_CORNER = 1e-4  # rounds |x| to sqrt(x^2 + 1e-4)
_MATTE, _SOFT, _COLOURS, _OUTLINE, _BEND = 0.3, 2.0, 5.0, 2.5, 1.0
"""Weights: the network's matte, what is neither in nor out, changes of colour, of the outline, of the way [1/px^2]."""
_RATES = (0.15, 0.02, 0.3)
"""Adam's, of the outline's logits, the colours' roots and the way [px]."""


@dataclass(frozen=True)
class _Scene:
    """What is given, at one size: pictures in linear light; the noise of their difference; the expected error."""

    frame: Float[Tensor, "H W 3"]
    plate: Float[Tensor, "H W 3"]
    noise: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W"]
    error: Float[Tensor, "H W"]

    @staticmethod
    def of(pictures: Sequence[Array], area: int) -> "_Scene":
        """Of frame and plate (H, W, 3), alpha and doubt (H, W), no larger than they are."""
        height, width = pictures[0].shape[:2]
        scale = min(1.0, float(np.sqrt(area / (height * width))))
        size = max(8, round(width * scale)), max(8, round(height * scale))
        frame, plate, alpha, doubt = (
            cv2.resize(one.astype(np.float32), size, interpolation=cv2.INTER_AREA) for one in pictures
        )
        noise = quiet_noise(linear_to_srgb(frame), linear_to_srgb(plate)) + _MODEL_ERROR * (frame + 0.05)
        error = np.exp(np.clip(doubt, -6, 1))
        return _Scene(*(torch.from_numpy(one.astype(np.float32)) for one in (frame, plate, noise, alpha, error)))


@dataclass(frozen=True)
class _Layers:
    """N candidates: an outline's logits, the square roots of its colours, and grids of the way across and down [px]."""

    logits: Float[Tensor, "N H W"]
    roots: Float[Tensor, "N H W 3"]
    ways: Float[Tensor, "N 2 h w"]

    @staticmethod
    def moved(scene: _Scene, ways: Float[Array, "N 2"]) -> "_Layers":
        """The network's matte, made sharper the longer the way, and the colours that it tells."""
        frame, plate, alpha = (one.numpy() for one in (scene.frame, scene.plate, scene.alpha))
        colours = unmixed_colours(frame, plate, alpha, _COLOUR_POWER)
        steepness = torch.from_numpy(4 + 0.8 * np.linalg.norm(ways, axis=1)).float()[:, None, None]
        return _Layers(
            steepness * (scene.alpha - 0.5),
            torch.from_numpy(np.sqrt(np.clip(colours, 0, 1))).expand(len(ways), -1, -1, -1),
            torch.from_numpy(ways).float()[:, :, None, None].expand(-1, -1, *_cells(scene)),
        )

    def chosen(self, which: Shaped[Tensor, "K"]) -> "_Layers":
        return _Layers(self.logits[which], self.roots[which], self.ways[which])

    def at(self, scene: _Scene) -> "_Layers":
        """At a scene's size."""
        height, width = scene.alpha.shape

        def larger(one: Tensor, size: tuple[int, int]) -> Tensor:
            return functional.interpolate(one, size, mode="bilinear", align_corners=False)

        scale = torch.tensor([width / self.logits.shape[2], height / self.logits.shape[1]])[:, None, None]
        return _Layers(
            larger(self.logits[:, None], (height, width))[:, 0],
            larger(self.roots.permute(0, 3, 1, 2), (height, width)).permute(0, 2, 3, 1),
            larger(self.ways, _cells(scene)) * scale,
        )


def _cells(scene: _Scene) -> tuple[int, int]:
    height, width = scene.alpha.shape
    return max(2, height // _CELL_PX), max(2, width // _CELL_PX)


class Smear(torch.autograd.Function):
    """Means of layers (N, H, W, 4) on their ways (N, H, W, 2) [px], float32: see `kernels_smear`."""

    @staticmethod
    def forward(ctx: Any, layers: Tensor, way: Tensor) -> Tensor:
        smeared = torch.empty_like(layers)
        kernels_smear.smear(layers.numpy(), way.numpy(), _INSTANTS, smeared.numpy())
        ctx.save_for_backward(layers, way)
        return smeared

    @staticmethod
    def backward(ctx: Any, *given: Tensor) -> tuple[Tensor, Tensor]:
        layers, way = ctx.saved_tensors
        found = torch.zeros_like(layers), torch.empty_like(way)
        arrays = (one.numpy() for one in (given[0].contiguous(), *found))
        kernels_smear.smear_gradient(layers.numpy(), way.numpy(), _INSTANTS, *arrays)
        return found


def explained_matte(
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    alpha: Float[Array, "H W"],
    doubt: Float[Array, "H W"],
) -> Float[Array, "H W"]:
    """The matte of the moving layer that explains the frame best, found from a network's.

    Many straight ways are tried at a small size; the best go on, may bend, and grow. Finer details than the last size
    stay the network's, and no pixel goes further from its matte than its expected error. One to two seconds, the same
    on every run.

    Args:
        frame_linear, plate_linear: in [0, 1]; the plate already has the frame's exposure.
        alpha: a network's matte. doubt: the logarithm of its expected error.
    """
    given = frame_linear, plate_linear, alpha, doubt
    with one_torch_thread(), torch.inference_mode(False), torch.enable_grad():
        scene, area = _Scene.of(given, _SMALL), _SMALL
        layers = _Layers.moved(scene, _straight_ways(max(scene.alpha.shape)))
        losses, found = torch.zeros(len(layers.logits)), scene.alpha[None]
        for step in _ROUNDS:
            layers = layers.chosen(losses.argsort(stable=True)[: step.kept])
            if step.area != area:
                scene, area = _Scene.of(given, step.area), step.area
                layers = layers.at(scene)
            layers, losses, found = _follow(layers, scene, step)
    change = cv2.resize((found[0] - scene.alpha).numpy(), alpha.shape[::-1], interpolation=cv2.INTER_LINEAR)
    most = np.exp(doubt)  # the layer takes every change for the body, a shadow, too; the network knows better
    return np.clip(alpha + np.clip(change, -most, most), 0, 1)


def _straight_ways(longer_px: int) -> Float[Array, "N 2"]:
    angles = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    lengths = longer_px * np.array(_LENGTHS)
    return (lengths[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], -1)).reshape(-1, 2)


def _follow(layers: _Layers, scene: _Scene, step: _Round) -> tuple[_Layers, Float[Tensor, "N"], Float[Tensor, "N H W"]]:
    """Adam on all candidates at once: the layers, their losses and their mattes, one step older."""
    logits, roots, ways = variables = [
        one.clone().contiguous().requires_grad_(free)
        for one, free in ((layers.logits, True), (layers.roots, True), (layers.ways, step.free))
    ]
    groups = [{"params": [one], "lr": rate} for one, rate in zip(variables, _RATES, strict=True) if one.requires_grad]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.95), foreach=False)
    for _ in range(step.steps):
        outline = torch.sigmoid(logits)
        way = functional.interpolate(ways, outline.shape[1:], mode="bilinear", align_corners=True)
        coloured = outline[..., None] * roots * roots
        smeared = Smear.apply(torch.cat([outline[..., None], coloured], -1), way.permute(0, 2, 3, 1).contiguous())
        losses = _losses(smeared, outline, roots, scene)
        if step.free:
            losses = losses + _BEND * sum((ways.diff(dim=axis) ** 2).sum((1, 2, 3)) for axis in (2, 3))
        optimizer.zero_grad()
        losses.sum().backward()
        optimizer.step()
    return _Layers(*(one.detach() for one in variables)), losses.detach(), smeared[..., 0].detach()


def _losses(
    smeared: Float[Tensor, "N H W 4"],
    outline: Float[Tensor, "N H W"],
    roots: Float[Tensor, "N H W 3"],
    scene: _Scene,
) -> Float[Tensor, "N"]:
    """Of each candidate: what of the picture and of the network's matte it leaves unexplained, and how odd it is."""
    alpha = smeared[..., 0]
    apart = (scene.frame - smeared[..., 1:] - (1 - alpha[..., None]) * scene.plate) / scene.noise
    rest = _ROBUST * (torch.sqrt(1 + (apart * apart).sum(-1) / _ROBUST**2) - 1)
    from_network = torch.sqrt((alpha - scene.alpha) ** 2 + _CORNER) / scene.error
    losses = (rest + _MATTE * from_network + _SOFT * outline * (1 - outline)).sum((1, 2))
    for axis in (1, 2):
        colours, edge = roots.diff(dim=axis), outline.diff(dim=axis)
        losses = losses + _COLOURS * torch.sqrt((colours * colours).sum(-1) + _CORNER).sum((1, 2))
        losses = losses + _OUTLINE * torch.sqrt(edge * edge + _CORNER).sum((1, 2))
    return losses
