"""Compiled motion: rotation matrices of quaternion polynomials, and the path, with gradients by the coefficients."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, loop_entry

TINY = 1e-24  # keeps the norm of a zero quaternion away from zero, as `hfb.geometry.rotations.normalize_quaternion`


@njit(**INLINE)
def _evaluate(coefficients, u, t, j):
    """Return the inverse norm of polynomial j of frame t at an instant, and its unit quaternion."""
    w = x = y = z = 0.0
    power = 1.0
    for d in range(coefficients.shape[1]):
        w += power * coefficients[t, d, j, 0]
        x += power * coefficients[t, d, j, 1]
        y += power * coefficients[t, d, j, 2]
        z += power * coefficients[t, d, j, 3]
        power *= u
    inverse = 1.0 / np.sqrt(w * w + x * x + y * y + z * z + TINY)
    return inverse, w * inverse, x * inverse, y * inverse, z * inverse


@loop_entry
def move(rotation, translation, clock, origin, matrices, path):
    """Evaluate polynomials in `clock` - `origin`.

    Args:
        rotation: (T, D1, 24, 4), coefficients of the quaternions.
        translation: (T, D1, 4), coefficients of the path [m].
        clock: (S), times in exposures.
        origin: time at which powers are zero.
        matrices: (T, S, 24, 3, 3), filled.
        path: (T, S, 3), filled.
    """
    for t in range(rotation.shape[0]):
        for s in range(clock.shape[0]):
            u = np.float64(clock[s]) - origin
            for j in range(rotation.shape[2]):
                _, w, x, y, z = _evaluate(rotation, u, t, j)
                m = matrices[t, s, j]
                m[0, 0], m[0, 1], m[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
                m[1, 0], m[1, 1], m[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
                m[2, 0], m[2, 1], m[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
            for c in range(3):
                total, power = 0.0, 1.0
                for d in range(translation.shape[1]):
                    total += power * translation[t, d, c]
                    power *= u
                path[t, s, c] = total


@loop_entry
def move_gradient(rotation, clock, origin, of_matrices, of_path, of_rotation, of_translation):
    """Compute the gradients of `move`.

    Args:
        rotation: (T, D1, 24, 4), coefficients of the quaternions.
        clock: (S), times in exposures.
        origin: time at which powers are zero.
        of_matrices: gradient by the matrices.
        of_path: gradient by the path.
        of_rotation: gradient, added to.
        of_translation: gradient, added to.
    """
    for t in range(rotation.shape[0]):
        for s in range(clock.shape[0]):
            u = np.float64(clock[s]) - origin
            for j in range(rotation.shape[2]):
                inverse, w, x, y, z = _evaluate(rotation, u, t, j)
                g = of_matrices[t, s, j]
                a, b, c = g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]
                d, e, f = g[2, 1] + g[1, 2], g[0, 2] + g[2, 0], g[1, 0] + g[0, 1]
                of_w = 2.0 * (x * a + y * b + z * c)
                of_x = 2.0 * (w * a + y * f + z * e - 2.0 * x * (g[1, 1] + g[2, 2]))
                of_y = 2.0 * (w * b + x * f + z * d - 2.0 * y * (g[0, 0] + g[2, 2]))
                of_z = 2.0 * (w * c + x * e + y * d - 2.0 * z * (g[0, 0] + g[1, 1]))
                # Through the normalisation: what is along the quaternion changes nothing.
                along = w * of_w + x * of_x + y * of_y + z * of_z
                weight = inverse
                for k in range(rotation.shape[1]):
                    of_rotation[t, k, j, 0] += weight * (of_w - along * w)
                    of_rotation[t, k, j, 1] += weight * (of_x - along * x)
                    of_rotation[t, k, j, 2] += weight * (of_y - along * y)
                    of_rotation[t, k, j, 3] += weight * (of_z - along * z)
                    weight *= u
            power = 1.0
            for k in range(of_translation.shape[1]):
                for c in range(3):
                    of_translation[t, k, c] += power * of_path[t, s, c]
                power *= u
