"""Compiled step of Adam (Kingma and Ba, Adam: A Method for Stochastic Optimization, 2015, algorithm 1)."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np

from hfb.kernels.compile import loop_entry

MEAN_DECAY, SQUARE_DECAY = 0.9, 0.999


@loop_entry
def step(values, gradient, mean, square, steps, rate, epsilon):
    """Update the running means of the gradient and of its square, then the values.

    Args:
        values: (n), updated.
        gradient: (n).
        mean: (n), running mean of the gradient, updated.
        square: (n), running mean of its square, updated.
        steps: number of this step, from 1 on.
        rate: learning rate.
        epsilon: added to the root of the mean square.
    """
    kind = values.dtype.type
    of_mean, of_square, epsilon = kind(1.0 - MEAN_DECAY), kind(1.0 - SQUARE_DECAY), kind(epsilon)
    rate = kind(rate / (1.0 - MEAN_DECAY**steps))
    larger = kind(1.0 / np.sqrt(1.0 - SQUARE_DECAY**steps))
    for n in range(values.shape[0]):
        slope = gradient[n]
        mean[n] += of_mean * (slope - mean[n])
        square[n] += of_square * (slope * slope - square[n])
        values[n] -= rate * mean[n] / (larger * np.sqrt(square[n]) + epsilon)
