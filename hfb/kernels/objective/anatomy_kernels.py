"""Compiled anatomical prior: joint limits and a natural pose, with the gradient in the same pass."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, loop_entry

EPSILON = 1e-12  # as in `hfb.priors.anatomy.twist_swing`


@njit(**INLINE)
def _cost(angle, lowest, highest, mean, spread, softness):
    """Return the cost of one angle, and its slope."""
    distance, excess = (angle - mean) / spread, (angle - min(max(angle, lowest), highest)) / softness
    return 0.5 * (distance * distance + excess * excess), distance / spread + excess / softness


@loop_entry
def anatomy(poses, order, tables, softness, values, gradient):
    """Fill values and gradient of the prior.

    Args:
        poses: (S, 23, 3), axis-angle [rad].
        order: (23, 3), axes of twist and swing, see `twist_swing`.
        tables: (4, 23, 3), lowest, highest, mean, spread [rad].
        softness: width over which the limits set in [rad].
        values: (S), filled.
        gradient: (S, 23, 3), filled.
    """
    for s in range(poses.shape[0]):
        total = 0.0
        for j in range(poses.shape[1]):
            x, y, z = np.float64(poses[s, j, 0]), np.float64(poses[s, j, 1]), np.float64(poses[s, j, 2])
            squared = x * x + y * y + z * z
            half = 0.5 * np.sqrt(squared)
            w = np.cos(half)
            sign = -1.0 if w < 0.0 else 1.0
            # sin(angle / 2) / angle, and its slope by the angle over the angle.
            stretch = 0.5 * np.sin(half) / half if squared > 1e-8 else 0.5 - squared / 48.0
            bend = (0.5 * w - stretch) / squared if squared > 1e-4 else squared / 960.0 - 1.0 / 24.0
            i0, i1, i2 = order[j, 0], order[j, 1], order[j, 2]
            turned = sign * stretch
            a, b, c = turned * poses[s, j, i0], turned * poses[s, j, i1], turned * poses[s, j, i2]
            w *= sign
            # Twist and swing as `twist_swing` has them: k the cosine of half the swing, m its sine.
            k_squared, m_squared = w * w + a * a, b * b + c * c
            opposite, still = k_squared < EPSILON, m_squared < EPSILON
            k, base = (1.0, 1.0) if opposite else (np.sqrt(k_squared), w)
            m = 1.0 if still else np.sqrt(m_squared)
            first, second = (w * b - a * c) / k, (w * c + a * b) / k
            factor = 2.0 / k if still else 2.0 * np.arctan2(m, k) / m
            cost_0, g0 = _cost(
                2.0 * np.arctan2(a, base),
                tables[0, j, 0],
                tables[1, j, 0],
                tables[2, j, 0],
                tables[3, j, 0],
                softness,
            )
            cost_1, g1 = _cost(
                first * factor, tables[0, j, 1], tables[1, j, 1], tables[2, j, 1], tables[3, j, 1], softness
            )
            cost_2, g2 = _cost(
                second * factor, tables[0, j, 2], tables[1, j, 2], tables[2, j, 2], tables[3, j, 2], softness
            )
            total += cost_0 + cost_1 + cost_2
            # Backward: through the factor, the two components of the swing, and the twist.
            of_factor = g1 * first + g2 * second
            by_length = 0.0 if still else of_factor * (2.0 * k / (m_squared + k * k) - factor) / m_squared
            g1, g2 = g1 * factor / k, g2 * factor / k
            of_w, of_a = g1 * b + g2 * c, g2 * b - g1 * c
            of_b, of_c = g1 * w + g2 * a + by_length * b, g2 * w - g1 * a + by_length * c
            of_a += 2.0 * g0 * base / (a * a + base * base)
            if not opposite:
                of_k = -(g1 * first + g2 * second) - of_factor * 2.0 / (k * k if still else m_squared + k * k)
                of_w += of_k * w / k - 2.0 * g0 * a / k_squared
                of_a += of_k * a / k
            # From the quaternion to the vector.
            along = (of_a * poses[s, j, i0] + of_b * poses[s, j, i1] + of_c * poses[s, j, i2]) * sign * bend
            along -= 0.5 * of_w * turned
            gradient[s, j, i0] = turned * of_a + along * poses[s, j, i0]
            gradient[s, j, i1] = turned * of_b + along * poses[s, j, i1]
            gradient[s, j, i2] = turned * of_c + along * poses[s, j, i2]
        values[s] = total
