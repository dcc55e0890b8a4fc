"""Compiled coverage of the few pixels in which layers of the body may overlap.

Where an arm's outline is in front of the torso's, the mean winding counts their common area twice. There the pixel is
cut into slabs at every height where a piece of outline begins, ends or crosses another; within a slab the order of the
pieces from left to right does not change, so the length covered at its middle times its height is its area. The order
from left to right also determines which pieces separate body from background: only these have gradients, and their
weights are kept for the backward pass.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import LOOP
from hfb.kernels.simd import (
    LANES,
    if_equal,
    if_less,
    insert_sorted,
    lanes,
    last_lane,
    load_lanes,
    store_lanes,
    sum_lanes,
)

ON_BORDER = 1e-9


@njit(**LOOP)
def chain_pieces(piece_pixel, place, newest, older, counts):
    """Chain the outline's pieces of each unsure pixel (from newest[pixel] to older[piece]), and count them.

    Args:
        piece_pixel: region pixel of each piece.
        place: place of the region's pixels, see `render_outline.collect`.
        newest: newest piece of each unsure pixel, updated.
        older: next older piece in each piece's pixel, filled.
        counts: pieces in each unsure pixel, updated.
    """
    for piece in range(piece_pixel.shape[0]):
        if piece_pixel[piece] >= 0 and place[piece_pixel[piece]] < 0:
            slot = -1 - place[piece_pixel[piece]]
            older[piece] = newest[slot]
            newest[slot] = piece
            counts[slot] += 1


@njit(**LOOP)
def _load(m, piece, older, column, row, outline, projected, edge, span, member, part, heights):
    """Read one pixel's m pieces.

    `part` gets x and y of start and end, relative to the pixel, and the slopes of x and of the edge's parameter by y;
    `heights` gets where pieces begin, and where they leave sideways: with the pixel's top and bottom, all heights at
    which something begins or ends.

    Returns:
        the number of the heights, and the pixel's mean winding if 0 at its top left corner.
    """
    n, mean = 2, 0.0
    heights[0], heights[1] = 0.0, 1.0
    for p in range(m):
        i, j = outline[edge[piece], 0], outline[edge[piece], 1]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        x0, y0 = x0 - column, y0 - row
        xa = min(max(x0 + span[piece, 0] * dx, 0.0), 1.0)
        ya = min(max(y0 + span[piece, 0] * dy, 0.0), 1.0)
        xb = min(max(x0 + span[piece, 1] * dx, 0.0), 1.0)
        yb = min(max(y0 + span[piece, 1] * dy, 0.0), 1.0)
        mean += (yb - ya) * (1.0 - 0.5 * (xa + xb))
        mean -= (1.0 - ya) if xa < ON_BORDER else 0.0
        mean += (1.0 - yb) if xb < ON_BORDER else 0.0
        member[p] = piece
        part[p, 0], part[p, 1], part[p, 2], part[p, 3] = xa, ya, xb, yb
        inverse = 1.0 / (yb - ya) if yb != ya else 0.0
        part[p, 4], part[p, 5] = (xb - xa) * inverse, (span[piece, 1] - span[piece, 0]) * inverse
        heights[n] = ya
        n += 1
        heights[n] = yb
        n += (xb < ON_BORDER) | (xb > 1.0 - ON_BORDER)
        piece = older[piece]
    return n, mean


@njit(**LOOP)
def _add_crossings(m, part, n, heights):
    """Append the heights at which pieces cross; return the new number.

    Free of branches, as is all that follows: no processor can predict what happens in these pixels.
    """
    for p in range(1, m):
        low_p, high_p = min(part[p, 1], part[p, 3]), max(part[p, 1], part[p, 3])
        for q in range(p):
            low = max(low_p, min(part[q, 1], part[q, 3]))
            high = min(high_p, max(part[q, 1], part[q, 3]))
            apart = part[p, 0] - part[q, 0] + (low - part[p, 1]) * part[p, 4] - (low - part[q, 1]) * part[q, 4]
            slope = part[p, 4] - part[q, 4]
            crossing = (low < high) & (apart * (apart + (high - low) * slope) < 0.0)
            heights[n] = low - apart / slope if crossing else 0.0
            n += crossing
    return n


@njit(**LOOP)
def _sort(n, values, result):
    """Sort numbers up to 1, eight places at a time.

    Each number is inserted at its place; the one that falls out goes into the next eight. For a handful of values this
    is faster than anything that branches. Changes `values`, and fills the last places of `result`, up to a multiple of
    eight, with ones.
    """
    for first in range(0, n, LANES):
        held = lanes(1.0)
        for k in range(first, n):
            value = values[k]
            values[k] = max(last_lane(held), value)
            held = insert_sorted(held, value)
        store_lanes(result, first, held)


@njit(**LOOP)
def _cover_slabs(base, m, at_left, member, part, n, heights, active, lines, span, weights):
    """Return the covered area of a pixel whose n sorted heights cut it into slabs, and weigh its pieces.

    Weights are added for the pieces between body and background. Eight slabs are processed at once without branches.
    `heights` has room for eight more than n, `at_left` is whether any piece touches the pixel's left border, and
    `lines` is work space for two rows of lanes per piece.
    """
    for s in range(n, n + LANES):
        heights[s] = heights[n - 1]
    area = lanes(0.0)
    for first in range(0, n - 1, LANES):
        low, high = load_lanes(heights, first), load_lanes(heights, first + 1)
        middle = 0.5 * (low + high)
        top, bottom = heights[first], heights[first + LANES]
        winding, found = lanes(base), 0
        for p in range(m):
            ya, yb = part[p, 1], part[p, 3]
            if at_left:
                # Down the left border the winding falls by 1 where a piece comes in and rises by 1 where one goes out.
                out, into = 1.0 * (part[p, 2] < ON_BORDER), 1.0 * (part[p, 0] < ON_BORDER)
                winding = winding + if_less(yb, middle, out, 0.0) - if_less(ya, middle, into, 0.0)
            above, below = min(ya, yb), max(ya, yb)
            active[found] = p
            store_lanes(lines, 2 * LANES * found, part[p, 0] + (middle - ya) * part[p, 4])
            # More body right of a piece that runs down, less of one that runs up.
            step = 1.0 if ya < yb else -1.0
            crossed = if_less(above, middle, if_less(middle, below, step, 0.0), 0.0)
            store_lanes(lines, 2 * LANES * found + LANES, crossed)
            found += (above < bottom) & (top < below)
        length = if_less(0.5, winding, 1.0, 0.0)
        for k in range(found):
            where, step = load_lanes(lines, 2 * LANES * k), load_lanes(lines, 2 * LANES * k + LANES)
            to_left = winding
            for q in range(k):
                to_left = to_left + if_less(
                    where, load_lanes(lines, 2 * LANES * q), 0.0, load_lanes(lines, 2 * LANES * q + LANES)
                )
            for q in range(k + 1, found):
                to_left = to_left + if_less(
                    load_lanes(lines, 2 * LANES * q), where, load_lanes(lines, 2 * LANES * q + LANES), 0.0
                )
            # Between body and background: nothing left of one that runs down, one layer left of one that runs up.
            between = 0.5 - 0.5 * step
            length = length + if_equal(to_left, between, step * (1.0 - where), 0.0)
            p = active[k]
            piece = member[p]
            # The stretch goes to the ends of its edge: integrals of 1 - t and t.
            start, ya, along = span[piece, 0], part[p, 1], part[p, 5]  # which may be large: ya is taken off first
            t1, t2 = start + (low - ya) * along, start + (high - ya) * along
            second = 0.5 * step * (t2 * t2 - t1 * t1)
            weights[piece, 0] += sum_lanes(if_equal(to_left, between, step * (t2 - t1) - second, 0.0))
            weights[piece, 1] += sum_lanes(if_equal(to_left, between, second, 0.0))
        area = area + length * (high - low)
    return sum_lanes(area)


@njit(**LOOP)
def resolve(
    unsure,
    newest,
    counts,
    pixels,
    windings,
    width,
    outline,
    projected,
    older,
    edge,
    span,
    weights,
    member,
    part,
    heights,
    sorted_heights,
    active,
    lines,
):
    """Replace the mean winding of the unsure pixels by their covered share; fill the weights of their pieces.

    Args:
        unsure: their places in the list of pixels.
        newest: newest piece of each unsure pixel.
        counts: pieces in each unsure pixel.
        pixels: index of each listed pixel.
        windings: mean winding of each listed pixel, updated.
        width: width of the image [px].
        outline: (n, 3), edges (from, to, front face).
        projected: (V, 4), x, y [px], 1/z [1/m].
        older: next older piece in each piece's pixel.
        edge: edge of each piece.
        span: parameters of each piece on its edge.
        weights: weights of each piece, filled.
        member: work space for one pixel's pieces.
        part: work space for one pixel's pieces.
        heights: work space.
        sorted_heights: work space.
        active: work space.
        lines: work space.
    """
    for slot in range(unsure.shape[0]):
        m, pixel = counts[slot], pixels[unsure[slot]]
        row = pixel // width
        n, mean = _load(
            m, newest[slot], older, pixel - row * width, row, outline, projected, edge, span, member, part, heights
        )
        base = np.floor(windings[unsure[slot]] - mean + 0.5)
        n = _add_crossings(m, part, n, heights)
        _sort(n, heights, sorted_heights)
        at_left = False
        for p in range(m):
            at_left |= (part[p, 0] < ON_BORDER) | (part[p, 2] < ON_BORDER)
        windings[unsure[slot]] = _cover_slabs(
            base, m, at_left, member, part, n, sorted_heights, active, lines, span, weights
        )
