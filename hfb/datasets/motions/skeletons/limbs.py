"""An arm or a leg: two bones and the hinge between them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded

from hfb.geometry.quaternions import conjugate, from_axes, multiply, rotate, unit
from hfb.typing import Array, Float

_REST_SHARE = 0.02
"""Weight of the expected hinge axis against what the clip's bends show: it decides for limbs that never bend."""

_FRAME_WEIGHT = 0.02
"""Weight of the foreign frame against the plane of the bend, which has its squared sine: equal at 8 degrees."""

_CARRY_S = 0.08
"""Time for which the plane of a bend is used once the limb is straight."""

_BACKWARD = -0.3
"""Cosine between the axis of the bends and the anatomical one below which a limb is broken: some conversions of CMU's
boxing have the forearms turned round the upper arms by half a turn."""


@dataclass(frozen=True)
class Limb:
    """Directions of the upper and the lower bone over time, unit length, and the world frame of the upper one."""

    upper: Float[Array, "F 3"]
    lower: Float[Array, "F 3"]
    frame: Float[Array, "F 4"]
    fps: float

    def hinge(self, expected: Float[Array, "F 3"]) -> Float[Array, "F 3"]:
        """Return the axis about which knee or elbow bend, over time [unit length].

        It is perpendicular to both bones where the limb is bent. In the upper bone's own frame it hardly moves, so
        elsewhere its mean there over the clip is used, turned towards the plane of the bend as far as that is visible.

        Args:
            expected: axis to assume if the limb never bends.
        """
        across = np.cross(self.upper, self.lower)  # as long as the sine of the bend
        sine = np.linalg.norm(across, axis=-1, keepdims=True)
        mean = self._mean_in_frame(across * sine + _REST_SHARE * expected)
        carried = _across(rotate(self.frame, mean), self.upper)
        sideways = np.cross(self.upper, carried)
        turn = (across * carried).sum(-1) + 1j * (across * sideways).sum(-1)
        # Squared, a plane and its opposite are one: a knee a little too far back does not turn the leg round.
        angle = np.angle(self._smooth(turn * turn, sine[:, 0]))[:, None] / 2
        return np.cos(angle) * carried + np.sin(angle) * sideways

    def bends_backward(self, expected: Float[Array, "F 3"]) -> bool:
        """Return whether the hinge bends the impossible way, over the clip as a whole.

        Args:
            expected: anatomical axis of the hinge.
        """
        across = np.cross(self.upper, self.lower)
        seen = self._mean_in_frame(across * np.linalg.norm(across, axis=-1, keepdims=True))
        return bool(seen @ self._mean_in_frame(expected) < _BACKWARD)

    def turned_round(self) -> "Limb":
        """Return the limb with the lower bone on the other side of the upper one."""
        along = (self.lower * self.upper).sum(-1, keepdims=True) * self.upper
        return replace(self, lower=2 * along - self.lower)

    def _mean_in_frame(self, axes: Float[Array, "F 3"]) -> Float[Array, "3"]:
        return unit(rotate(conjugate(self.frame), axes).sum(0))

    def _smooth(self, seen: np.ndarray, sine: Float[Array, "F"]) -> np.ndarray:
        """Smooth turns: minimise the weighted distance from the observations, from zero, and the change over time."""
        weight = sine * sine
        stiffness = (_CARRY_S * self.fps) ** 2 * _FRAME_WEIGHT
        bands = np.zeros((2, len(seen)))
        bands[1] = weight + _FRAME_WEIGHT + 2 * stiffness
        bands[1, [0, -1]] -= stiffness
        bands[0, 1:] = -stiffness
        return solveh_banded(bands, seen + _FRAME_WEIGHT)


def align_frame(
    bone: Float[Array, "F 3"], hinge: Float[Array, "F 3"], rest_bone: Float[Array, "3"], rest_hinge: Float[Array, "3"]
) -> Float[Array, "F 4"]:
    """Return the rotation that takes a bone from rest to its direction, and its hinge as near as that allows.

    Args:
        bone: direction of the bone.
        hinge: axis of the hinge.
        rest_bone: direction of the bone at rest.
        rest_hinge: axis of the hinge at rest.
    """
    return multiply(_frame(bone, hinge), conjugate(_frame(unit(rest_bone), rest_hinge)))


def _frame(bone: Float[Array, "*n 3"], hinge: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    across = _across(hinge, bone)
    return from_axes(bone, across, np.cross(bone, across))


def _across(vector: Float[Array, "*n 3"], bone: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Return the part of a vector that is at right angles to the bone, of unit length."""
    return unit(vector - (vector * bone).sum(-1, keepdims=True) * bone)
