"""Render and compare: move one static body until its silhouette covers the matte.

The matte of a blurred frame is the mean of many silhouettes; a static body can't equal it, but the one that
shares most with it lies in the middle of the motion. Where a person crosses more than their own width, it covers the
densest part instead, and is too far away: there the body is carried along a straight line, and the mean compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from hfb.body.model import Body
from hfb.initialize.first_body import FirstBody
from hfb.losses.matting import matting_loss
from hfb.matting.matting import matte_region
from hfb.priors.anatomy import AnatomicalPrior
from hfb.render.camera import PinholeCamera
from hfb.render.rasterizer import Rasterizer
from hfb.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.shapes import Array, Float, Tensor

_MARGIN = 0.2
_LEAST_DEPTH_M = 0.4
SWEPT_INSTANTS = 5
"""Of a straight path; where a person crosses several widths, the mean is lumpy, which a matte at 64 px hardly shows."""


@dataclass(frozen=True)
class Level:
    """The matte and its camera at one size."""

    matte: Float[Tensor, "H W"]
    camera: PinholeCamera


@dataclass(frozen=True)
class Stage:
    """A stretch of the refinement: the longer side [px], iterations, learning rate of the angles [rad].

    shape: whether the betas move too; without them an iteration costs a third.
    """

    size_px: int
    iterations: int
    learning_rate: float
    shape: bool = True


@dataclass(frozen=True)
class Stay:
    """How strongly variables are held at their start: per rad^2, per relative distance^2; and the priors' weights."""

    pose: float = 0.0
    root: float = 0.0
    place: float = 0.0
    betas: float = 0.02
    prior: float = 0.002


def matte_level(matte: Float[Array, "H W"], camera: PinholeCamera, size_px: int) -> Level:
    """The region around the matte at `size_px` on the longer side."""
    top, left, bottom, right = matte_region(matte, margin=_MARGIN)
    cut, inside = matte[top:bottom, left:right], camera.crop(left, top, right - left, bottom - top)
    scale = size_px / max(cut.shape)
    height, width = (max(8, round(side * scale)) for side in cut.shape)
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(np.asarray(cut, np.float32), (width, height), interpolation=interpolation)
    return Level(torch.from_numpy(resized), inside.resize(height, width))


def silhouette(first: FirstBody, camera: PinholeCamera, body: Body, rasterizer: Rasterizer) -> Float[Tensor, "H W"]:
    """The body's share of each pixel."""
    with torch.no_grad():
        posed = body.shape(first.betas).pose(axis_angle_to_matrix(first.pose)[None], first.translation[None])
        return rasterizer.silhouette_mean(posed.vertices, camera, body.mesh)


def overlap(
    first: FirstBody, level: Level, body: Body, rasterizer: Rasterizer, travel_m: Float[Tensor, "3"] | None = None
) -> float:
    """Soft IoU of the matte and the body's silhouette.

    Args:
        travel_m: the mean silhouette of the body carried from -travel / 2 to +travel / 2 is meant.
    """
    with torch.no_grad():
        posed = body.shape(first.betas).pose(axis_angle_to_matrix(first.pose)[None], first.translation[None])
        shown = posed.vertices if travel_m is None else _carried(posed.vertices, travel_m)
        seen = rasterizer.silhouette_mean(shown, level.camera, body.mesh)
    return 1 - float(matting_loss(seen, level.matte))


def refine(
    first: FirstBody,
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stages: Sequence[Stage],
    stay: Stay,
) -> FirstBody:
    """Adam on pose, translation and betas: 1 - soft IoU (eq. (4) with one sub-frame), anatomy, nearness to the start.

    Coarse to fine, because the silhouette's gradient reaches one pixel. Deterministic. Returns the best iterate
    of the last stage, the start included.
    """
    return _refined(first, None, matte, camera, body, rasterizer, stages, stay)[0]


def refine_swept(
    first: FirstBody,
    travel_m: Float[Tensor, "3"],
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stages: Sequence[Stage],
    stay: Stay,
) -> tuple[FirstBody, Float[Tensor, "3"]]:
    """As `refine`, with the straight path of the whole body during the exposure besides: the middle, and the path.

    Args:
        travel_m: the path to start from, from its first to its last instant in camera coordinates.
    """
    first, moved = _refined(first, travel_m, matte, camera, body, rasterizer, stages, stay)
    assert moved is not None
    return first, moved


