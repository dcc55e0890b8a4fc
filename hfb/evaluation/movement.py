"""Errors of position in the image, of depth, of facing direction and of motion.

MPJPE hardly depends on the motion: a still body has a low error. These errors separate what an image shows (pixels),
what it shows poorly (depth, lean, front) and the motion. They use the joints that both sides know. R counts instants,
frame after frame. Joints are in camera coordinates [m]. The camera is assumed level: its y axis is the vertical.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.skeleton import JOINT_NAMES
from hfb.geometry.camera import PinholeCamera
from hfb.typing import Array, Bool, Float, Int

_HIPS = (JOINT_NAMES.index("left_hip"), JOINT_NAMES.index("right_hip"))
_SHOULDERS = (JOINT_NAMES.index("left_shoulder"), JOINT_NAMES.index("right_shoulder"))
_PELVIS = 0
_LEAST_LEAN = 0.3
"""Smallest share of the trunk's length in the vertical-depth plane; below it the lean is undefined."""


@dataclass(frozen=True)
class MovementErrors:
    """Errors of one case; NaN where the truth knows too few joints or instants.

    Attributes:
        in_plane_px: distance of projected joints, nothing aligned.
        ray_depth_mm: error along the ray through the true joint, with the root of both in one place.
        lean_deg: angle between both trunks (hips to shoulders) in the plane of the vertical and the depth.
        front_wrong: share of frames whose heading differs by more than 90 degrees from the true one.
        spin_deg: largest error of the change of heading between neighbouring frames; NaN of one frame.
        motion_mm: distance of joints after each joint's mean over the exposure is subtracted from both paths.
        better_motion_mm: the same with time reversed in the frames in which that lowers it.
        still_motion_mm: ``motion_mm`` of a still body, which is the amount of true motion.
        path_mm: mean length of the joints' paths about the root during an exposure.
        true_path_mm: the same of the truth.
    """

    in_plane_px: float
    ray_depth_mm: float
    lean_deg: float
    front_wrong: float
    spin_deg: float
    motion_mm: float
    better_motion_mm: float
    still_motion_mm: float
    path_mm: float
    true_path_mm: float


def movement_errors(
    claimed: Float[Array, "R P 3"],
    true: Float[Array, "R P 3"],
    joints: Sequence[int],
    frame_index: Int[Array, "R"],
    camera: PinholeCamera,
) -> MovementErrors:
    """Return the errors of joints given at the same instants as the truth.

    Args:
        claimed: estimated joints, finite.
        true: true joints; NaN where unknown.
        joints: SMPL's number of each joint.
        frame_index: frame of each instant.
        camera: camera of the frames.
    """
    known = np.isfinite(true).all(-1)
    claimed, true = np.where(known[..., None], claimed, np.nan), np.where(known[..., None], true, np.nan)
    place = {joint: index for index, joint in enumerate(joints)}
    frames = [np.flatnonzero(frame_index == frame) for frame in np.unique(frame_index)]
    turns = [[_heading(side[rows], place) for rows in frames] for side in (claimed, true)]
    apart = np.abs(_wrapped(np.array(turns[0]) - np.array(turns[1])))
    spins = np.abs(_wrapped(np.diff(turns[0]) - np.diff(turns[1])))
    forth = [_motion_mm(claimed[rows], true[rows]) for rows in frames]
    back = [_motion_mm(claimed[rows[::-1]], true[rows]) for rows in frames]
    root_claimed, root_true = _root(claimed, place), _root(true, place)
    return MovementErrors(
        in_plane_px=_mean(np.linalg.norm(_pixels(claimed, camera) - _pixels(true, camera), axis=-1)),
        ray_depth_mm=1000 * _mean(np.abs(_along_rays(claimed - root_claimed - (true - root_true), true))),
        lean_deg=_mean(np.abs(_wrapped(_lean(claimed, place) - _lean(true, place)))),
        front_wrong=_mean(np.where(np.isfinite(apart), apart > 90, np.nan)),
        spin_deg=float(np.nanmax(spins)) if np.isfinite(spins).any() else math.nan,
        motion_mm=_mean(np.array(forth)),
        better_motion_mm=_mean(np.fmin(forth, back)),
        still_motion_mm=_mean(np.array([_motion_mm(np.zeros_like(true[rows]), true[rows]) for rows in frames])),
        path_mm=_mean(np.array([_path_mm((claimed - root_claimed)[rows]) for rows in frames])),
        true_path_mm=_mean(np.array([_path_mm((true - root_true)[rows]) for rows in frames])),
    )


