"""Matting by a moving layer: a sharp outline and its colours, averaged along its way, over the plate.

I = mean_s (m c)(x - s v) + (1 - mean_s m(x - s v)) B, -1/2 < s < 1/2: the formation model of fast moving objects
(Rozumnyi et al., "The World of Fast Moving Objects", CVPR 2017), with a way v that may vary in the image. Where a ramp
of the matte hides the body's colours, the layer takes them from inside along the way. A network's matte is the start,
and its doubt bounds the distance from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
import torch

from hfb.kernels import matting_layer as kernels_layer
from hfb.kernels.threads import run_tasks
from hfb.matting.matte_network import quiet_noise
from hfb.matting.second_look import unmixed_colours
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

_LENGTHS = (0.03, 0.06, 0.11, 0.2, 0.3)
"""Lengths of the initial straight ways, as shares of the image's longer side."""
_DIRECTIONS = 8
_CELL_PX = 24
"""Cell size of the grid that bends a way."""


class _Round(NamedTuple):
    """A round of the search: steps at a size [px^2] for all candidates, of which the best are kept."""

    area: int
    steps: int
    kept: int
    free: bool


_SMALL, _LARGE, _LAST = 2_500, 10_000, 25_000
_ROUNDS = (
    _Round(_SMALL, 8, 6, False),
    _Round(_SMALL, 12, 2, True),
    _Round(_LARGE, 20, 1, True),
    _Round(_LAST, 40, 1, True),
)

_COLOUR_POWER = 4  # the first colours are of where the body covers most
_MODEL_ERROR = 0.005  # of the light: what the model leaves out
_ROBUST = 1.5  # standard deviations from where on errors count singly
_MATTE, _SOFT, _COLOURS, _OUTLINE, _BEND = 0.3, 2.0, 5.0, 2.5, 1.0
"""Weights: the network's matte, what is neither in nor out, changes of colour, of the outline, of the way [1/px^2]."""
_CHOICE = 30.0
"""Constant added to _SOFT where candidates are compared: a soft outline at rest explains a moving image, too, with
fewer changes of colour. As large a value during the descent would suppress the softness that a body with several ways
needs."""
_FAR = 0.03
"""Length of a way, relative to the longer side, at which a pixel may deviate twice as far from the network's matte as
at rest, and at which that matte finally has half the weight."""
_COVERED, _CLEARLY = 0.02, 3.0  # alpha; standard deviations
_STRAYED = 0.01
_INVERSE_NOISE, _TRUST = slice(6, 9), 10  # their places in the kernels' input
_RATES = (0.15, 0.02, 0.3)
"""Adam's, of the outline's logits, the colours' roots and the way [px]."""


