"""The first body from the matte alone: generic poses from all sides, the best few refined by render and compare.

It needs no network and no colour. A silhouette does not determine front and back (the front is preferred a little), nor
which leg is which.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import pi, radians

import cv2
import numpy as np
import torch

from hfb.body.model import Body
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.pose_bank import bank_rotations
from hfb.initialization.silhouette_fit import Level, SilhouetteStage, Stay, matte_level, overlap, refine, refine_all
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Float, Tensor

_YAWS = 12
_ROLLS_DEG = (0.0, 20.0, -20.0, 40.0, -40.0)
_SIDE_PX = 48
_SPREAD_PX = 9.0  # root mean square distance from the centre, in the normalised image
_TEMPLATE_DEPTH_M = 3.5
_TEMPLATE_PX = 72
_ROLL_COST = 0.04  # per 40 degrees
_BACK_COST = 0.01
_CANDIDATES, _SURVIVORS = 16, 6
_ROUGH, _MIDDLE, _FINE = (
    SilhouetteStage(40, 30, 0.05, shape=False),
    SilhouetteStage(64, 40, 0.03, shape=False),
    SilhouetteStage(128, 40, 0.02),
)
_STAY = Stay(prior=0.002, betas=0.03)


@dataclass(frozen=True)
class Templates:
    """Silhouettes of the bank's poses from all sides, normalised in position and size."""

    pictures: Float[Array, "N s s"]
    poses: Float[Tensor, "N 24 3"]  # with the root's yaw
    spreads: Float[Array, "N"]  # root mean square radius [rad as seen from the template's distance]
    pelvis: Float[Array, "N 2"]  # from the silhouette's centre, in units of the spread
    facing: Float[Array, "N"]  # 1 faces the camera, -1 away
    groups: Float[Array, "N 2"]  # pose index, yaw [rad]: to keep candidates apart


@dataclass(frozen=True)
class Moments:
    """Centre [px] and root mean square radius [px] of an image's weight."""

    x: float
    y: float
    spread: float


def search_by_matte(
    matte: Float[Array, "H W"], camera: PinholeCamera, body: Body, rasterizer: Rasterizer
) -> tuple[FirstBody, float]:
    """Return the body whose silhouette overlaps the matte most, and its soft IoU. Deterministic; some two seconds.

    Args:
        matte: the person's share of each pixel.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the silhouettes.
    """
    templates = bank_templates(body)
    starts = _best_starts(matte, camera, body, templates)
    scene = (matte, camera, body, rasterizer)
    rough, _ = refine_all(starts, None, *scene, [_ROUGH], _STAY)
    level = matte_level(matte, camera, _MIDDLE.size_px)
    rough.sort(key=lambda first: -_value(first, level, body, rasterizer))
    middle, _ = refine_all(rough[:_SURVIVORS], None, *scene, [_MIDDLE], _STAY)
    middle.sort(key=lambda first: -_value(first, level, body, rasterizer))
    best = refine(middle[0], *scene, [_FINE], _STAY)
    return best, overlap(best, matte_level(matte, camera, _FINE.size_px), body, rasterizer)


def _value(first: FirstBody, level: Level, body: Body, rasterizer: Rasterizer) -> float:
    """Return soft IoU, minus a little for showing the back."""
    facing = -float(axis_angle_to_matrix(first.pose[0])[2, 2])
    return overlap(first, level, body, rasterizer) - _BACK_COST * (1 - facing) / 2


def _best_starts(
    matte: Float[Array, "H W"], camera: PinholeCamera, body: Body, templates: Templates
) -> list[FirstBody]:
    """Compare the matte, turned by each roll, with every template; the best ones that differ from each other."""
    moments = matte_moments(matte)
    scores = np.stack(
        [
            _soft_ious(_normalised(matte, moments, -radians(roll)), templates.pictures) - _ROLL_COST * abs(roll) / 40
            for roll in _ROLLS_DEG
        ]
    )
    scores -= _BACK_COST * (1 - templates.facing) / 2
    chosen: list[tuple[int, int]] = []
    for flat in np.argsort(-scores, axis=None, kind="stable"):
        roll, index = np.unravel_index(int(flat), scores.shape)
        if all(differ(templates.groups[index], templates.groups[other]) for _, other in chosen):
            chosen.append((int(roll), int(index)))
        if len(chosen) == _CANDIDATES:
            break
    return [
        body_from_template(templates, index, radians(_ROLLS_DEG[roll]), moments, camera, body) for roll, index in chosen
    ]