def at_instants(
    joints: Float[Array, "S J 3"], times_s: Float[Array, "S"], at_s: Float[Array, "R"]
) -> Float[Array, "R J 3"]:
    """Interpolate the joints of one exposure linearly in time.

    Args:
        joints: at the known instants.
        times_s: the known instants, increasing.
        at_s: the wanted instants.
    """
    flat = joints.reshape(len(joints), -1)
    columns = [np.interp(at_s, times_s, column) for column in flat.T]
    return np.stack(columns, 1).reshape(len(at_s), *joints.shape[1:])


def _root(joints: Float[Array, "R P 3"], place: dict[int, int]) -> Float[Array, "R 1 3"]:
    """Return the pelvis, or the middle of the hips; NaN where neither is known."""
    if _PELVIS in place:
        return joints[:, place[_PELVIS]][:, None]
    return _middle(joints, place, _HIPS)[:, None]


def _middle(joints: Float[Array, "R P 3"], place: dict[int, int], pair: tuple[int, int]) -> Float[Array, "R 3"]:
    return (_joint(joints, place, pair[0]) + _joint(joints, place, pair[1])) / 2


def _joint(joints: Float[Array, "R P 3"], place: dict[int, int], joint: int) -> Float[Array, "R 3"]:
    return joints[:, place[joint]] if joint in place else np.full((len(joints), 3), np.nan)


def _pixels(joints: Float[Array, "R P 3"], camera: PinholeCamera) -> Float[Array, "R P 2"]:
    """Project joints; NaN where unknown or not in front of the lens."""
    ahead = np.where(joints[..., 2:] > 0.05, joints, np.nan)
    return camera.project(torch.from_numpy(ahead)).numpy()


def _along_rays(vectors: Float[Array, "R P 3"], points: Float[Array, "R P 3"]) -> Float[Array, "R P"]:
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return np.asarray((vectors * rays).sum(-1))


def _lean(joints: Float[Array, "R P 3"], place: dict[int, int]) -> Float[Array, "R"]:
    """Return the angle between trunk and vertical, positive towards the camera [deg]."""
    trunk = _middle(joints, place, _SHOULDERS) - _middle(joints, place, _HIPS)
    within = np.hypot(trunk[:, 1], trunk[:, 2]) >= _LEAST_LEAN * np.linalg.norm(trunk, axis=1)
    return np.where(within, np.degrees(np.arctan2(-trunk[:, 2], -trunk[:, 1])), np.nan)


def _heading(joints: Float[Array, "S P 3"], place: dict[int, int]) -> float:
    """Return the mean heading about the vertical [deg], 0 towards the camera.

    The left-right axis of hips and shoulders gives it, which does not depend on how far the person bends forward.
    """
    axes = [_joint(joints, place, left) - _joint(joints, place, right) for left, right in (_HIPS, _SHOULDERS)]
    rows = np.concatenate(axes)
    rows = rows[np.isfinite(rows).all(1)]
    if not len(rows):
        return math.nan
    x, _, z = rows.mean(0)
    return math.degrees(math.atan2(z, x))


def _wrapped(degrees: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return np.asarray((degrees + 180) % 360 - 180)


def _motion_mm(claimed: Float[Array, "S P 3"], true: Float[Array, "S P 3"]) -> float:
    """Return the mean distance of two motions about their means; NaN where no joint is known at two instants."""
    known: Bool[Array, "S P"] = np.isfinite(claimed).all(-1) & np.isfinite(true).all(-1)
    counted = known & (known.sum(0) >= 2)
    if not counted.any():
        return math.nan
    apart = np.where(counted[..., None], claimed - true, 0)
    apart = apart - apart.sum(0) / np.maximum(counted.sum(0), 1)[:, None]
    return 1000 * float(np.linalg.norm(apart, axis=-1)[counted].mean())


def _path_mm(joints: Float[Array, "S P 3"]) -> float:
    steps = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    return 1000 * _mean(np.nansum(steps, 0)[np.isfinite(steps).any(0)])


def _mean(values: Float[Array, "*n"]) -> float:
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    return float(known.mean()) if known.size else math.nan
