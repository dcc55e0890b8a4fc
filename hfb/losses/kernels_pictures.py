"""Compiled parts: the image and the matting loss at several scales, with their gradients in the same pass.

A pyramid is one list of pixels, level after level, row after row; each level halves the last (rounding up), and a
coarse pixel is the mean of the one, two or four that it covers. The finest level, which has most of the pixels, is kept
nowhere: what is needed of it is found again from the pictures, one pass forth and one back.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE, LOOP, SUM_INLINE, entry, loop_entry
from hfb.vector_code import load_four, load_three, store_lanes, sum_three, with_last

EMPTY_PX = 1e-6  # as in `hfb.losses.matting`


@njit(**INLINE)
def _four_of(r, c, height, width):
    """Places in a level of the pixels that a coarse one covers: at an odd border the same twice, the mean stays it."""
    above, below = 2 * r * width, min(2 * r + 1, height - 1) * width
    left, right = 2 * c, min(2 * c + 1, width - 1)
    return above + left, above + right, below + left, below + right


@njit(**INLINE)
def _share(size, at):
    """Of a coarse pixel's mean that one row or column of it has."""
    return 1.0 if at == size - 1 and size % 2 == 1 else 0.5


@njit(**LOOP)
def _shrink(level, height, width, values):
    """Fill the level after the one that begins at pixel `level`: (pixels, 1)."""
    rows, columns, after = (height + 1) // 2, (width + 1) // 2, level + height * width
    for r in range(rows):
        for c in range(columns):
            i, j, k, m = _four_of(r, c, height, width)
            upper, lower = values[level + i, 0] + values[level + j, 0], values[level + k, 0] + values[level + m, 0]
            values[after + r * columns + c, 0] = 0.25 * (upper + lower)


@njit(**LOOP)
def _shrink_colours(level, height, width, values):
    """As `_shrink`, of (pixels, 4)."""
    rows, columns, after = (height + 1) // 2, (width + 1) // 2, level + height * width
    quarter = values.dtype.type(0.25)
    for r in range(rows):
        for c in range(columns):
            i, j, k, m = _four_of(r, c, height, width)
            upper = load_four(values, 4 * (level + i)) + load_four(values, 4 * (level + j))
            lower = load_four(values, 4 * (level + k)) + load_four(values, 4 * (level + m))
            store_lanes(values, 4 * (after + r * columns + c), quarter * (upper + lower))


