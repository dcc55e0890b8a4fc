"""Compiled distance of the end of each frame from the start of the next, with gradients."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, loop_entry


@njit(**INLINE)
def _gap(values, step, gradient):
    """Return mean absolute differences in value and in rate; fill the gradient.

    `values` (T, 6, n) are three instants about the next frame's opening, as each frame continues, and three about its
    own.
    """
    total, count = 0.0, (values.shape[0] - 1) * values.shape[2]
    gradient[:] = 0.0
    for t in range(values.shape[0] - 1):
        end, start, of_end, of_start = values[t], values[t + 1], gradient[t], gradient[t + 1]
        for n in range(values.shape[2]):
            apart = np.float64(start[4, n]) - np.float64(end[1, n])
            faster = (np.float64(start[5, n]) - np.float64(start[3, n])) - (
                np.float64(end[2, n]) - np.float64(end[0, n])
            )
            total += abs(apart) + abs(faster) / (2.0 * step)
            of_value, of_rate = np.sign(apart) / count, np.sign(faster) / (2.0 * step * count)
            of_start[4, n], of_end[1, n] = of_value, -of_value
            of_start[5, n], of_start[3, n] = of_rate, -of_rate
            of_end[2, n], of_end[0, n] = -of_rate, of_rate
    return total / count


@loop_entry
def boundary(rotations, joints, step, of_rotations, of_joints):
    """Return the sum of both gaps, see `_gap`.

    Args:
        rotations: (T, 6, 216).
        joints: (T, 6, 72) [m].
        step: time between neighbouring instants, in exposures.
        of_rotations: gradient, filled.
        of_joints: gradient, filled.
    """
    return _gap(rotations, step, of_rotations) + _gap(joints, step, of_joints)
