"""Render and compare: refine one static body until its silhouette covers the matte.

The matte of a blurred frame is the mean of many silhouettes; a static body cannot equal it, but the one with the
largest overlap is in the middle of the motion. Where a person moves by more than their own width, it covers only the
densest part, and is too far away: there the body is moved along a straight line, and the mean is compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from hfb.body.model import Body
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.torch_adam import Adam
from hfb.matting.matting_protocol import matte_region
from hfb.motion.static_pose import FirstBody
from hfb.objective.matting import matting_loss
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Float, Tensor

_MARGIN = 0.2
_LEAST_DEPTH_M = 0.4
SWEPT_INSTANTS = 5
"""Number of instants of a straight path; over several widths the mean is lumpy, hardly visible in a matte at 64 px."""


@dataclass(frozen=True)
class Level:
    """The matte and its camera at one size."""

    matte: Float[Tensor, "H W"]
    camera: PinholeCamera


@dataclass(frozen=True)
class SilhouetteStage:
    """A stage of the refinement: the longer side [px], iterations, learning rate of the angles [rad].

    With `shape` the betas are refined, too; without them an iteration costs a third.
    """

    size_px: int
    iterations: int
    learning_rate: float
    shape: bool = True


@dataclass(frozen=True)
class Stay:
    """Weights that hold variables at their start, per rad^2 and per relative distance^2, and the priors' weights."""

    pose: float = 0.0
    root: float = 0.0
    place: float = 0.0
    betas: float = 0.02
    prior: float = 0.002


def matte_level(matte: Float[Array, "H W"], camera: PinholeCamera, size_px: int) -> Level:
    """Return the region around the matte at `size_px` on the longer side.

    Args:
        matte: the person's share of each pixel.
        camera: camera of the image.
        size_px: longer side of the result [px].
    """
    top, left, bottom, right = matte_region(matte, margin=_MARGIN)
    cut, inside = matte[top:bottom, left:right], camera.crop(left, top, right - left, bottom - top)
    scale = size_px / max(cut.shape)
    height, width = (max(8, round(side * scale)) for side in cut.shape)
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(np.asarray(cut, np.float32), (width, height), interpolation=interpolation)
    return Level(torch.from_numpy(resized), inside.resize(height, width))


def silhouette(first: FirstBody, camera: PinholeCamera, body: Body, rasterizer: Rasterizer) -> Float[Tensor, "H W"]:
    """Return the body's share of each pixel.

    Args:
        first: a static body.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
    """
    with torch.no_grad():
        posed = body.shape(first.betas).pose(axis_angle_to_matrix(first.pose)[None], first.translation[None])
        return rasterizer.silhouette_mean(posed.vertices, camera, body.mesh)


def overlap(
    first: FirstBody, level: Level, body: Body, rasterizer: Rasterizer, travel_m: Float[Tensor, "3"] | None = None
) -> float:
    """Return the soft IoU of the matte and the body's silhouette.

    Args:
        first: a static body.
        level: the matte at one size.
        body: the body model.
        rasterizer: renders the silhouettes.
        travel_m: path of the body; its mean silhouette from -travel / 2 to +travel / 2 is compared.
    """
    with torch.no_grad():
        posed = body.shape(first.betas).pose(axis_angle_to_matrix(first.pose)[None], first.translation[None])
        shown = posed.vertices if travel_m is None else _carried(posed.vertices[0], travel_m)
        seen = rasterizer.silhouette_mean(shown, level.camera, body.mesh)
    return 1 - float(matting_loss(seen, level.matte))


def refine(
    first: FirstBody,
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stages: Sequence[SilhouetteStage],
    stay: Stay,
) -> FirstBody:
    """Run Adam on pose, translation and betas: 1 - soft IoU (eq. (4), one sub-frame), anatomy, nearness to the start.

    Coarse to fine, because the silhouette's gradient reaches one pixel. Deterministic. Returns the best iterate
    of the last stage, the start included.

    Args:
        first: a static body.
        matte: the person's share of each pixel.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
        stages: image sizes and iterations.
        stay: weights that hold the result near the start.
    """
    return refine_all([first], None, matte, camera, body, rasterizer, stages, stay)[0][0]


def refine_swept(
    first: FirstBody,
    travel_m: Float[Tensor, "3"],
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stages: Sequence[SilhouetteStage],
    stay: Stay,
) -> tuple[FirstBody, Float[Tensor, "3"]]:
    """Apply `refine` with the straight path of the whole body during the exposure: return the middle, and the path.

    Args:
        first: a static body.
        travel_m: the path to start from, from its first to its last instant in camera coordinates.
        matte: the person's share of each pixel.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
        stages: image sizes and iterations.
        stay: weights that hold the result near the start.
    """
    (found,), moved = refine_all([first], travel_m[None], matte, camera, body, rasterizer, stages, stay)
    assert moved is not None
    return found, moved[0]


