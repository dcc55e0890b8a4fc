"""Compiled image and matting losses at several scales, and their gradient.

Both losses are functions of *differences*, four numbers a pixel: the three colours of eq. (1) minus the frame's, and
the silhouette minus the matte. A coarse pixel is the mean of the one, two or four that it covers, and so is its
difference: one pyramid serves both losses. It is one list of pixels, level after level, row after row, each level half
the last (rounding up); the finest level has an array of its own.

Where nothing is drawn the differences are constant. So only a window is computed, which contains all that is drawn and
whole pixels of the coarsest level. The losses' sums over the rest come from `seen`: sums of (squared differences,
mattes) of an image without the person, over everything above and left of a corner of pixels.

A `table` of the levels has rows (first pixel in the list, height, width, first corner in `seen`), the finest level
first, and a last row with the numbers of pixels in the list and of corners.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, LOOP, entry, loop_entry
from hfb.kernels.simd import (
    four,
    last_of,
    load_four,
    multiply_add,
    positive_part,
    store_lanes,
    sum_three,
    widen_four,
    with_last,
)

EMPTY_PX = 1e-6  # as in `hfb.objective.matting`


@njit(**INLINE)
def _window_of(window, k):
    """Return a window's left, top, right and bottom at level k."""
    rest = (1 << k) - 1
    return window[0] >> k, window[1] >> k, (window[2] + rest) >> k, (window[3] + rest) >> k


@njit(**INLINE)
def _share(size, at):
    """Return one row's or column's share of a coarse pixel's mean."""
    return 1.0 if at == size - 1 and size % 2 == 1 else 0.5


@njit(**INLINE)
def _shrink_row(finer, level, height, width, r, left, right, values, first):
    """Write a coarse row's pixels from `left` to before `right` to `values` from pixel `first` on.

    They are means of the finer pixels of the level that begins at pixel `level`. At an odd border one pixel is taken
    twice, which keeps the mean.
    """
    quarter = values.dtype.type(0.25)
    above, below = level + 2 * r * width, level + min(2 * r + 1, height - 1) * width
    for c in range(left, right):
        here, beside = 2 * c, min(2 * c + 1, width - 1)
        upper = load_four(finer, 4 * (above + here)) + load_four(finer, 4 * (above + beside))
        lower = load_four(finer, 4 * (below + here)) + load_four(finer, 4 * (below + beside))
        store_lanes(values, 4 * (first + c - left), quarter * (upper + lower))


@njit(**INLINE)
def _subtract_row(mean, plate, frame, first, count, difference):
    """Write eq. (1) minus the frame for `count` pixels."""
    for p in range(first, first + count):
        uncovered = 1 - mean[p, 3]
        value = load_four(mean, 4 * p) + uncovered * load_four(plate, 4 * p) - load_four(frame, 4 * p)
        store_lanes(difference, 4 * p, value)


@njit(**INLINE)
def _sum_row(values, first, count):
    """Return the sums, over `count` pixels, of the colours' squared differences, of the last, and of its positive part.

    Sums of four pixels are formed in the precision of the values first.
    """
    squares, total, positive = four(0.0), four(0.0), four(0.0)
    end = first + count
    for p in range(first, end - 3, 4):
        a, b = load_four(values, 4 * p), load_four(values, 4 * p + 4)
        c, d = load_four(values, 4 * p + 8), load_four(values, 4 * p + 12)
        squares = squares + widen_four((a * a + b * b) + (c * c + d * d))
        total = total + widen_four((a + b) + (c + d))
        positive = positive + widen_four((positive_part(a) + positive_part(b)) + (positive_part(c) + positive_part(d)))
    for p in range(end - count % 4, end):
        a = load_four(values, 4 * p)
        squares = squares + widen_four(a * a)
        total = total + widen_four(a)
        positive = positive + widen_four(positive_part(a))
    return sum_three(squares), last_of(total), last_of(positive)


@njit(**INLINE)
def _inside(seen, first, width, left, top, right, bottom, which):
    """Return a sum of `seen` over the pixels of a window."""
    above, below = first + top * (width + 1), first + bottom * (width + 1)
    upper = seen[above + right, which] - seen[above + left, which]
    return seen[below + right, which] - seen[below + left, which] - upper


@entry
def levels(height, width, scales):
    """Return the table of the levels.

    Args:
        height: height of the image [px].
        width: width of the image [px].
        scales: number of levels.
    """
    table = np.zeros((scales + 1, 4), np.int64)
    for k in range(scales):
        table[k, 1], table[k, 2] = height, width
        table[k + 1, 0] = table[k, 0] + (height * width if k > 0 else 0)
        table[k + 1, 3] = table[k, 3] + (height + 1) * (width + 1)
        height, width = (height + 1) // 2, (width + 1) // 2
    return table


@entry
def sum_up(plate, frame, table):
    """Return `seen` (corners, 2) of an image without the person; see the module.

    Args:
        plate: (H W, 4), the background's colours and 0.
        frame: (H W, 4), the frame's colours and the matte.
        table: table of the levels, see the module.
    """
    difference, coarse = np.empty(plate.shape, plate.dtype), np.empty((table[-1, 0], 4), plate.dtype)
    seen = np.zeros((table[-1, 3], 2), np.float64)
    difference[:] = plate - frame
    for k in range(table.shape[0] - 1):
        level, height, width, corner = table[k]
        values = difference if k == 0 else coarse
        for r in range(height):
            at = level + r * width
            if k > 0:
                finer = difference if k == 1 else coarse
                _shrink_row(finer, table[k - 1, 0], table[k - 1, 1], table[k - 1, 2], r, 0, width, coarse, at)
            above, here = corner + r * (width + 1), corner + (r + 1) * (width + 1)
            squares, mattes = 0.0, 0.0
            for c in range(width):
                squares += np.float64(sum_three(load_four(values, 4 * (at + c)) * load_four(values, 4 * (at + c))))
                mattes -= np.float64(values[at + c, 3])
                seen[here + c + 1, 0] = seen[above + c + 1, 0] + squares
                seen[here + c + 1, 1] = seen[above + c + 1, 1] + mattes
    return seen