def differ(one: Float[Array, "2"], other: Float[Array, "2"]) -> bool:
    """Return whether two poses differ, or are the same from a clearly different side.

    Args:
        one: number of the pose, and its turn about the vertical [rad].
        other: as `one`.
    """
    turn = abs((one[1] - other[1] + pi) % (2 * pi) - pi)
    return bool(one[0] != other[0] or turn > radians(75))


def _soft_ious(picture: Float[Array, "s s"], pictures: Float[Array, "N s s"]) -> Float[Array, "N"]:
    """Return sum min / sum max against each image, through |a - b| = max - min."""
    difference = np.abs(pictures - picture).sum((1, 2), dtype=np.float64)
    total = pictures.sum((1, 2), dtype=np.float64) + picture.sum(dtype=np.float64)
    return (total - difference) / np.maximum(total + difference, 1e-9)


def matte_moments(picture: Float[Array, "H W"]) -> Moments:
    """Return the moments of a silhouette or a matte.

    Args:
        picture: a silhouette or a matte.
    """
    columns, rows = picture.sum(0, dtype=np.float64), picture.sum(1, dtype=np.float64)
    total = max(float(columns.sum()), 1e-9)
    along_x, along_y = np.arange(len(columns)) + 0.5, np.arange(len(rows)) + 0.5
    x, y = float(columns @ along_x) / total, float(rows @ along_y) / total
    square = float(columns @ (along_x - x) ** 2 + rows @ (along_y - y) ** 2) / total
    return Moments(x, y, max(float(np.sqrt(square)), 1e-3))


