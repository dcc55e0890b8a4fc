"""Compiled parts: the image and the matting loss at several scales, with their gradients in the same pass.

A pyramid is one list of pixels, level after level, row after row; each level halves the last (rounding up), and a
coarse pixel is the mean of the one, two or four that it covers.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import LOOP, entry

EMPTY_PX = 1e-6  # as in `hfb.losses.matting`


@njit(**LOOP)
def _shrink(level, height, width, channels, values):
    """Fill the level after the one that begins at pixel `level`."""
    rows, columns, after = (height + 1) // 2, (width + 1) // 2, level + height * width
    for r in range(rows):
        r1 = min(2 * r + 1, height - 1)
        for c in range(columns):
            c1 = min(2 * c + 1, width - 1)
            a, b = level + 2 * r * width + 2 * c, level + 2 * r * width + c1
            e, f = level + r1 * width + 2 * c, level + r1 * width + c1
            for q in range(channels):  # at an odd border the same pixels twice: the mean stays the mean
                values[after + r * columns + c, q] = 0.25 * (
                    (values[a, q] + values[b, q]) + (values[e, q] + values[f, q])
                )


@njit(**LOOP)
def _enlarge(level, height, width, channels, gradient):
    """Way back of `_shrink`: add to a level's gradient that of the level after it."""
    columns, after = (width + 1) // 2, level + height * width
    for r in range(height):
        of_row = 1.0 if r == height - 1 and height % 2 == 1 else 0.5
        for c in range(width):
            share = of_row * (1.0 if c == width - 1 and width % 2 == 1 else 0.5)
            for q in range(channels):
                gradient[level + r * width + c, q] += share * gradient[after + (r // 2) * columns + c // 2, q]


@njit(**LOOP)
def _differ(mean, plate, frame, difference):
    """Eq. (1) minus the picture seen."""
    for p in range(mean.shape[0]):
        through = 1.0 - mean[p, 3]
        for q in range(3):
            difference[p, q] = through * plate[p, q] + mean[p, q] - frame[p, q]


@njit(**LOOP)
def _squares(level, count, area, scales, difference, gradient):
    """One level's L_I, eq. (3), and its gradient, both divided by the number of scales."""
    total, slope = 0.0, difference.dtype.type(2.0 / (3.0 * area * scales))
    for p in range(level, level + count):
        a, b, c = difference[p, 0], difference[p, 1], difference[p, 2]
        total += np.float64(a * a + b * b + c * c)
        gradient[p, 0], gradient[p, 1], gradient[p, 2] = slope * a, slope * b, slope * c
    return total / (3.0 * area * scales)


@njit(**LOOP)
def _overlap(level, count, scales, alpha, matte, gradient):
    """One level's L_alpha, eq. (4), and its gradient, both divided by the number of scales."""
    shared, covered = EMPTY_PX, EMPTY_PX
    for p in range(level, level + count):
        shared += np.float64(min(alpha[p, 0], matte[p, 0]))
        covered += np.float64(max(alpha[p, 0], matte[p, 0]))
    of_shared, of_covered = -1.0 / (covered * scales), shared / (covered * covered * scales)
    for p in range(level, level + count):
        a, m = alpha[p, 0], matte[p, 0]
        gradient[p, 0] = of_shared if a < m else (of_covered if a > m else 0.5 * (of_shared + of_covered))
    return (1.0 - shared / covered) / scales


@njit(**LOOP)
def _sum(level, count, values):
    total = 0.0
    for p in range(level, level + count):
        total += np.float64(values[p, 0])
    return total


@njit(**LOOP)
def _to_mean(plate, of_difference, of_mean):
    """Chain rule through eq. (1)."""
    for p in range(of_mean.shape[0]):
        a, b, c = of_difference[p, 0], of_difference[p, 1], of_difference[p, 2]
        of_mean[p, 0], of_mean[p, 1], of_mean[p, 2] = a, b, c
        of_mean[p, 3] = -(a * plate[p, 0] + b * plate[p, 1] + c * plate[p, 2])


@njit(**LOOP)
def _fill(source, channel, values):
    for p in range(source.shape[0]):
        values[p, 0] = source[p, channel]


@entry
def levels(height, width, scales):
    """(first pixel, height, width) of every level, and at last the number of all pixels."""
    table = np.zeros((scales + 1, 3), np.int64)
    for k in range(scales):
        table[k, 1], table[k, 2] = height, width
        table[k + 1, 0] = table[k, 0] + height * width
        height, width = (height + 1) // 2, (width + 1) // 2
    return table


@entry
def compare_images(mean, plate, frame, matte, table, of_mean):
    """The mean over the scales of L_I between the re-blurred picture of `mean` (H W, 4) over `plate` and `frame`,
    both (H W, 3); its gradient fills `of_mean`. matte: (H W, 1), whose area each level divides by."""
    scales = table.shape[0] - 1
    difference, gradient = np.empty((table[-1, 0], 3), mean.dtype), np.empty((table[-1, 0], 3), mean.dtype)
    mattes = np.empty((table[-1, 0], 1), mean.dtype)
    _differ(mean, plate, frame, difference)
    _fill(matte, 0, mattes)
    value = 0.0
    for k in range(scales):
        level, height, width = table[k, 0], table[k, 1], table[k, 2]
        area = max(_sum(level, height * width, mattes), 1.0)
        value += _squares(level, height * width, area, scales, difference, gradient)
        if k + 1 < scales:
            _shrink(level, height, width, 3, difference)
            _shrink(level, height, width, 1, mattes)
    for k in range(scales - 2, -1, -1):
        _enlarge(table[k, 0], table[k, 1], table[k, 2], 3, gradient)
    _to_mean(plate, gradient, of_mean)
    return value


@entry
def compare_mattes(mean, channel, matte, table, of_alpha):
    """The mean over the scales of L_alpha between a channel of `mean` (H W, C) and `matte` (H W, 1); its gradient fills
    `of_alpha` (H W)."""
    scales = table.shape[0] - 1
    alpha, mattes = np.empty((table[-1, 0], 1), mean.dtype), np.empty((table[-1, 0], 1), mean.dtype)
    gradient = np.empty((table[-1, 0], 1), mean.dtype)
    _fill(mean, channel, alpha)
    _fill(matte, 0, mattes)
    value = 0.0
    for k in range(scales):
        level, height, width = table[k, 0], table[k, 1], table[k, 2]
        value += _overlap(level, height * width, scales, alpha, mattes, gradient)
        if k + 1 < scales:
            _shrink(level, height, width, 1, alpha)
            _shrink(level, height, width, 1, mattes)
    for k in range(scales - 2, -1, -1):
        _enlarge(table[k, 0], table[k, 1], table[k, 2], 1, gradient)
    for p in range(of_alpha.shape[0]):
        of_alpha[p] = gradient[p, 0]
    return value


@entry
def weigh(of_image, of_matte, by_image, by_matte, channel, gradient):
    """Fill `gradient` (H W, C) with the two gradients times what is asked of their losses; empty ones are zero."""
    for p in range(gradient.shape[0]):
        for q in range(gradient.shape[1]):
            gradient[p, q] = of_image[p, q] * by_image if of_image.shape[0] > 0 else 0.0
        if of_matte.shape[0] > 0:
            gradient[p, channel] += of_matte[p] * by_matte
