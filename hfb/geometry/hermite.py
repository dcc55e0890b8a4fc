"""Joining of two motions: the gap between them, and the cubic Hermite curves that close it.

Rotations are represented by logarithms about the rotation half-way between both sides: there they add up like
positions, and continuity in value and derivative carries over to the rotation.
"""

from dataclasses import dataclass

import torch

from hfb.geometry.rotations import axis_angle_to_quaternion, multiply_quaternions, quaternion_to_axis_angle
from hfb.typing import Float, Tensor

STEP = 1e-4
"""Step of the central differences, in exposures: with double precision their error is about 1e-8."""


@dataclass(frozen=True, eq=False)
class Meeting:
    """E pairs of motions at the instants where they meet: index 0 is the earlier one.

    Attributes:
        middle: unit quaternions half-way between both.
        turn: logarithms [rad] of both about the middle.
        path: translations [m].
        turn_rate: their derivatives by u.
        path_rate: their derivatives by u.
    """

    middle: Float[Tensor, "E 24 4"]
    turn: Float[Tensor, "2 E 24 3"]
    path: Float[Tensor, "2 E 3"]
    turn_rate: Float[Tensor, "2 E 24 3"]
    path_rate: Float[Tensor, "2 E 3"]

    @staticmethod
    def of(rotations: Float[Tensor, "2 E 3 24 4"], paths: Float[Tensor, "2 E 3 3"]) -> "Meeting":
        """Compute the gap from both motions one step before, at, and one step after the instant.

        Args:
            rotations: unit quaternions of the earlier and the later motion.
            paths: translations [m] of the earlier and the later motion.
        """
        middle = blend_rotations(rotations[0, :, 1], rotations[1, :, 1], 0.5)
        turns = log_about(middle[None, :, None].expand_as(rotations), rotations)
        return Meeting(
            middle,
            turns[:, :, 1],
            paths[:, :, 1],
            (turns[:, :, 2] - turns[:, :, 0]) / (2 * STEP),
            (paths[:, :, 2] - paths[:, :, 0]) / (2 * STEP),
        )

    def closing(
        self, away: Float[Tensor, "E S"], side: int, reach: float
    ) -> tuple[Float[Tensor, "E S 24 3"], Float[Tensor, "E S 3"]]:
        """Return the correction of one side so that both meet half-way, in value and derivative.

        Args:
            away: time to the meeting, in exposures.
            side: 0 for the earlier motion.
            reach: distance from which on the correction is zero.
        """
        s = (1 - away / reach).clamp(0, 1)
        sign = 1 - 2 * side
        value, rate = sign * s * s * (3 - 2 * s) / 2, reach * s * s * (s - 1) / 2
        return (
            value[..., None, None] * (self.turn[1] - self.turn[0])[:, None]
            + rate[..., None, None] * (self.turn_rate[1] - self.turn_rate[0])[:, None],
            value[..., None] * (self.path[1] - self.path[0])[:, None]
            + rate[..., None] * (self.path_rate[1] - self.path_rate[0])[:, None],
        )

    def bridge(
        self, share: Float[Tensor, "E S"], span: Float[Tensor, "E"]
    ) -> tuple[Float[Tensor, "E S 24 4"], Float[Tensor, "E S 3"]]:
        """Return the cubic from the earlier motion's end to the later one's beginning.

        Args:
            share: share of the interval in time, 0 to 1.
            span: length of the bridge, in exposures.
        """
        s = share
        lasts = span[:, None]
        factors = (
            2 * s**3 - 3 * s**2 + 1, 3 * s**2 - 2 * s**3, lasts * (s**3 - 2 * s**2 + s), lasts * (s**3 - s**2)
        )  # fmt: skip
        turns = (self.turn[0], self.turn[1], self.turn_rate[0], self.turn_rate[1])
        paths = (self.path[0], self.path[1], self.path_rate[0], self.path_rate[1])
        turn = torch.stack([f[..., None, None] * v[:, None] for f, v in zip(factors, turns, strict=True)]).sum(0)
        path = torch.stack([f[..., None] * v[:, None] for f, v in zip(factors, paths, strict=True)]).sum(0)
        return turned_by(self.middle[:, None].expand(*turn.shape[:-1], 4), turn), path


def blend_rotations(
    one: Float[Tensor, "*n 4"], other: Float[Tensor, "*n 4"], share: Float[Tensor, "*m"] | float
) -> Float[Tensor, "*n 4"]:
    """Interpolate along the shorter geodesic.

    Args:
        one: unit quaternion at share 0.
        other: unit quaternion at share 1.
        share: weight of `other`, from 0 to 1.
    """
    return turned_by(one, share * log_about(one, other))


def log_about(origin: Float[Tensor, "*n 4"], rotation: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3"]:
    """Return the axis-angle [rad] of a rotation relative to another one.

    Args:
        origin: unit quaternion (w, x, y, z).
        rotation: unit quaternion.
    """
    inverse = origin * origin.new_tensor([1.0, -1.0, -1.0, -1.0])
    return quaternion_to_axis_angle(multiply_quaternions(inverse, rotation))


def turned_by(origin: Float[Tensor, "*n 4"], turn: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """Invert `log_about`.

    Args:
        origin: unit quaternion (w, x, y, z).
        turn: axis-angle [rad] relative to the origin.
    """
    return multiply_quaternions(origin, axis_angle_to_quaternion(turn))