@dataclass(frozen=True)
class _Scene:
    """The input at one size: images in linear light, the network's matte, and all of it as one array for kernels."""

    frame: Float[Array, "H W 3"]
    plate: Float[Array, "H W 3"]
    alpha: Float[Array, "H W"]
    told: Float[Array, "H W 11"]

    @staticmethod
    def of(pictures: Sequence[Array], area: int) -> "_Scene":
        """Build from frame and plate (H, W, 3), alpha and doubt (H, W), no larger than they are."""
        height, width = pictures[0].shape[:2]
        scale = min(1.0, float(np.sqrt(area / (height * width))))
        size = max(8, round(width * scale)), max(8, round(height * scale))
        frame, plate, alpha, doubt = (_resized(one, size) for one in pictures)
        noise = quiet_noise(linear_to_srgb(frame), linear_to_srgb(plate)) + _MODEL_ERROR * (frame + 0.05)
        trust = _MATTE / np.exp(np.clip(doubt, -6, 1))
        told = np.dstack([frame, plate, 1 / noise, alpha, trust]).astype(np.float32)
        return _Scene(frame, plate, alpha, told)

    def trusted_less(self, far: Float[Array, "H W"]) -> "_Scene":
        """Reduce the weight of the network's matte with the distance: it is wrong mostly in smears.

        It stays where the image differs from the plate beside the person, too, since shadows would be explained as a
        body.
        """
        told = self.told.copy()
        told[..., _TRUST] /= 1 + np.exp(-self._strayed() / _STRAYED) * (far / _FAR) ** 2
        return replace(self, told=told)

    def _strayed(self) -> float:
        """Return the share of uncovered pixels that differ clearly from the plate."""
        apart = np.linalg.norm((self.frame - self.plate) * self.told[..., _INVERSE_NOISE], axis=-1)
        beside = cv2.dilate((self.alpha > _COVERED).astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
        return float((apart[beside] > _CLEARLY).mean()) if beside.any() else 1.0


@dataclass(frozen=True)
class _Layer:
    """A candidate: an outline's logits, the square roots of its colours, its way and the grid added to it [px]."""

    logits: Float[Array, "H W"]
    roots: Float[Array, "H W 3"]
    way: Float[Array, "H W 2"]
    bend: Float[Array, "2 h w"]

    @staticmethod
    def moved(scene: _Scene, colours: Float[Array, "H W 3"], way: Float[Array, "2"]) -> "_Layer":
        """Return the network's matte, sharpened the more the longer the way, with the colours that follow from it."""
        logits = (4 + 0.8 * np.linalg.norm(way)) * (scene.alpha - 0.5)
        ways = np.broadcast_to(way.astype(np.float32), (*logits.shape, 2)).copy()
        return _Layer(
            logits.astype(np.float32), np.sqrt(np.maximum(colours, 0)), ways, np.zeros((2, *_cells(scene)), np.float32)
        )

    def at(self, scene: _Scene) -> "_Layer":
        """Resize to a scene's size."""
        size, cells = scene.alpha.shape[::-1], _cells(scene)[::-1]
        scale = np.array(size, np.float32) / self.logits.shape[::-1]
        bend = np.stack([_resized(one, cells) * by for one, by in zip(self.bend, scale, strict=True)])
        return _Layer(_resized(self.logits, size), _resized(self.roots, size), _resized(self.way, size) * scale, bend)


def _resized(picture: Array, size: tuple[int, int]) -> Array:
    """Resize to (width, height), float32."""
    how = cv2.INTER_AREA if picture.shape[1] > size[0] else cv2.INTER_LINEAR
    return cv2.resize(picture.astype(np.float32), size, interpolation=how)


def _cells(scene: _Scene) -> tuple[int, int]:
    height, width = scene.alpha.shape
    return max(2, height // _CELL_PX), max(2, width // _CELL_PX)


def explained_matte(
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    alpha: Float[Array, "H W"],
    doubt: Float[Array, "H W"],
) -> Float[Array, "H W"]:
    """Return the matte of the moving layer that explains the frame best, starting from a network's.

    Many straight ways are tried at a small size; the best are refined, may bend, and are enlarged. Finer details than
    the last size stay the network's. No pixel deviates more from its matte than its expected error, or than some times
    that where the way is long. It takes about a second and is deterministic.

    Args:
        frame_linear: in [0, 1]; the plate already has the frame's exposure.
        plate_linear: in [0, 1]; the plate already has the frame's exposure.
        alpha: a network's matte.
        doubt: the logarithm of its expected error.
    """
    given = frame_linear, plate_linear, alpha, doubt
    scene, area = _Scene.of(given, _SMALL), _SMALL
    colours = unmixed_colours(scene.frame, scene.plate, scene.alpha, _COLOUR_POWER)
    layers = [_Layer.moved(scene, colours, way) for way in _straight_ways(max(scene.alpha.shape))]
    answers: list[_Answer] = []
    for step in _ROUNDS:
        if step.area != area:
            scene, area = _Scene.of(given, step.area), step.area
            layers = [layer.at(scene) for layer in layers]
        if step is _ROUNDS[-1]:  # one is left: nothing is compared any more
            scene = scene.trusted_less(_far(answers[0].way, scene.alpha.shape[::-1]))
        followed = run_tasks(partial(_follow, layers, scene, step), len(layers), torch.get_num_threads())
        answers = sorted(followed, key=lambda answer: answer.oddness)
        layers = [answer.layer for answer in answers[: step.kept]]
    found = answers[0]
    size = alpha.shape[::-1]
    change = _resized(found.alpha - scene.alpha, size)
    # The layer explains every change by the body, also a standing person's shadow: the network is better there. A layer
    # that moves far and is still sharp needs no support.
    most = np.exp(doubt) * (1 + _far(found.way, size) / _FAR)
    return np.clip(alpha + np.clip(change, -most, most), 0, 1)


def _far(way: Float[Array, "h w 2"], size: tuple[int, int]) -> Float[Array, "H W"]:
    """Return the length of a way in shares of the image's longer side, at (width, height)."""
    return _resized(np.linalg.norm(way, axis=-1) / max(way.shape[:2]), size)


def _straight_ways(longer_px: int) -> list[Float[Array, "2"]]:
    """Return ways to all sides, and none."""
    angles = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    ways = longer_px * np.array(_LENGTHS)[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
    return [*ways.reshape(-1, 2), np.zeros(2)]


class _Answer(NamedTuple):
    """A candidate's loss, in which softness counts more; its matte and its way [px]."""

    oddness: float
    alpha: Float[Array, "H W"]
    way: Float[Array, "H W 2"]
    layer: _Layer


def _follow(tries: Sequence[_Layer], scene: _Scene, step: _Round, number: int) -> _Answer:
    """Run Adam on one of the tries, in place."""
    layer = tries[number]
    size, cells = layer.logits.shape, layer.bend.shape
    weights = np.array([_ROBUST, _SOFT, _COLOURS, _OUTLINE, _BEND], np.float32)
    rates = np.array([*_RATES[:2], _RATES[2] * step.free], np.float32)
    shapes = (*size, 2), (4, *size, 4), (4, *size), (3, *size, 3), (*size, 2), (3, *cells)
    way, layers, planes, *rest = (np.empty(shape, np.float32) for shape in shapes)
    loss = kernels_layer.descend(
        scene.told,
        weights,
        layer.way,
        rates,
        step.steps,
        layer.logits,
        layer.roots,
        layer.bend,
        way,
        layers,
        planes,
        *rest,
    )
    softness = float((planes[0] * (1 - planes[0])).sum())
    return _Answer(loss + _CHOICE * softness, layers[1, ..., 0], way, layer)
