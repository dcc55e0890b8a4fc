"""Search for the first body of a person who moves by more than their own width during the exposure.

In such a frame no static silhouette covers half of the matte, which is wide, thin and nowhere opaque. A straight path
is searched together with the body: generic poses are smeared along the image's axes until they are as wide as the
matte.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from hfb.body.model import Body
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.matte_search import Moments, Templates, bank_templates, body_from_template, differ
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, matte_level, overlap, refine_all, refine_swept
from hfb.motion.static_pose import FirstBody
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Float, Tensor

_CANVAS_PX = 128
_SCALE_PX = 9.0  # the templates' root mean square radius
_LONGEST = 4.5  # paths, in template spreads: about twice a person's height
_CANDIDATES = 3
_BACK_COST = 0.01
_ROUGH, _FINE = SilhouetteStage(56, 30, 0.05, shape=False), SilhouetteStage(80, 35, 0.02)
_GENTLE = replace(_ROUGH, learning_rate=0.03)
_STAY = Stay(prior=0.004, betas=0.05)


@dataclass(frozen=True)
class SweptBody:
    """A body at mid-exposure, its straight path [m, camera coordinates], the soft IoU of its smear with the matte."""

    first: FirstBody
    travel_m: Float[Tensor, "3"]
    shared: float


@dataclass(frozen=True)
class _Start:
    """A template before the matte: which, how large [px per template px], its path along an axis [template px]."""

    index: int
    scale: float
    path_px: float
    axis: int  # 0 across, 1 down


def search_swept(matte: Float[Array, "H W"], camera: PinholeCamera, body: Body, rasterizer: Rasterizer) -> SweptBody:
    """Return the body whose smear along a line overlaps the matte most. Deterministic; some seconds.

    Args:
        matte: the person's share of each pixel.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
    """
    templates = bank_templates(body)
    x, y, var_x, var_y = _spreads(matte)
    scene = (matte, camera, body, rasterizer)
    level = matte_level(matte, camera, _FINE.size_px)
    starts = _best_starts(matte, (x, y), (var_x, var_y), templates)
    firsts, travels = [], []
    for start in starts:
        first = body_from_template(templates, start.index, 0.0, Moments(x, y, start.scale * _SCALE_PX), camera, body)
        path_m = start.path_px * start.scale * float(first.translation[2]) / camera.fx
        firsts.append(first)
        travels.append(first.translation.new_tensor([path_m, 0, 0] if start.axis == 0 else [0, path_m, 0]))
    firsts, moved = refine_all(firsts, torch.stack(travels), *scene, [_ROUGH], _STAY)
    assert moved is not None
    values = [
        overlap(first, level, body, rasterizer, travel) - _BACK_COST * (1 - float(templates.facing[start.index])) / 2
        for start, first, travel in zip(starts, firsts, moved, strict=True)
    ]
    best = max(range(len(values)), key=values.__getitem__)
    return carried_along(firsts[best], moved[best], *scene, _STAY, (_FINE,))


def carried_along(
    first: FirstBody,
    path_m: Float[Tensor, "3"],
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stay: Stay,
    stages: Sequence[SilhouetteStage] = (_GENTLE, _FINE),
) -> SweptBody:
    """Fit a body that moves along a path to the matte. Of one found at rest the pose is accurate, not the size.

    Args:
        first: the body in the middle of the path.
        path_m: path of the body, from the first to the last instant.
        matte: the person's share of each pixel.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
        stay: weights that hold the result near the start.
        stages: image sizes and iterations, the last with the shape.
    """
    first, travel = refine_swept(first, path_m, matte, camera, body, rasterizer, stages, stay)
    level = matte_level(matte, camera, _FINE.size_px)
    return SweptBody(first, travel, overlap(first, level, body, rasterizer, travel))


def _spreads(matte: Float[Array, "H W"]) -> tuple[float, float, float, float]:
    """Return centre [px] and variances [px^2] across and down."""
    total = max(float(matte.sum(dtype=np.float64)), 1e-9)
    told = []
    for axis in (0, 1):
        weight = matte.sum(axis, dtype=np.float64)
        along = np.arange(len(weight)) + 0.5
        middle = float(weight @ along) / total
        told.append((middle, float(weight @ (along - middle) ** 2) / total))
    (x, var_x), (y, var_y) = told
    return x, y, max(var_x, 1.0), max(var_y, 1.0)


def _best_starts(
    matte: Float[Array, "H W"], centre: tuple[float, float], variances: tuple[float, float], templates: Templates
) -> list[_Start]:
    """Smear every template along each axis to the matte's width and height; return the best that differ."""
    ranked = []
    shrunk, ratio = _reduced(matte, 9 * np.sqrt(max(variances)))
    for index, picture in enumerate(templates.pictures):
        own = _spreads(picture)[2:]
        for axis in (0, 1):
            scale = float(np.sqrt(variances[1 - axis] / own[1 - axis]))
            square = 12 * (variances[axis] / scale**2 - own[axis])
            path = min(float(np.sqrt(max(square, 0.0))), _LONGEST * _SCALE_PX)
            seen = _at_scale(shrunk, (centre[0] * ratio, centre[1] * ratio), scale * ratio)
            smeared = _smeared(picture, path, axis)
            value = float(np.minimum(seen, smeared).sum() / max(np.maximum(seen, smeared).sum(), 1e-6))
            value -= _BACK_COST * (1 - float(templates.facing[index])) / 2
            ranked.append((value, _Start(index, scale, path, axis)))
    ranked.sort(key=lambda one: -one[0])
    chosen: list[_Start] = []
    for _, start in ranked:
        if all(differ(templates.groups[start.index], templates.groups[other.index]) for other in chosen):
            chosen.append(start)
        if len(chosen) == _CANDIDATES:
            break
    return chosen


def _reduced(matte: Float[Array, "H W"], extent_px: float) -> tuple[Float[Array, "h w"], float]:
    """Reduce the matte until its extent is about the canvas; return it and the factor."""
    ratio = min(1.0, 2 * _CANVAS_PX / max(extent_px, 1.0))
    size = (max(1, round(matte.shape[1] * ratio)), max(1, round(matte.shape[0] * ratio)))
    return cv2.resize(np.asarray(matte, np.float32), size, interpolation=cv2.INTER_AREA), ratio


def _at_scale(matte: Float[Array, "h w"], centre: tuple[float, float], scale: float) -> Float[Array, "s s"]:
    """Reduce the matte about its centre so that `scale` of its pixels are one of the canvas."""
    warp = np.array(
        [[scale, 0, centre[0] - 0.5 - scale * _CANVAS_PX / 2], [0, scale, centre[1] - 0.5 - scale * _CANVAS_PX / 2]]
    )
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(matte, warp, (_CANVAS_PX, _CANVAS_PX), flags=how))


def _smeared(picture: Float[Array, "a a"], path_px: float, axis: int) -> Float[Array, "s s"]:
    """Average a template in the middle of the canvas along its path."""
    room = (_CANVAS_PX - len(picture)) // 2
    placed = np.pad(picture, (room, _CANVAS_PX - len(picture) - room)).astype(np.float32)
    length = max(1, round(path_px))
    return np.asarray(cv2.blur(placed, (length, 1) if axis == 0 else (1, length), borderType=cv2.BORDER_CONSTANT))
