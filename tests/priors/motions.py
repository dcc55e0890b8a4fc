"""Trajectories to try the motion prior on."""

from dataclasses import replace

import torch

from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.motion.trajectory import RotationKind, Trajectory, trajectory_at_rest


def moving(seed: int = 0, frames: int = 1, degree: int = 2, dtype: torch.dtype = torch.float32) -> Trajectory:
    """A lively motion of quaternion polynomials about the middle of the exposure."""
    generator = torch.Generator().manual_seed(seed)

    def normals(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)

    still = trajectory_at_rest(0.5 * normals(frames, 24, 3), 2 * normals(frames, 3), degree, "quaternion", 0.5)
    rotation, translation = still.rotation.clone(), still.translation.clone()
    rotation[:, 1:] += 0.15 * normals(*rotation[:, 1:].shape)
    translation[:, 1:, :3] += 0.3 * normals(*translation[:, 1:, :3].shape)
    return still.with_coefficients(rotation, translation)


def backwards(trajectory: Trajectory) -> Trajectory:
    """The same motion, c(1 - u); the origin has to be the middle."""
    signs = torch.tensor([(-1.0) ** k for k in range(trajectory.rotation.shape[1])]).to(trajectory.rotation)
    return trajectory.with_coefficients(
        trajectory.rotation * signs[:, None, None], trajectory.translation * signs[:, None]
    )


def seen_by_another_camera(trajectory: Trajectory, seed: int = 1) -> Trajectory:
    """The same motion in a camera that stands elsewhere and is turned; frames at rest in each other's frame."""
    generator = torch.Generator().manual_seed(seed)
    turn = axis_angle_to_matrix(torch.randn(3, generator=generator, dtype=torch.float64)).to(trajectory.rotation)
    place = torch.randn(3, generator=generator, dtype=torch.float64).to(trajectory.rotation)
    rotation, translation = trajectory.rotation.clone(), trajectory.translation.clone()
    w, x, y, z = _quaternion(turn)
    left = torch.stack(
        [
            torch.stack([w, -x, -y, -z]),
            torch.stack([x, w, -z, y]),
            torch.stack([y, z, w, -x]),
            torch.stack([z, -y, x, w]),
        ]
    )
    rotation[:, :, 0] = rotation[:, :, 0] @ left.T
    translation[..., :3] = translation[..., :3] @ turn.T
    translation[:, 0, :3] += place
    return trajectory.with_coefficients(rotation, translation)


def as_axis_angle_at_rest(kind: RotationKind, seed: int = 0) -> Trajectory:
    """A body that does not move, in either kind of polynomials."""
    generator = torch.Generator().manual_seed(seed)
    poses = 0.5 * torch.randn(1, 24, 3, generator=generator) + 0.1
    return trajectory_at_rest(poses, torch.tensor([[0.1, 0.2, 3.0]]), 2, kind, 0.0)


def from_origin(trajectory: Trajectory, origin: float) -> Trajectory:
    """The same polynomials, expanded about another time."""
    shift = origin - trajectory.origin
    a, b, c = trajectory.rotation.unbind(1)
    d, e, f = trajectory.translation.unbind(1)
    rotation = torch.stack([a + shift * b + shift**2 * c, b + 2 * shift * c, c], 1)
    translation = torch.stack([d + shift * e + shift**2 * f, e + 2 * shift * f, f], 1)
    return replace(trajectory.with_coefficients(rotation, translation), origin=origin)


def _quaternion(turn: torch.Tensor) -> torch.Tensor:
    from hfb.geometry.rotations import axis_angle_to_quaternion

    return axis_angle_to_quaternion(matrix_to_axis_angle(turn)).unbind(-1)
