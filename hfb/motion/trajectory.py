"""Polynomial motion: matrix C of the paper, one polynomial of degree d per degree of freedom."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch.nn.functional import normalize

from hfb.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    in_hemisphere_of,
    normalize_quaternion,
    quaternion_to_matrix,
)
from hfb.kernels.dispatch import compiled
from hfb.kernels.motion.motion_operators import move
from hfb.typing import Float, Tensor

RotationKind = Literal["quaternion", "axis-angle"]

# Axis + angle is singular at angle 0, where the axis has no effect: start at least this far from it [rad].
_SMALLEST_START_ANGLE = 0.05


@dataclass(frozen=True)
class Trajectory:
    """Polynomials in u - origin for 24 rotations and one translation, per frame.

    ``quaternion``: 4 dof per rotation, normalised after evaluation (never singular); the translation is
    plain xyz [m] and its fourth column unused. ``axis-angle``, the paper's: axis (3) and angle (1) per
    rotation, direction (3) and distance (1) [m] of the translation, as seen from the camera: counted from the start,
    whose distance would be 0, the direction would have no effect.

    Attributes:
        rotation: coefficients, the constants first.
        translation: coefficients, the constants first.
        origin: the u at which all higher terms vanish (0: start of the exposure, 0.5: its middle).
    """

    rotation: Float[Tensor, "T D1 24 4"]
    translation: Float[Tensor, "T D1 4"]
    kind: RotationKind = "quaternion"
    origin: float = 0.0

    def with_coefficients(
        self, rotation: Float[Tensor, "T D1 24 4"], translation: Float[Tensor, "T D1 4"]
    ) -> "Trajectory":
        """Return the trajectory with other coefficients.

        Args:
            rotation: coefficients by degree.
            translation: coefficients by degree [m].
        """
        return replace(self, rotation=rotation, translation=translation)

    def at(self, u: Float[Tensor, "S"]) -> tuple[Float[Tensor, "T S 24 3 3"], Float[Tensor, "T S 3"]]:
        """Return rotations (root: body to camera; joints: relative to their parents) and translations [m] at u.

        Args:
            u: times in units of the exposure.
        """
        if self.kind == "quaternion" and compiled(u):
            return move(self.rotation, self.translation, u, self.origin)
        powers = (u - self.origin)[:, None] ** torch.arange(self.rotation.shape[1], dtype=u.dtype, device=u.device)
        path = powers @ self.translation
        curve = torch.einsum("sd,tdjc->tsjc", powers, self.rotation)
        if self.kind == "quaternion":
            return quaternion_to_matrix(normalize_quaternion(curve)), path[..., :3]
        axis_angle = normalize(curve[..., :3], dim=-1) * curve[..., 3:]
        return axis_angle_to_matrix(axis_angle), normalize(path[..., :3], dim=-1) * path[..., 3:]

    def enlarged(
        self, factor: Float[Tensor, ""], pelvis: Float[Tensor, "3"], new_pelvis: Float[Tensor, "3"]
    ) -> "Trajectory":
        """Return the same image motion for a person `factor` times as large, and as far away; ``quaternion`` alone.

        Args:
            factor: factor of the person's size.
            pelvis: rest pelvis of the person before [m]; SMPL's root turns about it.
            new_pelvis: rest pelvis of the person after [m].
        """
        path = self.translation[..., :3] * factor
        constants = path[:, :1] + factor * pelvis - new_pelvis
        moved = torch.cat([torch.cat([constants, path[:, 1:]], 1), self.translation[..., 3:]], -1)
        return replace(self, translation=moved)


def trajectory_at_rest(
    poses: Float[Tensor, "T 24 3"],
    translations: Float[Tensor, "T 3"],
    degree: int,
    kind: RotationKind = "quaternion",
    origin: float = 0.0,
) -> Trajectory:
    """Return the start of a fit: constants from a static body per frame, all other coefficients zero.

    Args:
        poses: axis-angle [rad], the root first.
        translations: SMPL's translation in camera coordinates [m].
        degree: degree of the polynomials.
        kind: parametrisation of rotations.
        origin: time u at which powers are zero.
    """
    frames = poses.shape[0]
    rotation = poses.new_zeros(frames, degree + 1, 24, 4)
    translation = poses.new_zeros(frames, degree + 1, 4)
    if kind == "quaternion":
        constants = axis_angle_to_quaternion(poses)
        for frame in range(1, frames):
            constants[frame] = in_hemisphere_of(constants[frame], constants[frame - 1])
        rotation[:, 0] = constants
        translation[:, 0, :3] = translations
    else:
        rotation[:, 0] = _with_length(poses)
        rotation[:, 0, :, 3].clamp_min_(_SMALLEST_START_ANGLE)
        translation[:, 0] = _with_length(translations)
    return Trajectory(rotation, translation, kind, origin)


def _with_length(vectors: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """Return the direction, x where there is none, and the length of each vector."""
    length = vectors.norm(dim=-1, keepdim=True)
    direction = torch.where(length > 1e-6, normalize(vectors, dim=-1), vectors.new_tensor([1.0, 0, 0]))
    return torch.cat([direction, length], -1)


def move_towards_neighbours(trajectory: Trajectory, interval_u: float) -> Trajectory:
    """Set first velocities of several frames: central differences of the neighbouring frames' constants.

    Args:
        trajectory: one static body per frame.
        interval_u: time from one frame to the next in units of the exposure.
    """
    frames = trajectory.rotation.shape[0]
    if frames < 2 or trajectory.kind != "quaternion":
        return trajectory
    rotation, translation = trajectory.rotation.clone(), trajectory.translation.clone()
    for coefficients in (rotation, translation):
        constants = coefficients[:, 0]
        coefficients[:, 1] = torch.gradient(constants, spacing=interval_u, dim=0)[0]
    return trajectory.with_coefficients(rotation, translation)