@njit(**LOOP)
def _enlarge(level, height, width, gradient):
    """Way back of `_shrink`: add to a level's gradient that of the level after it."""
    columns, after = (width + 1) // 2, level + height * width
    for r in range(height):
        of_row = _share(height, r)
        for c in range(width):
            share = of_row * _share(width, c)
            gradient[level + r * width + c, 0] += share * gradient[after + (r // 2) * columns + c // 2, 0]


@njit(**LOOP)
def _enlarge_colours(level, height, width, gradient):
    """Way back of `_shrink_colours`."""
    columns, after, kind = (width + 1) // 2, level + height * width, gradient.dtype.type
    for r in range(height):
        of_row = kind(_share(height, r))
        for c in range(width):
            share, at = of_row * kind(_share(width, c)), 4 * (level + r * width + c)
            coarse = load_four(gradient, 4 * (after + (r // 2) * columns + c // 2))
            store_lanes(gradient, at, load_four(gradient, at) + share * coarse)


@njit(**INLINE)
def _difference(mean, plate, frame, p):
    """Eq. (1) minus the picture seen, at one pixel: three colours, and a lane that means nothing."""
    return load_four(mean, 4 * p) + (1 - mean[p, 3]) * load_three(plate, 3 * p) - load_three(frame, 3 * p)


@njit(**LOOP)
def _image_sum(mean, plate, frame):
    """Squared differences over the finest level; four pixels' together before they are widened."""
    total, count = 0.0, mean.shape[0]
    for p in range(0, count - 3, 4):
        a, b = _difference(mean, plate, frame, p), _difference(mean, plate, frame, p + 1)
        c, d = _difference(mean, plate, frame, p + 2), _difference(mean, plate, frame, p + 3)
        total += np.float64(sum_three((a * a + b * b) + (c * c + d * d)))
    for p in range(count - count % 4, count):
        a = _difference(mean, plate, frame, p)
        total += np.float64(sum_three(a * a))
    return total


@njit(**SUM_INLINE)
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
    quarter, columns = differences.dtype.type(0.25), (width + 1) // 2
    for r in range((height + 1) // 2):
        for c in range(columns):
            i, j, k, m = _four_of(r, c, height, width)
            upper = _difference(mean, plate, frame, i) + _difference(mean, plate, frame, j)
            lower = _difference(mean, plate, frame, k) + _difference(mean, plate, frame, m)
            store_lanes(differences, 4 * (r * columns + c), quarter * (upper + lower))


@njit(**LOOP)
def _shrink_channel(height, width, values, channel, coarse):
    """Fill the first coarse level with a channel of the finest."""
    quarter, columns = coarse.dtype.type(0.25), (width + 1) // 2
    for r in range((height + 1) // 2):
        for c in range(columns):
            i, j, k, m = _four_of(r, c, height, width)
            upper, lower = values[i, channel] + values[j, channel], values[k, channel] + values[m, channel]
            coarse[r * columns + c, 0] = quarter * (upper + lower)


@njit(**LOOP)
def _squares(level, count, area, scales, difference, gradient):
    """One level's L_I, eq. (3), and its gradient, both divided by the number of scales."""
    total, slope = 0.0, difference.dtype.type(2.0 / (3.0 * area * scales))
    for p in range(level, level + count):
        here = load_four(difference, 4 * p)
        total += np.float64(sum_three(here * here))
        store_lanes(gradient, 4 * p, slope * here)
    return total / (3.0 * area * scales)


@njit(**SUM_INLINE)
def _shared_and_covered(level, count, alpha, matte):
    """Share that two silhouettes have in common, and share of either."""
    shared, covered = EMPTY_PX, EMPTY_PX
    for p in range(level, level + count):
        shared += np.float64(min(alpha[p, 0], matte[p, 0]))
        covered += np.float64(max(alpha[p, 0], matte[p, 0]))
    return shared, covered


@njit(**INLINE)
def _overlap(level, count, scales, alpha, matte, gradient):
    """One level's L_alpha, eq. (4), and its gradient, both divided by the number of scales."""
    shared, covered = _shared_and_covered(level, count, alpha, matte)
    kind = alpha.dtype.type
    of_shared, of_covered = -1.0 / (covered * scales), shared / (covered * covered * scales)
    equal = kind(0.5 * (of_shared + of_covered))
    smaller, larger = kind(of_shared) - equal, kind(of_covered) - equal
    for p in range(level, level + count):
        a, m = alpha[p, 0], matte[p, 0]
        gradient[p, 0] = equal + smaller * kind(a < m) + larger * kind(a > m)  # no branch: nothing predicts it
    return (1.0 - shared / covered) / scales


@njit(**SUM_INLINE)
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
    handed on to the first of them, fills `gradient` (coarse pixels, 4; the last means nothing).
    """
    scales = table.shape[0]
    squares, area = _image_sum(mean, plate, frame), max(_sum(0, matte.shape[0], matte), 1.0)
    value = squares / (3.0 * area * scales)
    if scales > 1:
        differences, mattes = np.empty((table[-1, 0], 4), mean.dtype), np.empty((table[-1, 0], 1), mean.dtype)
        _shrink_images(height, width, mean, plate, frame, differences)
        _shrink_channel(height, width, matte, 0, mattes)
        for k in range(scales - 1):
            level, rows, columns = table[k, 0], table[k, 1], table[k, 2]
            of_level = max(_sum(level, rows * columns, mattes), 1.0)
            value += _squares(level, rows * columns, of_level, scales, differences, gradient)
            if k + 2 < scales:
                _shrink_colours(level, rows, columns, differences)
                _shrink(level, rows, columns, mattes)
        for k in range(scales - 3, -1, -1):
            _enlarge_colours(table[k, 0], table[k, 1], table[k, 2], gradient)
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
                _shrink(level, rows, columns, alpha)
                _shrink(level, rows, columns, mattes)
        for k in range(scales - 3, -1, -1):
            _enlarge(table[k, 0], table[k, 1], table[k, 2], gradient)
    return value, -1.0 / (covered * scales), shared / (covered * covered * scales)


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
                slope = fine * _difference(mean, plate, frame, p)
                if of_image.shape[0] > 0:
                    slope = slope + by_image * share * load_four(of_image, 4 * at)
                asked -= sum_three(slope * load_three(plate, 3 * p))
                store_lanes(gradient, 4 * p, with_last(slope, asked))
            else:
                gradient[p, channel] = asked
