"""Compiled logarithm of rotation matrices, with its gradient."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, loop_entry


@njit(**INLINE)
def _quaternion(m):
    """Apply Shepperd's method (`hfb.geometry.rotations.matrix_to_quaternion`): largest pivot, w >= 0, not unit."""
    a, e, k = np.float64(m[0, 0]), np.float64(m[1, 1]), np.float64(m[2, 2])
    x, y, z = np.float64(m[2, 1] - m[1, 2]), np.float64(m[0, 2] - m[2, 0]), np.float64(m[1, 0] - m[0, 1])
    xy, xz, yz = np.float64(m[1, 0] + m[0, 1]), np.float64(m[0, 2] + m[2, 0]), np.float64(m[2, 1] + m[1, 2])
    pw, px, py, pz = 1.0 + a + e + k, 1.0 + a - e - k, 1.0 - a + e - k, 1.0 - a - e + k
    if pw >= px and pw >= py and pw >= pz:
        return pw, x, y, z
    if px >= py and px >= pz:
        return (x, px, xy, xz) if x >= 0.0 else (-x, -px, -xy, -xz)
    if py >= pz:
        return (y, xy, py, yz) if y >= 0.0 else (-y, -xy, -py, -yz)
    return (z, xz, yz, pz) if z >= 0.0 else (-z, -xz, -yz, -pz)


@loop_entry
def logarithm(matrices, vectors):
    """Fill the rotation vectors of each frame's first n instants, without the first joint.

    Args:
        matrices: (T, S, J, 3, 3), rotations.
        vectors: (T, n, J - 1, 3), filled; angles in [0, pi] [rad].
    """
    for t, s, j in np.ndindex(vectors.shape[0], vectors.shape[1], vectors.shape[2]):
        w, x, y, z = _quaternion(matrices[t, s, j + 1])
        sine = np.sqrt(x * x + y * y + z * z)
        # The angle by the sine, both of the quaternion as long as it is; 2 / w in the limit.
        factor = 2.0 * np.arctan2(sine, w) / sine if sine > 1e-9 * w else 2.0 / w
        vector = vectors[t, s, j]
        vector[0], vector[1], vector[2] = factor * x, factor * y, factor * z


@loop_entry
def logarithm_gradient(matrices, vectors, grad_output, gradient):
    """Compute the gradient of `logarithm` by the matrices.

    Turning R by a small omega from the left changes its logarithm r by J omega, J the inverse of SO(3)'s left Jacobian
    (Sola et al., A micro Lie theory, 2018, eq. 146); a change [omega]x R has the product omega . h with [h]x R / 2.

    Args:
        matrices: (T, S, J, 3, 3), rotations.
        vectors: result of `logarithm`.
        grad_output: gradient by the vectors.
        gradient: (T, S, J, 3, 3), filled for those instants and joints.
    """
    for t, s, j in np.ndindex(vectors.shape[0], vectors.shape[1], vectors.shape[2]):
        vector, grad_vector = vectors[t, s, j], grad_output[t, s, j]
        turned, into = matrices[t, s, j + 1], gradient[t, s, j + 1]
        x, y, z = np.float64(vector[0]), np.float64(vector[1]), np.float64(vector[2])
        a, b, c = np.float64(grad_vector[0]), np.float64(grad_vector[1]), np.float64(grad_vector[2])
        squared = x * x + y * y + z * z
        half = 0.5 * np.sqrt(squared)
        bend = (1.0 - half / np.tan(half)) / squared if squared > 1e-6 else 1.0 / 12.0
        p, q, r = y * c - z * b, z * a - x * c, x * b - y * a
        a += 0.5 * p + bend * (y * r - z * q)
        b += 0.5 * q + bend * (z * p - x * r)
        c += 0.5 * r + bend * (x * q - y * p)
        for k in range(3):
            u, v, w = np.float64(turned[0, k]), np.float64(turned[1, k]), np.float64(turned[2, k])
            into[0, k] = 0.5 * (b * w - c * v)
            into[1, k] = 0.5 * (c * u - a * w)
            into[2, k] = 0.5 * (a * v - b * u)