def _normalised(picture: Float[Array, "H W"], moments: Moments, turn: float = 0.0) -> Float[Array, "s s"]:
    """Return the silhouette centred, scaled to the common spread, turned clockwise by `turn` [rad]."""
    scale = _SPREAD_PX / moments.spread
    shrink = max(1, int(1 / (2 * scale)))
    reduced: np.ndarray = np.asarray(picture, np.float32)
    if shrink > 1:  # area average first: the interpolation below looks at four pixels only
        size = (max(1, picture.shape[1] // shrink), max(1, picture.shape[0] // shrink))
        reduced = cv2.resize(reduced, size, interpolation=cv2.INTER_AREA)
    ratio = np.array([reduced.shape[1] / picture.shape[1], reduced.shape[0] / picture.shape[0]])
    cosine, sine = np.cos(turn), np.sin(turn)
    back = np.array([[cosine, sine], [-sine, cosine]]) / scale
    offset = back @ np.full(2, 0.5 - _SIDE_PX / 2) + (moments.x, moments.y)
    warp = np.hstack([back * ratio[:, None], (offset * ratio - 0.5)[:, None]])
    return cv2.warpAffine(reduced, warp, (_SIDE_PX, _SIDE_PX), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


@lru_cache(maxsize=2)
def bank_templates(body: Body) -> Templates:
    """Draw the bank once per body and process; what is a mirror image of something drawn is flipped instead.

    Args:
        body: the body model.
    """
    dtype = body.template.dtype
    names, bank = bank_rotations(dtype)
    upright = axis_angle_to_matrix(torch.tensor([pi, 0.0, 0.0], dtype=dtype))
    yaws = torch.arange(_YAWS, dtype=dtype) * (2 * pi / _YAWS)
    roots = upright @ axis_angle_to_matrix(torch.stack([torch.zeros_like(yaws), yaws, torch.zeros_like(yaws)], -1))
    drawn: dict[tuple[int, int], tuple[Float[Array, "s s"], float, tuple[float, float]]] = {}
    for k, name in enumerate(names):
        mirrored = name.endswith(", mirrored")
        has_mirror = k + 1 < len(names) and names[k + 1] == name + ", mirrored"
        chosen = [] if mirrored else list(range(_YAWS if has_mirror else _YAWS // 2 + 1))
        for yaw, one in zip(chosen, _draw(bank[k], roots[chosen], body), strict=True):
            drawn[k, yaw] = one
        for yaw in set(range(_YAWS)) - set(chosen):
            picture, spread, pelvis = drawn[k - 1 if mirrored else k, -yaw % _YAWS]
            drawn[k, yaw] = (picture[:, ::-1], spread, (-pelvis[0], pelvis[1]))
    keys = [(k, yaw) for k in range(len(names)) for yaw in range(_YAWS)]
    angles = np.array([yaw * 2 * pi / _YAWS for _, yaw in keys])
    root_vectors = matrix_to_axis_angle(roots)
    return Templates(
        pictures=np.stack([drawn[key][0] for key in keys]),
        poses=torch.stack([torch.cat([root_vectors[yaw][None], bank[k]]) for k, yaw in keys]),
        spreads=np.array([drawn[key][1] for key in keys]),
        pelvis=np.array([drawn[key][2] for key in keys]),
        facing=np.cos(angles),
        groups=np.stack([np.array([float(k) for k, _ in keys]), angles], 1),
    )


def _draw(
    pose: Float[Tensor, "23 3"], roots: Float[Tensor, "Y 3 3"], body: Body
) -> list[tuple[Float[Array, "s s"], float, tuple[float, float]]]:
    """Draw one pose from several sides: normalised silhouette, spread [rad], the pelvis from its centre in spreads."""
    rasterizer = make_rasterizer("coverage")
    camera = PinholeCamera.from_focal(_TEMPLATE_PX * _TEMPLATE_DEPTH_M / 2.6, _TEMPLATE_PX, _TEMPLATE_PX)
    shaped = body.shape(torch.zeros(body.shape_count, dtype=body.template.dtype))
    ahead = torch.tensor([0.0, 0.0, _TEMPLATE_DEPTH_M], dtype=body.template.dtype)
    results = []
    with torch.no_grad():
        rotations = axis_angle_to_matrix(torch.cat([torch.zeros_like(pose[:1]), pose]))
        vertices = shaped.pose(rotations[None], -shaped.joints[:1]).vertices[0]  # the pelvis at the origin
        for R_root in roots:
            seen = rasterizer.silhouette_mean((vertices @ R_root.T + ahead)[None], camera, body.mesh).numpy()
            moments = matte_moments(seen)
            pelvis = ((camera.cx - moments.x) / moments.spread, (camera.cy - moments.y) / moments.spread)
            results.append((_normalised(seen, moments), moments.spread / camera.fx, pelvis))
    return results


def body_from_template(
    templates: Templates, index: int, roll: float, moments: Moments, camera: PinholeCamera, body: Body
) -> FirstBody:
    """Place the template's body at the matte: distance by size, turned towards its view ray.

    Args:
        templates: silhouettes of the bank.
        index: number of the template.
        roll: angle about the optical axis [rad].
        moments: moments of the matte.
        camera: camera of the image.
        body: the body model.
    """
    dtype = body.template.dtype
    depth = _TEMPLATE_DEPTH_M * float(templates.spreads[index]) * camera.fx / moments.spread
    cosine, sine = np.cos(roll), np.sin(roll)
    offset = np.array([[cosine, -sine], [sine, cosine]]) @ templates.pelvis[index] * moments.spread
    pixel = torch.tensor([moments.x + offset[0], moments.y + offset[1]], dtype=dtype)
    pelvis = camera.unproject(pixel[None], torch.tensor([depth], dtype=dtype))[0]
    in_plane = axis_angle_to_matrix(torch.tensor([0.0, 0.0, roll], dtype=dtype))
    pose = templates.poses[index].clone()
    pose[0] = matrix_to_axis_angle(_towards(pelvis) @ in_plane @ axis_angle_to_matrix(pose[0]))
    betas = torch.zeros(body.shape_count, dtype=dtype)
    return FirstBody(pose, pelvis - body.joint_template[0], betas, "matte")


def _towards(point: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Return the smallest rotation from the optical axis to the ray through a point, which keeps the view frontal."""
    ray = point / point.norm()
    axis = torch.stack([-ray[1], ray[0], torch.zeros_like(ray[0])])
    sine = axis.norm().clamp_min(1e-9)
    return axis_angle_to_matrix(axis / sine * torch.atan2(sine, ray[2]))
