"""A pose prior that needs no file: joint limits from anatomy and a weak pull towards a natural pose.

The limits are the normal ranges of motion of the American Academy of Orthopaedic Surgeons (Joint Motion: Method of
Measuring and Recording, 1965; Greene & Heckman, The Clinical Measurement of Joint Motion, 1994): shoulder flexion
and abduction 180, extension 60, internal rotation 70, external 90; elbow 0 to 150; pronation and supination 80;
wrist 80 / 70, radial 20, ulnar 30; hip flexion 120, extension 30, abduction 45, adduction 30, rotation 45; knee 0 to
135 (150 with heel to thigh); ankle dorsiflexion 20, plantar flexion 50, inversion 35, eversion 15; neck 45 each way,
rotation 60; back flexion 80, extension 25, bending 35, rotation 45. Where the SMPL layout gives one anatomical joint
several rotations (spine, neck, forearm), the range is shared out generously; horizontal adduction is 135, a collar
goes 40 up, and the ankle of a bent leg under load dorsiflexes to 40 (Bennell et al. 1998). Combined motions reach
further than each alone: an arm overhead turns further out than one at the side, a bent thigh opens further than a
straight one. Means and spreads are rounded by hand from everyday and athletic motion capture.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import radians
from typing import NamedTuple

import torch

from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.geometry.rotations import axis_angle_to_quaternion
from hfb.kernels.dispatch import compiled
from hfb.kernels.objective.anatomy_operators import anatomy
from hfb.typing import Float, Int, Tensor

_LIMIT_SCALE_DEG = 4.0
"""Ten degrees beyond a limit cost 3, thirty cost 28: as much as a whole ordinary pose."""


class _Joint(NamedTuple):
    """Limits, mean and standard deviation of one joint in degrees, per axis of the rest pose.

    The axes are x to the person's left, y up, z forward; `twist` is the bone's own (0 x, 1 y, 2 z).
    """

    twist: int
    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]
    mean: tuple[float, float, float]
    spread: tuple[float, float, float]


# Signs in the rest pose (T-pose), left side: +x bends forward what points up and backward what points down; the thigh
# flexes about -x, the knee about +x, the toes go down about +x; the arm goes up about +z and forward about -y; the
# elbow flexes about -y; turning the thumb up (supination, external rotation) is -x; abducting the thigh is +z, turning
# its foot out +y; turning the sole inwards is -z.
_JOINTS: dict[str, _Joint] = {
    "spine1": _Joint(1, (-20, 45), (-30, 30), (-25, 25), (6, 0, 0), (14, 8, 7)),
    "spine2": _Joint(1, (-20, 45), (-30, 30), (-25, 25), (2, 0, 0), (12, 8, 7)),
    "spine3": _Joint(1, (-20, 45), (-30, 30), (-25, 25), (2, 0, 0), (12, 8, 7)),
    "neck": _Joint(1, (-35, 45), (-45, 45), (-35, 35), (4, 0, 0), (14, 14, 10)),
    "head": _Joint(1, (-45, 45), (-50, 50), (-35, 35), (0, 0, 0), (16, 16, 10)),
    "left_hip": _Joint(1, (-130, 30), (-45, 55), (-30, 70), (-20, 0, 5), (30, 16, 13)),
    "left_knee": _Joint(1, (-5, 150), (-20, 20), (-8, 8), (30, 0, 0), (30, 6, 4)),
    "left_ankle": _Joint(2, (-40, 55), (-30, 30), (-35, 20), (-5, 0, 0), (16, 12, 8)),
    "left_foot": _Joint(2, (-60, 40), (-10, 10), (-10, 10), (0, 0, 0), (12, 4, 4)),
    "left_collar": _Joint(0, (-20, 20), (-30, 25), (-12, 45), (0, 0, 0), (6, 8, 9)),
    "left_shoulder": _Joint(0, (-140, 100), (-140, 75), (-110, 95), (-12, -8, -55), (40, 32, 34)),
    "left_elbow": _Joint(0, (-85, 85), (-155, 5), (-12, 12), (5, -50, 0), (26, 36, 5)),
    "left_wrist": _Joint(0, (-45, 45), (-30, 40), (-80, 70), (0, 5, 0), (18, 14, 18)),
    "left_hand": _Joint(0, (-15, 15), (-15, 15), (-90, 30), (0, 0, -10), (5, 5, 20)),
}


@dataclass(frozen=True)
class _Tables:
    """The joints below the root, right ones mirrored, in the order twist, swing, swing.

    `angles` are lowest, highest, mean and standard deviation [rad].
    """

    order: Int[Tensor, "23 3"]
    angles: Float[Tensor, "4 23 3"]


@lru_cache
def _tables(dtype: torch.dtype, device: torch.device) -> _Tables:
    orders, rows = [], []
    for index in range(1, len(JOINT_NAMES)):
        right = JOINT_NAMES[index].startswith("right_")
        joint = _JOINTS[JOINT_NAMES[MIRROR[index] if right else index]]
        limits, mean = [joint.x, joint.y, joint.z], list(joint.mean)
        if right:  # A mirror in the plane x = 0 keeps rotations about x and turns those about y and z around.
            limits[1:] = [(-high, -low) for low, high in limits[1:]]
            mean[1:] = [-angle for angle in mean[1:]]
        order = [(joint.twist + k) % 3 for k in range(3)]
        columns = [(*limits[k], mean[k], joint.spread[k]) for k in order]
        orders.append(order)
        rows.append([[radians(angle) for angle in column] for column in zip(*columns, strict=True)])
    angles = torch.tensor(rows, dtype=torch.float64).to(dtype).transpose(0, 1).contiguous()
    return _Tables(torch.tensor(orders, device=device), angles.to(device))


@lru_cache
def _limits_alone(device: torch.device) -> _Tables:
    """Return tables in which no pose is more natural than another: a spread without end."""
    tables = _tables(torch.float64, device)
    return _Tables(tables.order, torch.cat([tables.angles[:3], torch.full_like(tables.angles[3:], torch.inf)]))


def _by_kernel(axis_angle: Float[Tensor, "S 23 3"], tables: _Tables) -> Float[Tensor, "S"]:
    return anatomy(axis_angle, tables.order, tables.angles, radians(_LIMIT_SCALE_DEG))[0]


def twist_swing(
    axis_angle: Float[Tensor, "*n J 3"], order: Int[Tensor, "J 3"], epsilon: float = 1e-12
) -> Float[Tensor, "*n J 3"]:
    """Split a rotation into twist about the bone, then swing of the bone: the angles of joint limits.

    Unlike the axis-angle vector itself this keeps "how far is the arm raised" apart from "how far is it turned" at
    large angles. It is undefined only for a swing by exactly pi, where gradients stay finite.

    Args:
        axis_angle: joints below the root [rad].
        order: per joint the rest pose's axes (0 x, 1 y, 2 z) in cyclic order, the bone's own axis first.
        epsilon: keeps the gradient finite at zero.

    Returns:
        The twist angle, then the swing's rotation vector along the second and third axis [rad].
    """
    quaternion = axis_angle_to_quaternion(axis_angle)
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    w = quaternion[..., :1]
    along, across = quaternion[..., 1:].gather(-1, order.expand(axis_angle.shape)).split((1, 2), -1)
    cosine_squared = w * w + along * along
    opposite = cosine_squared < epsilon
    cosine = torch.where(opposite, 1, cosine_squared).sqrt()
    twist = 2 * torch.atan2(along, torch.where(opposite, 1, w))
    # swing = rotation times the inverse twist; across it, that is a plane rotation by half the twist.
    swing = (w * across + along * torch.cat([-across[..., 1:], across[..., :1]], -1)) / cosine
    sine_squared = (across * across).sum(-1, keepdim=True)
    still = sine_squared < epsilon
    sine = torch.where(still, 1, sine_squared).sqrt()
    angle_by_sine = torch.where(still, 2 / cosine, 2 * torch.atan2(sine, cosine) / sine)
    return torch.cat([twist, swing * angle_by_sine], -1)


class AnatomicalPrior:
    """Joint limits and a natural pose, for any body in the SMPL layout.

    prior(theta) = 1/2 sum ((x - mean) / spread)^2 + 1/2 sum (excess / 4 degrees)^2 over the twist and swing angles x of
    the 23 joints, excess being how far x lies outside its range. Ordinary poses have 5 to 40.
    """

    def __call__(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """Return the sum of both parts; see `PosePrior`."""
        if not compiled(axis_angle):
            return self.readable(axis_angle)
        return _by_kernel(axis_angle, _tables(torch.float64, axis_angle.device))

    def readable(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """Evaluate the prior in plain torch: the reference of the compiled operator, and for other devices.

        Args:
            axis_angle: joints below the root [rad].
        """
        tables = _tables(axis_angle.dtype, axis_angle.device)
        angles = twist_swing(axis_angle, tables.order)
        _, _, mean, spread = tables.angles
        distance = (angles - mean) / spread
        excess = _excess(angles, tables)
        return (distance * distance + excess * excess).sum((1, 2)) / 2

    def limit_penalty(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """Return the limits' part alone: zero for every pose within the ranges of motion.

        Args:
            axis_angle: joints below the root [rad].
        """
        if compiled(axis_angle):
            return _by_kernel(axis_angle, _limits_alone(axis_angle.device))
        tables = _tables(axis_angle.dtype, axis_angle.device)
        return (_excess(twist_swing(axis_angle, tables.order), tables) ** 2).sum((1, 2)) / 2

    def beyond_limits(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S 23"]:
        """Return how far each joint is outside its range of motion [rad]: the worst of its three angles.

        Args:
            axis_angle: joints below the root [rad].
        """
        tables = _tables(axis_angle.dtype, axis_angle.device)
        return _excess(twist_swing(axis_angle, tables.order), tables).abs().amax(-1) * radians(_LIMIT_SCALE_DEG)


def _excess(angles: Tensor, tables: _Tables) -> Tensor:
    """Return how far the angles are outside their ranges, in units of the limits' softness."""
    lowest, highest, _, _ = tables.angles
    return (angles - angles.clamp(lowest, highest)) / radians(_LIMIT_SCALE_DEG)