def refine_all(
    firsts: Sequence[FirstBody],
    travels_m: Float[Tensor, "N 3"] | None,
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stages: Sequence[SilhouetteStage],
    stay: Stay,
) -> tuple[list[FirstBody], Float[Tensor, "N 3"] | None]:
    """Apply `refine` or `refine_swept` to several independent bodies at once.

    Args:
        firsts: bodies to start from.
        travels_m: paths to start from; None for bodies at rest.
        matte: the person's share of each pixel.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
        stages: image sizes and iterations.
        stay: weights that hold the result near the start.

    Raises:
        ValueError: several bodies whose betas differ, or a stage that moves them.
    """
    found = list(firsts)
    if any(stage.shape for stage in stages) and len(found) > 1:
        raise ValueError("several bodies keep their shape: give a stage without it")
    if any(not torch.equal(one.betas, found[0].betas) for one in found):
        raise ValueError("several bodies are refined at once where they have the same betas")
    for stage in stages:
        level = matte_level(matte, camera, stage.size_px)
        found, travels_m = _refine_at(found, travels_m, level, body, rasterizer, stage, stay)
    return found, travels_m


def _carried(vertices: Float[Tensor, "V 3"], travel_m: Float[Tensor, "3"]) -> Float[Tensor, "S V 3"]:
    """Return the posed body at evenly spaced instants of its path."""
    instants = torch.linspace(-0.5, 0.5, SWEPT_INSTANTS, dtype=vertices.dtype)
    return vertices + (instants[:, None] * travel_m.to(vertices))[:, None]


def _refine_at(
    firsts: list[FirstBody],
    travels_m: Float[Tensor, "N 3"] | None,
    level: Level,
    body: Body,
    rasterizer: Rasterizer,
    stage: SilhouetteStage,
    stay: Stay,
) -> tuple[list[FirstBody], Float[Tensor, "N 3"] | None]:
    """Run Adam at one size; it treats each number separately, so bodies in one sum do not influence each other."""
    dtype = body.template.dtype
    prior = AnatomicalPrior()
    start_poses = torch.stack([one.pose for one in firsts]).to(dtype)
    start_places = torch.stack([one.translation for one in firsts]).to(dtype)
    R_start = axis_angle_to_matrix(start_poses[:, 0])
    roots = torch.zeros_like(start_places, requires_grad=True)
    joints = start_poses[:, 1:].clone().requires_grad_()
    betas = firsts[0].betas.to(dtype).clone()
    # Image position and log depth: a step in depth then keeps the body where it is seen.
    start_views = _to_view(start_places, betas, body)
    views = start_views.clone().requires_grad_()
    betas.requires_grad_(stage.shape)
    leaves = [(joints, stage.learning_rate), (roots, stage.learning_rate), (views, 0.4 * stage.learning_rate)]
    travels = None if travels_m is None else travels_m.to(dtype).clone().requires_grad_()
    if travels is not None:
        leaves.append((travels, stage.learning_rate))
    if stage.shape:
        leaves.append((betas, stage.learning_rate))
    optimiser = Adam(leaves, betas=(0.8, 0.95))
    shaped = body.shape(betas)
    best, best_travels, best_values = list(firsts), travels_m, [float("inf")] * len(firsts)
    for iteration in range(stage.iterations + 1):
        places = _from_view(views, betas, body)
        turns = (axis_angle_to_matrix(roots) @ R_start)[:, None]
        if stage.shape:
            shaped = body.shape(betas)
        vertices = shaped.pose(torch.cat([turns, axis_angle_to_matrix(joints)], 1), places).vertices
        seen = [
            rasterizer.silhouette_mean(
                one[None] if travels is None else _carried(one, travels[number]), level.camera, body.mesh
            )
            for number, one in enumerate(vertices)
        ]
        losses = (
            torch.stack([matting_loss(one, level.matte) for one in seen])
            + stay.prior * prior(joints)
            + stay.pose * ((joints - start_poses[:, 1:]) ** 2).sum((1, 2))
            + stay.root * (roots * roots).sum(1)
            + stay.place * ((views - start_views) ** 2).sum(1)
            + stay.betas * (betas * betas).sum()
        )
        values = losses.tolist()
        better = [number for number, value in enumerate(values) if value < best_values[number]]
        if better:
            poses = torch.cat([matrix_to_axis_angle(turns), joints], 1).detach().clone()
            shape, stands = betas.detach().clone(), places.detach().clone()
            for number in better:
                best[number] = replace(best[number], pose=poses[number], translation=stands[number], betas=shape)
                best_values[number] = values[number]
            if travels is not None and best_travels is not None:
                best_travels = best_travels.to(dtype).clone()
                best_travels[better] = travels.detach()[better]
        if iteration < stage.iterations:
            losses.sum().backward()
            optimiser.step()
    return best, best_travels


def _to_view(translations: Float[Tensor, "N 3"], betas: Float[Tensor, "K"], body: Body) -> Float[Tensor, "N 3"]:
    """Return (x / z, y / z, log z) of the pelvis."""
    pelvis = body.joint_template[0] + body.joint_shape_directions[0] @ betas + translations
    depth = pelvis[:, 2].clamp_min(_LEAST_DEPTH_M)
    return torch.stack([pelvis[:, 0] / depth, pelvis[:, 1] / depth, depth.log()], 1)


def _from_view(views: Float[Tensor, "N 3"], betas: Float[Tensor, "K"], body: Body) -> Float[Tensor, "N 3"]:
    """Invert `_to_view`: return the translations."""
    depth = views[:, 2].exp()
    pelvis = torch.stack([views[:, 0] * depth, views[:, 1] * depth, depth], 1)
    return pelvis - body.joint_template[0] - body.joint_shape_directions[0] @ betas