@entry
def compare(mean, plate, frame, window, table, seen, image_scales, matte_scales, difference, coarse, slopes):
    """Return (L_I, L_alpha), eq. (3) and (4), of a mean render: each the mean over its number of scales.

    Args:
        mean: (H W, 4), the render's colours and silhouette.
        plate: (H W, 4), the background's colours and 0.
        frame: (H W, 4), the frame's colours and the matte.
        window: left, top, right, bottom [px] of all that is drawn.
        table: table of the levels, see the module.
        seen: (corners, 2), by `sum_up`.
        image_scales: number of scales of L_I.
        matte_scales: number of scales of L_alpha.
        difference: (H W, 4), filled in the window; may be `mean` itself.
        coarse: (pixels of the list, 4), filled in the window.
        slopes: (levels, 3), filled: derivative of L_I by a level's differences as a factor of these, and of L_alpha by
            the last difference where it is negative and where it is positive.
    """
    image, overlap = 0.0, 0.0
    for k in range(table.shape[0] - 1):
        level, height, width, corner = table[k]
        left, top, right, bottom = _window_of(window, k)
        values = difference if k == 0 else coarse
        squares, total, positive = 0.0, 0.0, 0.0
        for r in range(top, bottom):
            at = level + r * width + left
            if k == 0:
                _subtract_row(mean, plate, frame, at, right - left, difference)
            else:
                finer = difference if k == 1 else coarse
                _shrink_row(finer, table[k - 1, 0], table[k - 1, 1], table[k - 1, 2], r, left, right, coarse, at)
            of_row = _sum_row(values, at, right - left)
            squares, total, positive = squares + of_row[0], total + of_row[1], positive + of_row[2]
        last = corner + (height + 1) * (width + 1) - 1
        slopes[k] = 0.0
        if k < image_scales:
            factor = 1.0 / (3.0 * max(seen[last, 1], 1.0) * image_scales)
            squares += seen[last, 0] - _inside(seen, corner, width, left, top, right, bottom, 0)
            image += squares * factor
            slopes[k, 0] = 2.0 * factor
        if k < matte_scales:
            shared = EMPTY_PX + _inside(seen, corner, width, left, top, right, bottom, 1) + (total - positive)
            covered = EMPTY_PX + seen[last, 1] + positive
            overlap += (1.0 - shared / covered) / matte_scales
            slopes[k, 1], slopes[k, 2] = -1.0 / (covered * matte_scales), shared / (covered * covered * matte_scales)
    return image, overlap


@njit(**LOOP)
def _level_backward(values, level, height, width, window, slopes, coarser, after, gradient):
    """Fill a level's part of `gradient` in its window (left, top, right, bottom).

    It is the gradient of the level's own losses (`slopes`: of the colours, of the last difference where negative and
    where positive) plus its share of the next level's, which is in `coarser` from pixel `after` on; a negative `after`
    means that there is none.
    """
    kind, columns, (left, top, right, bottom) = gradient.dtype.type, (width + 1) // 2, window
    of_colours, equal = kind(slopes[0]), kind(0.5 * (slopes[1] + slopes[2]))
    less, more = kind(slopes[1]) - equal, kind(slopes[2]) - equal
    for r in range(top, bottom):
        of_row = kind(_share(height, r))
        for c in range(left, right):
            p = level + r * width + c
            last = values[p, 3]
            of_alpha = equal + less * kind(last < 0) + more * kind(last > 0)  # no branch: nothing predicts it
            slope = with_last(of_colours * load_four(values, 4 * p), of_alpha)
            if after >= 0:
                there = load_four(coarser, 4 * (after + (r // 2) * columns + c // 2))
                slope = multiply_add(there, of_row * kind(_share(width, c)), slope)
            store_lanes(gradient, 4 * p, slope)


@loop_entry
def gradient_of(difference, coarse, plate, window, table, slopes, by_image, by_matte, of_coarse, gradient):
    """Fill the gradient of by_image L_I + by_matte L_alpha by the mean render, in the window.

    Args:
        difference: (H W, 4), differences of the finest level.
        coarse: (pixels of the list, 4), differences of the other levels.
        plate: (H W, 4), the background's colours and 0.
        window: left, top, right, bottom [px] of all that is drawn.
        table: table of the levels, see the module.
        slopes: (levels, 3), see `compare`.
        by_image: factor of L_I.
        by_matte: factor of L_alpha.
        of_coarse: work space for the coarse levels' gradients, as large as `coarse`.
        gradient: (H W, 4), filled in the window.
    """
    after = np.int64(-1)
    for k in range(table.shape[0] - 2, -1, -1):
        level, height, width = table[k, 0], table[k, 1], table[k, 2]
        slopes_here = by_image * slopes[k, 0], by_matte * slopes[k, 1], by_matte * slopes[k, 2]
        values, into = (difference, gradient) if k == 0 else (coarse, of_coarse)
        _level_backward(values, level, height, width, _window_of(window, k), slopes_here, of_coarse, after, into)
        after = level
    width = table[0, 2]
    for r in range(window[1], window[3]):
        for p in range(r * width + window[0], r * width + window[2]):
            slope = load_four(gradient, 4 * p)
            asks = gradient[p, 3] - sum_three(slope * load_four(plate, 4 * p))
            gradient[p, 3] = asks