def _refined(
    first: FirstBody,
    travel_m: Float[Tensor, "3"] | None,
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
    stages: Sequence[Stage],
    stay: Stay,
) -> tuple[FirstBody, Float[Tensor, "3"] | None]:
    for stage in stages:
        level = matte_level(matte, camera, stage.size_px)
        first, travel_m = _refine_at(first, travel_m, level, body, rasterizer, stage, stay)
    return first, travel_m


def _carried(vertices: Float[Tensor, "1 V 3"], travel_m: Float[Tensor, "3"]) -> Float[Tensor, "S V 3"]:
    """The posed body at evenly spaced instants of its path."""
    instants = torch.linspace(-0.5, 0.5, SWEPT_INSTANTS, dtype=vertices.dtype)
    return vertices + (instants[:, None] * travel_m.to(vertices))[:, None]


def _refine_at(
    first: FirstBody,
    travel_m: Float[Tensor, "3"] | None,
    level: Level,
    body: Body,
    rasterizer: Rasterizer,
    stage: Stage,
    stay: Stay,
) -> tuple[FirstBody, Float[Tensor, "3"] | None]:
    dtype = body.template.dtype
    prior = AnatomicalPrior()
    start_pose, start_place = first.pose.to(dtype), first.translation.to(dtype)
    R_start = axis_angle_to_matrix(start_pose[0])
    root = torch.zeros(3, dtype=dtype, requires_grad=True)
    joints = start_pose[1:].clone().requires_grad_()
    # Image position and log depth: a step in depth then keeps the body where it is seen.
    start_view = _to_view(start_place, first, body)
    view = start_view.clone().requires_grad_()
    betas = first.betas.to(dtype).clone().requires_grad_(stage.shape)
    groups = [([joints, root], stage.learning_rate), ([view], 0.4 * stage.learning_rate)]
    travel = None if travel_m is None else travel_m.to(dtype).clone().requires_grad_()
    if travel is not None:
        groups.append(([travel], stage.learning_rate))
    if stage.shape:
        groups.append(([betas], stage.learning_rate))
    optimiser = torch.optim.Adam([{"params": free, "lr": rate} for free, rate in groups], betas=(0.8, 0.95))
    shaped = body.shape(betas)
    best, best_travel, best_value = first, travel_m, float("inf")
    for iteration in range(stage.iterations + 1):
        optimiser.zero_grad()
        place = _from_view(view, betas, body)
        rotations = torch.cat([(axis_angle_to_matrix(root) @ R_start)[None], axis_angle_to_matrix(joints)])
        if stage.shape:
            shaped = body.shape(betas)
        vertices = shaped.pose(rotations[None], place[None]).vertices
        shown = vertices if travel is None else _carried(vertices, travel)
        seen = rasterizer.silhouette_mean(shown, level.camera, body.mesh)
        loss = (
            matting_loss(seen, level.matte)
            + stay.prior * prior(joints[None])[0]
            + stay.pose * ((joints - start_pose[1:]) ** 2).sum()
            + stay.root * (root * root).sum()
            + stay.place * ((view - start_view) ** 2).sum()
            + stay.betas * (betas * betas).sum()
        )
        if float(loss.detach()) < best_value:
            best_value = float(loss.detach())
            pose = torch.cat([matrix_to_axis_angle(rotations[:1]), joints]).detach().clone()
            best = replace(first, pose=pose, translation=place.detach().clone(), betas=betas.detach().clone())
            best_travel = None if travel is None else travel.detach().clone()
        if iteration < stage.iterations:
            loss.backward()
            optimiser.step()
    return best, best_travel


def _to_view(translation: Float[Tensor, "3"], first: FirstBody, body: Body) -> Float[Tensor, "3"]:
    """(x / z, y / z, log z) of the pelvis."""
    pelvis = body.joint_template[0] + body.joint_shape_directions[0] @ first.betas.to(translation.dtype) + translation
    depth = pelvis[2].clamp_min(_LEAST_DEPTH_M)
    return torch.stack([pelvis[0] / depth, pelvis[1] / depth, depth.log()])


def _from_view(view: Float[Tensor, "3"], betas: Float[Tensor, "K"], body: Body) -> Float[Tensor, "3"]:
    """The translation that puts the pelvis there."""
    depth = view[2].exp()
    pelvis = torch.stack([view[0] * depth, view[1] * depth, depth])
    return pelvis - body.joint_template[0] - body.joint_shape_directions[0] @ betas
