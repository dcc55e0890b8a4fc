"""The coefficient matrix C in the motion prior's form, for any kind of polynomials.

A fit's own coefficients depend on its options: quaternions or axis and angle, time from the start or from the middle,
the camera's frame of the root. Here C is determined by the motion alone: unit quaternions at five instants, and the
quadratic in u - 1/2 nearest to them. The root's rotation and the translation are taken in the body's own frame at
mid-exposure, so that C, and with it the prior, does not depend on the camera: neither on the person's position and
heading nor on the vertical. With the origin in the middle of a symmetric clock, running a column backwards in time,
c(u) -> c(1 - u), changes the sign of its linear coefficient and nothing else.
"""

from functools import lru_cache

import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_COUNT, PARENTS
from hfb.geometry.rotations import in_hemisphere_of, matrix_to_quaternion, normalize_quaternion, quaternion_to_matrix
from hfb.kernels.dispatch import constant
from hfb.motion.trajectory import Trajectory
from hfb.typing import Bool, Float, Tensor

DEGREE = 2
COLUMN_COUNT = JOINT_COUNT + 1
"""The 24 rotations (the root first), then the translation [m], whose fourth entry is zero."""

CLOCK: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Instants u at which a motion is sampled; the middle one has to be there."""

LIMBS: dict[str, tuple[int, ...]] = {
    "torso": (0, 3, 6, 9, 12, 15, JOINT_COUNT),
    "left leg": (1, 4, 7, 10),
    "right leg": (2, 5, 8, 11),
    "left arm": (13, 16, 18, 20, 22),
    "right arm": (14, 17, 19, 21, 23),
}
"""Columns that an image confuses together: which way a limb moved is one question per limb."""


def motion_columns(trajectory: Trajectory) -> Float[Tensor, "T 3 25 4"]:
    """Return C of every frame's motion; differentiable, for both kinds of polynomials and any degree and origin.

    Args:
        trajectory: polynomials of the motion.
    """
    return columns_of(*trajectory.at(constant(CLOCK, trajectory.rotation.dtype, trajectory.rotation.device)))


def columns_of(
    rotations: Float[Tensor, "T 5 24 3 3"], translations: Float[Tensor, "T 5 3"]
) -> Float[Tensor, "T 3 25 4"]:
    """Return C of motions given at the instants of `CLOCK`: rotations as in `Trajectory.at`, translations [m].

    Args:
        rotations: rotations of every joint at the instants of `CLOCK`.
        translations: at the same instants [m].
    """
    middle = CLOCK.index(0.5)
    R_body_camera = rotations[:, middle, 0].mT
    root = R_body_camera[:, None] @ rotations[:, :, 0]
    path = ((translations - translations[:, middle, None])[..., None, :] @ R_body_camera.mT[:, None]).squeeze(-2)
    quaternions = matrix_to_quaternion(torch.cat([root[:, :, None], rotations[:, :, 1:]], 2))
    quaternions = in_hemisphere_of(quaternions, quaternions[:, middle, None].expand_as(quaternions))
    still = path.new_zeros(*path.shape[:2], 1)
    curves = torch.cat([quaternions, torch.cat([path, still], -1)[:, :, None]], 2)
    return torch.einsum("ds,tsjc->tdjc", _least_squares(rotations.dtype, rotations.device), curves)


def at_instants(
    columns: Float[Tensor, "T 3 25 4"], u: Float[Tensor, "S"]
) -> tuple[Float[Tensor, "T S 24 3 3"], Float[Tensor, "T S 3"]]:
    """Evaluate the motion of C in the body's own frame at mid-exposure: rotations and translations [m] at u.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
        u: times [exposures].
    """
    powers = (u - 0.5)[:, None] ** torch.arange(DEGREE + 1, dtype=u.dtype, device=u.device)
    curves = torch.einsum("sd,tdjc->tsjc", powers, columns)
    return quaternion_to_matrix(normalize_quaternion(curves[:, :, :JOINT_COUNT])), curves[:, :, JOINT_COUNT, :3]


def joint_places(
    rest: Float[Tensor, "24 3"], rotations: Float[Tensor, "n 24 3 3"], translations: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 24 3"]:
    """Return `ShapedBody.joints_of`, five times as fast for thousands of instants and without the surface.

    Args:
        rest: joints of the rest pose [m].
        rotations: rotations of every joint in its parent's frame.
        translations: translations of the body [m].
    """
    turns, places = [rotations[:, 0]], [rest[0] + translations]
    for joint in range(1, JOINT_COUNT):
        parent = PARENTS[joint]
        places.append(places[parent] + turns[parent] @ (rest[joint] - rest[parent]))
        turns.append(turns[parent] @ rotations[:, joint])
    return torch.stack(places, 1)


def reversed_columns(columns: Float[Tensor, "T 3 25 4"], which: Bool[Tensor, "T 25"]) -> Float[Tensor, "T 3 25 4"]:
    """Return C with some columns running backwards in time.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
        which: columns to reverse, per motion.
    """
    signs = torch.where(which, -1.0, 1.0).to(columns)[:, None, :, None]
    return torch.cat([columns[:, :1], columns[:, 1:2] * signs, columns[:, 2:]], 1)


@lru_cache(maxsize=1)
def mean_rest_joints() -> Float[Tensor, "24 3"]:
    """Return joints of the embedded body's mean shape [m], for a person of unknown shape."""
    return load_default_body().joint_template


@lru_cache
def _least_squares(dtype: torch.dtype, device: torch.device) -> Float[Tensor, "3 5"]:
    powers = (torch.tensor(CLOCK, dtype=torch.float64) - 0.5)[:, None] ** torch.arange(DEGREE + 1)
    return torch.linalg.pinv(powers).to(device, dtype)
