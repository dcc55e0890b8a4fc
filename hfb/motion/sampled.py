"""The motion as a table: one row per sub-frame of every frame."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from hfb.body.model import Body, ShapedBody
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.geometry.world import LEVEL, World
from hfb.motion.clock import subframe_clock, subframe_times_s
from hfb.motion.trajectory import Trajectory
from hfb.typing import Array, Float, Int, Tensor


@dataclass(frozen=True)
class SampledMotion:
    """R = frames * sub-frames rows in camera coordinates, float64.

    Attributes:
        poses: SMPL axis-angle [rad], the root first.
        trans: SMPL translation [m].
        betas: shape of the whole clip.
        joints: joint positions [m].
        times_s: time since the first shutter opened [s].
        frame_index: the frame each row belongs to.
        K: camera matrix of the full image [px].
        joint_radius_mm: median error of each joint about the pelvis (after one rotation of the sequence), where the
            method estimates it; zero for the pelvis.
        world: of exports; None where nothing is known of it.
        size: width and height of the full image [px]; None in motions that do not say it.
    """

    poses: Float[Array, "R 72"]
    trans: Float[Array, "R 3"]
    betas: Float[Array, "10"]
    joints: Float[Array, "R 24 3"]
    times_s: Float[Array, "R"]
    frame_index: Int[Array, "R"]
    K: Float[Array, "3 3"]
    joint_radius_mm: Float[Array, "R 24"] | None = None
    world: World | None = None
    size: tuple[int, int] | None = None

    @property
    def export_world(self) -> World:
        """The world of exports; the camera is taken as level where nothing is known of it."""
        return self.world or LEVEL

    def rows_of(self, frame: int) -> Int[Array, "S"]:
        """Return the row numbers of one frame's sub-frames, in time.

        Args:
            frame: its number.
        """
        if self._in_order:  # a search of all rows for every frame would take quadratic time
            first, last = np.searchsorted(self.frame_index, (frame, frame + 1)).tolist()
            return np.arange(first, last)
        return np.flatnonzero(self.frame_index == frame)

    @cached_property
    def _in_order(self) -> bool:
        return bool((np.diff(self.frame_index) >= 0).all())


def sample_motion(
    trajectory: Trajectory,
    shaped: ShapedBody,
    betas: Float[Tensor, "10"],
    subframes: int,
    exposure_s: float,
    interval_s: float,
    K: Float[Tensor, "3 3"],
) -> SampledMotion:
    """Evaluate a trajectory at every sub-frame of every frame.

    Args:
        trajectory: polynomials of the motion [m].
        shaped: the body with its shape.
        betas: shape coefficients, which the result records.
        subframes: per exposure.
        exposure_s: time that the shutter is open.
        interval_s: time from one opening of the shutter to the next.
        K: calibration matrix [px], which the result records.
    """
    with torch.no_grad():
        rotations, translations = trajectory.at(subframe_clock(subframes, trajectory.rotation.dtype))
        rotations, translations = rotations.flatten(0, 1), translations.flatten(0, 1)
        joints = shaped.joints_of(rotations, translations)
        poses = matrix_to_axis_angle(rotations.double()).flatten(1)
    times_s, frame_index = subframe_times_s(trajectory.rotation.shape[0], subframes, exposure_s, interval_s)
    return SampledMotion(
        poses=poses.numpy(),
        trans=translations.double().numpy(),
        betas=betas.detach().double().numpy(),
        joints=joints.double().numpy(),
        times_s=times_s,
        frame_index=frame_index,
        K=K.double().numpy(),
    )


def still_motion(
    poses: Float[Tensor, "T 24 3"],
    translations: Float[Tensor, "T 3"],
    betas: Float[Tensor, "10"],
    like: SampledMotion,
    body: Body,
) -> SampledMotion:
    """Return one body per frame, held still through its exposure, at the instants of another motion.

    Args:
        poses: axis-angle [rad], camera coordinates.
        translations: SMPL's [m], camera coordinates.
        betas: shape coefficients.
        like: motion whose instants and camera are used.
        body: model of the poses.
    """
    shaped = body.shape(betas.to(body.template))
    joints = shaped.joints_of(axis_angle_to_matrix(poses.to(body.template)), translations.to(body.template))
    frames = like.frame_index
    return replace(
        like,
        poses=poses.flatten(1).double().numpy()[frames],
        trans=translations.double().numpy()[frames],
        betas=betas.double().numpy(),
        joints=joints.detach().double().numpy()[frames],
        joint_radius_mm=None,
    )
