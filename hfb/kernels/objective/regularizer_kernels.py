"""Compiled regularisers of the motion's size and of the pose's distance from the start, with gradients."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np

from hfb.kernels.compile import loop_entry


@loop_entry
def motion_size(rotation, translation, epsilon, of_rotation, of_translation):
    """Return |C|_1 + |C|_F of all coefficients but the constants; fill their gradients.

    Args:
        rotation: (T, D1, n), coefficients.
        translation: (T, D1, n), coefficients [m].
        epsilon: rounds |C|_F at zero.
        of_rotation: gradient, filled.
        of_translation: gradient, filled.
    """
    total, squares = 0.0, 0.0
    for coefficients in (rotation, translation):
        for t in range(coefficients.shape[0]):
            for d in range(1, coefficients.shape[1]):
                for n in range(coefficients.shape[2]):
                    value = np.float64(coefficients[t, d, n])
                    total += abs(value)
                    squares += value * value
    norm = np.sqrt(squares + epsilon * epsilon)
    for coefficients, gradient in ((rotation, of_rotation), (translation, of_translation)):
        for t in range(coefficients.shape[0]):
            gradient[t, 0] = 0.0
            for d in range(1, coefficients.shape[1]):
                for n in range(coefficients.shape[2]):
                    value = np.float64(coefficients[t, d, n])
                    gradient[t, d, n] = np.sign(value) + value / norm
    return total + norm - epsilon


@loop_entry
def start_distance(rotations, first, gradient):
    """Return 3 minus the mean inner product of each frame's last rotations and the first bodies'; fill the gradient.

    Args:
        rotations: (T, S, J, 3, 3).
        first: (T, J, 3, 3), of the first bodies.
        gradient: (T, S, J, 3, 3), filled.
    """
    total, count = 0.0, first.shape[0] * first.shape[1]
    gradient[:] = 0.0
    for t in range(first.shape[0]):
        last = rotations.shape[1] - 1
        for j in range(first.shape[1]):
            for r in range(3):
                for c in range(3):
                    total += np.float64(rotations[t, last, j, r, c]) * np.float64(first[t, j, r, c])
                    gradient[t, last, j, r, c] = -first[t, j, r, c] / count
    return 3.0 - total / count
