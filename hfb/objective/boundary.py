"""Continuity between neighbouring frames: the paper's boundary restriction (its section 3.2)."""

import torch

from hfb.body.model import ShapedBody
from hfb.kernels.dispatch import compiled, constant
from hfb.kernels.motion.motion_operators import boundary
from hfb.motion.trajectory import Trajectory
from hfb.typing import Float, Tensor

# Step of the central difference, in exposures: exact for a quadratic path, off by 4e-4 of a cubic one's last
# coefficient, and far above float32's noise.
_STEP = 0.02


def boundary_loss(trajectory: Trajectory, shaped: ShapedBody, next_opening: float) -> Float[Tensor, ""]:
    """Return the L1 distance of the end of each frame from the start of the next, in value and first derivative.

    Compared are joint rotations as matrices (a quaternion and its negative are one rotation), joint and
    root positions [m], and their derivatives per exposure time; each kind enters as a mean over its
    entries. The earlier frame is extrapolated over the exposure gap.

    Args:
        trajectory: polynomials of the motion [m].
        shaped: the body with its shape.
        next_opening: time at which the next shutter opens, on the earlier frame's clock (`clock.next_opening`).
    """
    frames = trajectory.rotation.shape[0]
    if frames < 2:
        return trajectory.rotation.new_zeros(())
    kind, device = trajectory.rotation.dtype, trajectory.rotation.device
    if compiled(trajectory.rotation):
        openings = tuple(opening + step for opening in (next_opening, 0.0) for step in (-_STEP, 0.0, _STEP))
        rotations, translations = trajectory.at(constant(openings, kind, device))
        joints = shaped.joints_of(rotations.flatten(0, 1), translations.flatten(0, 1)).unflatten(0, (frames, -1))
        return boundary(rotations, joints, _STEP)[0]
    steps = constant((-_STEP, 0.0, _STEP), kind, device)
    end = _values_and_rates(trajectory, shaped, steps + next_opening)
    start = _values_and_rates(trajectory, shaped, steps)
    terms = [(after[1:] - before[:-1]).abs().mean() for before, after in zip(end, start, strict=True)]
    return torch.stack(terms).sum()


def _values_and_rates(trajectory: Trajectory, shaped: ShapedBody, u: Float[Tensor, "3"]) -> list[Tensor]:
    rotations, translations = trajectory.at(u)
    frames = rotations.shape[0]
    joints = shaped.joints_of(rotations.flatten(0, 1), translations.flatten(0, 1)).unflatten(0, (frames, 3))
    out = []
    for quantity in (rotations, joints):
        out += [quantity[:, 1], (quantity[:, 2] - quantity[:, 0]) / (2 * _STEP)]
    return out
