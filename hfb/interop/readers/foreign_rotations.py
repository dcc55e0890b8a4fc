"""Conversion of other systems' rotations to axis-angle."""

import numpy as np
import torch

from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle, quaternion_to_axis_angle, six_d_to_matrix
from hfb.typing import Array, Float

_HALF_TURN = np.diag([1.0, -1.0, -1.0])


def from_matrices(matrices: Float[Array, "*n 3 3"]) -> Float[Array, "*n 3"]:
    """Convert matrices that are only nearly rotations, by orthonormalising their first two columns.

    Single ones that are no rotations, or not finite, become NaN.

    Args:
        matrices: matrices of another system.

    Raises:
        InputError: none of them is a rotation.
    """
    columns = torch.from_numpy(np.ascontiguousarray(matrices[..., :2].swapaxes(-1, -2)))
    tidy = six_d_to_matrix(columns.flatten(-2))
    far = ((tidy - torch.from_numpy(matrices)).abs() > 0.2).flatten(-2).any(-1) | (tidy.norm(dim=-2) < 0.9).any(-1)
    if far.numel() and bool(far.all()):
        raise InputError("it holds matrices that are no rotations")
    return matrix_to_axis_angle(tidy).masked_fill(far[..., None], torch.nan).numpy()


def from_quaternions(quaternions: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Convert quaternions (w, x, y, z) of any length; a zero one becomes NaN.

    Args:
        quaternions: (w, x, y, z).
    """
    length = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    length[length < 1e-6] = np.nan
    return quaternion_to_axis_angle(torch.from_numpy(quaternions / length)).numpy()


def turned(R: Float[Array, "3 3"] | Float[Array, "R 3 3"], poses: Float[Array, "R 24 3"]) -> Float[Array, "R 24 3"]:
    """Turn the roots in the world; the other joints turn with them.

    Args:
        R: one rotation, or one per row.
        poses: axis-angle [rad].
    """
    roots = axis_angle_to_matrix(torch.from_numpy(poses[:, 0].copy()))
    result = poses.copy()
    result[:, 0] = matrix_to_axis_angle(torch.from_numpy(np.asarray(R, np.float64)) @ roots).numpy()
    return result


def y_up_to_camera(poses: Float[Array, "R 24 3"]) -> Float[Array, "R 24 3"]:
    """Rotate poses from a world with y up and z towards the viewer to the camera's axes.

    Args:
        poses: axis-angle [rad].
    """
    return turned(_HALF_TURN, poses)
