"""Compiled parts: the image and the matting loss at several scales, with their gradients in the same pass.

A pyramid is one list of pixels, level after level, row after row; each level halves the last (rounding up), and a
coarse pixel is the mean of the one, two or four that it covers. The finest level, which has most of the pixels, is kept
nowhere: what is needed of it is found again from the pictures, one pass forth and one back.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE, LOOP, entry, loop_entry

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


@njit(**INLINE)
def _difference(mean, plate, frame, p):
    """Eq. (1) minus the picture seen, at one pixel."""
    through = 1 - mean[p, 3]
    return (
        through * plate[p, 0] + mean[p, 0] - frame[p, 0],
        through * plate[p, 1] + mean[p, 1] - frame[p, 1],
        through * plate[p, 2] + mean[p, 2] - frame[p, 2],
    )


@njit(**LOOP)
def _image_sums(mean, plate, frame, matte):
    """Over the finest level: (squared differences, area of the matte)."""
    squares = area = 0.0
    for p in range(mean.shape[0]):
        a, b, c = _difference(mean, plate, frame, p)
        squares += np.float64(a * a + b * b + c * c)
        area += np.float64(matte[p, 0])
    return squares, area


@njit(**LOOP)
def _matte_sums(mean, matte):
    """Over the finest level: (share that mean's last channel and the matte have in common, share of either)."""
    shared, covered, channel = EMPTY_PX, EMPTY_PX, mean.shape[1] - 1
    for p in range(mean.shape[0]):
        alpha, m = mean[p, channel], matte[p, 0]
        shared += np.float64(min(alpha, m))
        covered += np.float64(max(alpha, m))
    return shared, covered


@njit(**LOOP)
def _shrink_images(height, width, mean, plate, frame, differences):
    """Fill the first coarse level with the differences of the finest."""
    quarter = differences.dtype.type(0.25)
    for r in range((height + 1) // 2):
        above, below = 2 * r * width, min(2 * r + 1, height - 1) * width
        for c in range((width + 1) // 2):
            left, right = 2 * c, min(2 * c + 1, width - 1)
            a0, a1, a2 = _difference(mean, plate, frame, above + left)
            b0, b1, b2 = _difference(mean, plate, frame, above + right)
            c0, c1, c2 = _difference(mean, plate, frame, below + left)
            d0, d1, d2 = _difference(mean, plate, frame, below + right)
            at = r * ((width + 1) // 2) + c
            differences[at, 0] = quarter * ((a0 + b0) + (c0 + d0))
            differences[at, 1] = quarter * ((a1 + b1) + (c1 + d1))
            differences[at, 2] = quarter * ((a2 + b2) + (c2 + d2))


@njit(**LOOP)
def _shrink_channel(height, width, values, channel, coarse):
    """Fill the first coarse level with a channel of the finest."""
    quarter = coarse.dtype.type(0.25)
    for r in range((height + 1) // 2):
        above, below = 2 * r * width, min(2 * r + 1, height - 1) * width
        for c in range((width + 1) // 2):
            left, right = 2 * c, min(2 * c + 1, width - 1)
            coarse[r * ((width + 1) // 2) + c, 0] = quarter * (
                (values[above + left, channel] + values[above + right, channel])
                + (values[below + left, channel] + values[below + right, channel])
            )


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


@entry
def levels(height, width, scales):
    """(first pixel, height, width) of every coarse level, and at last the number of all their pixels."""
    table = np.zeros((max(scales, 1), 3), np.int64)
    for k in range(scales - 1):
        height, width = (height + 1) // 2, (width + 1) // 2
        table[k, 1], table[k, 2] = height, width
        table[k + 1, 0] = table[k, 0] + height * width
    return table


@entry
def compare_images(mean, plate, frame, matte, height, width, table, gradient):
    """The mean over the scales of L_I between the re-blurred picture of `mean` (H W, 4) over `plate` and `frame`,
    both (H W, 3). matte: (H W, 1), whose area each level divides by.

    Returns it and its slope by the finest level's differences, as a factor of these. The gradient of the coarse levels,
    handed on to the first of them, fills `gradient` (coarse pixels, 3).
    """
    scales = table.shape[0]
    squares, area = _image_sums(mean, plate, frame, matte)
    area = max(area, 1.0)
    value = squares / (3.0 * area * scales)
    if scales > 1:
        differences, mattes = np.empty((table[-1, 0], 3), mean.dtype), np.empty((table[-1, 0], 1), mean.dtype)
        _shrink_images(height, width, mean, plate, frame, differences)
        _shrink_channel(height, width, matte, 0, mattes)
        for k in range(scales - 1):
            level, rows, columns = table[k, 0], table[k, 1], table[k, 2]
            of_level = max(_sum(level, rows * columns, mattes), 1.0)
            value += _squares(level, rows * columns, of_level, scales, differences, gradient)
            if k + 2 < scales:
                _shrink(level, rows, columns, 3, differences)
                _shrink(level, rows, columns, 1, mattes)
        for k in range(scales - 3, -1, -1):
            _enlarge(table[k, 0], table[k, 1], table[k, 2], 3, gradient)
    return value, 2.0 / (3.0 * area * scales)


@entry
def compare_mattes(mean, matte, height, width, table, gradient):
    """The mean over the scales of L_alpha between the last channel of `mean` (H W, C) and `matte` (H W, 1).

    Returns it and its two slopes at the finest level: where alpha is the smaller, and where it is the larger. The
    gradient of the coarse levels, handed on to the first of them, fills `gradient` (coarse pixels, 1).
    """
    scales = table.shape[0]
    shared, covered = _matte_sums(mean, matte)
    value = (1.0 - shared / covered) / scales
    if scales > 1:
        alpha, mattes = np.empty((table[-1, 0], 1), mean.dtype), np.empty((table[-1, 0], 1), mean.dtype)
        _shrink_channel(height, width, mean, mean.shape[1] - 1, alpha)
        _shrink_channel(height, width, matte, 0, mattes)
        for k in range(scales - 1):
            level, rows, columns = table[k, 0], table[k, 1], table[k, 2]
            value += _overlap(level, rows * columns, scales, alpha, mattes, gradient)
            if k + 2 < scales:
                _shrink(level, rows, columns, 1, alpha)
                _shrink(level, rows, columns, 1, mattes)
        for k in range(scales - 3, -1, -1):
            _enlarge(table[k, 0], table[k, 1], table[k, 2], 1, gradient)
    return value, -1.0 / (covered * scales), shared / (covered * covered * scales)


@njit(**LOOP)
def _share(size, at):
    """Of a coarse pixel's mean that one row or column of it has."""
    return 1.0 if at == size - 1 and size % 2 == 1 else 0.5


@loop_entry
def gradient_of(mean, plate, frame, matte, height, width, slopes, by_image, by_matte, of_image, of_matte, gradient):
    """Fill `gradient` (H W, C) with that of by_image L_I + by_matte L_alpha.

    slopes: of L_I by the finest differences, and of L_alpha where alpha is the smaller and where it is the larger.
    of_image, of_matte: what the coarse levels ask of the first of them; empty where there are none. An empty `plate`
    leaves L_I out.
    """
    kind, channel, columns = mean.dtype.type, mean.shape[1] - 1, (width + 1) // 2
    fine, by_image = kind(slopes[0] * by_image), kind(by_image)
    equal = kind(0.5 * (slopes[1] + slopes[2]) * by_matte)
    smaller, larger, by_matte = kind(slopes[1] * by_matte) - equal, kind(slopes[2] * by_matte) - equal, kind(by_matte)
    for r in range(height):
        of_row = kind(_share(height, r))
        for column in range(width):
            p, at = r * width + column, (r // 2) * columns + column // 2
            share = of_row * kind(_share(width, column))
            alpha, m = mean[p, channel], matte[p, 0]
            asked = equal + smaller * kind(alpha < m) + larger * kind(alpha > m)  # no branch: nothing predicts it
            if of_matte.shape[0] > 0:
                asked += by_matte * share * of_matte[at, 0]
            if plate.shape[0] > 0:
                a, b, c = _difference(mean, plate, frame, p)
                a, b, c = fine * a, fine * b, fine * c
                if of_image.shape[0] > 0:
                    coarse = by_image * share
                    a += coarse * of_image[at, 0]
                    b += coarse * of_image[at, 1]
                    c += coarse * of_image[at, 2]
                gradient[p, 0], gradient[p, 1], gradient[p, 2] = a, b, c
                asked -= a * plate[p, 0] + b * plate[p, 1] + c * plate[p, 2]
            gradient[p, channel] = asked
