"""Interpolation of single estimates to the rows of a prediction."""

import numpy as np
import torch

from hfb.body.model import Body
from hfb.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    in_hemisphere_of,
    normalize_quaternion,
    quaternion_to_axis_angle,
)
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float, Int, Tensor


def row_times_s(observation: Observation, subframes: int) -> tuple[Float[Array, "R"], Int[Array, "R"]]:
    """Return times [s] and frame numbers of a prediction's rows.

    Args:
        observation: the blurred frames with their clock.
        subframes: rows per frame.
    """
    return subframe_times_s(len(observation.mattes), subframes, observation.exposure_s, observation.interval_s)


def middle_times_s(observation: Observation) -> Float[Array, "T"]:
    """Return the middle of every exposure [s], the time of a static estimate.

    Args:
        observation: the blurred frames with their clock.
    """
    return np.arange(len(observation.mattes)) * observation.interval_s + observation.exposure_s / 2


def motion_of_rows(
    poses: Float[Tensor, "R 24 3"],
    translations: Float[Tensor, "R 3"],
    betas: Float[Tensor, "10"],
    observation: Observation,
    body: Body,
) -> SampledMotion:
    """Return a prediction's motion from one pose [rad] and translation [m] per row, R being frames x sub-frames.

    Args:
        poses: axis-angle [rad], camera coordinates.
        translations: SMPL's [m], camera coordinates.
        betas: shape coefficients.
        observation: the blurred frames with their clock.
        body: model of the poses.
    """
    times_s, frame_index = row_times_s(observation, len(poses) // len(observation.mattes))
    exact = body.template.dtype
    with torch.no_grad():
        shaped = body.shape(betas.to(exact))
        joints = shaped.joints_of(axis_angle_to_matrix(poses.to(exact)), translations.to(exact))
    return SampledMotion(
        poses=poses.flatten(1).double().numpy(),
        trans=translations.double().numpy(),
        betas=betas.double().numpy(),
        joints=joints.double().numpy(),
        times_s=times_s,
        frame_index=frame_index,
        K=observation.camera.matrix().double().numpy(),
    )


def poses_at(
    times_s: Float[Array, "R"], known_s: Float[Array, "M"], poses: Float[Tensor, "M 24 3"]
) -> Float[Tensor, "R 24 3"]:
    """Interpolate every joint's rotation (axis-angle) between neighbouring estimates by slerp; held beyond the ends.

    Args:
        times_s: times of the rows.
        known_s: times of the estimates, increasing.
        poses: axis-angle of the estimates [rad].
    """
    before, after, share = _between(times_s, known_s)
    known = axis_angle_to_quaternion(poses.double())
    start = known[before]
    end = in_hemisphere_of(known[after], start)
    cosine = (start * end).sum(-1, keepdim=True).clamp(-1, 1)
    angle, weight = torch.arccos(cosine), share[:, None, None]
    sine = torch.sin(angle)
    near = sine < 1e-6  # there slerp is the straight line, and its own formula 0 / 0
    safe = torch.where(near, torch.ones_like(sine), sine)
    first = torch.where(near, 1 - weight, torch.sin((1 - weight) * angle) / safe)
    second = torch.where(near, weight, torch.sin(weight * angle) / safe)
    return quaternion_to_axis_angle(normalize_quaternion(first * start + second * end)).to(poses)


def points_at(
    times_s: Float[Array, "R"], known_s: Float[Array, "M"], points: Float[Tensor, "M *n"]
) -> Float[Tensor, "R *n"]:
    """Interpolate points linearly between neighbouring estimates; held beyond the ends.

    Args:
        times_s: times of the rows.
        known_s: times of the estimates, increasing.
        points: points of the estimates, in any unit.
    """
    before, after, share = _between(times_s, known_s)
    weight = share.to(points).view(-1, *(1,) * (points.ndim - 1))
    return (1 - weight) * points[before] + weight * points[after]


def _between(
    times_s: Float[Array, "R"], known_s: Float[Array, "M"]
) -> tuple[Int[Tensor, "R"], Int[Tensor, "R"], Float[Tensor, "R"]]:
    """Return the estimates before and after each time and the share of the later one."""
    position = np.interp(times_s, known_s, np.arange(len(known_s), dtype=np.float64))
    before = np.minimum(position.astype(np.int64), max(len(known_s) - 2, 0))
    after = np.minimum(before + 1, len(known_s) - 1)
    return torch.from_numpy(before), torch.from_numpy(after), torch.from_numpy(position - before)
