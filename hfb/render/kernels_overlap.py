"""Compiled parts: the exact covered share of the few pixels in which layers of the body may overlap.

An arm's outline before the torso's: the mean winding counts their common area twice. There the pixel is cut
into slabs at every height where a piece of outline begins, ends or crosses another; within a slab the order of
the pieces from left to right does not change, so the length covered at its middle times its height is its
area. Walking from left to right also tells which pieces separate body from background: only these are seen to
move, and their weights are kept for the way back.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE, LOOP

ON_BORDER = 1e-9
THIN = 1e-12  # heights closer than this are one


@njit(**LOOP)
def chain_pieces(piece_pixel, place, newest, older):
    """Chain the outline's pieces of each unsure pixel (newest[pixel], then older[piece]; -1 ends it)."""
    for piece in range(piece_pixel.shape[0]):
        if piece_pixel[piece] >= 0 and place[piece_pixel[piece]] < 0:
            slot = -1 - place[piece_pixel[piece]]
            older[piece] = newest[slot]
            newest[slot] = piece


@njit(**LOOP)
def _load(piece, older, column, row, outline, projected, edge, span, member, part, heights):
    """Read one pixel's pieces; returns their number, that of the heights, and the pixel's mean winding if 0 at its
    top left corner.

    part: x and y of start and end, relative to the pixel, and dx/dy. heights: where pieces begin, and where they
    leave sideways: with the pixel's top and bottom, all heights at which something begins or ends.
    """
    m, n, mean = 0, 2, 0.0
    heights[0], heights[1] = 0.0, 1.0
    while piece >= 0:
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
        member[m] = piece
        part[m, 0], part[m, 1], part[m, 2], part[m, 3] = xa, ya, xb, yb
        part[m, 4] = (xb - xa) / (yb - ya) if yb != ya else 0.0
        heights[n] = ya
        n += 1
        heights[n] = yb
        n += (xb < ON_BORDER) | (xb > 1.0 - ON_BORDER)
        m += 1
        piece = older[piece]
    return m, n, mean


@njit(**LOOP)
def _add_crossings(m, part, n, heights):
    """Append the heights at which pieces cross; returns the new number. Free of branches, as is all that follows:
    what happens in these pixels is nothing that a processor could predict."""
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
    """Sort by counting how many are smaller: for a handful of values faster than anything that branches."""
    for p in range(n):
        rank = 0
        for q in range(n):
            rank += (values[q] < values[p]) | ((values[q] == values[p]) & (q < p))
        result[rank] = values[p]


@njit(**INLINE)
def _add_weights(part, p, low, high, span, piece, weights):
    """Give the stretch of a piece between two heights to the ends of its edge: integrals of 1 - t and t."""
    ya = part[p, 1]
    slope = (span[piece, 1] - span[piece, 0]) / (part[p, 3] - ya)
    t1, t2 = span[piece, 0] + (low - ya) * slope, span[piece, 0] + (high - ya) * slope
    t1, t2 = min(t1, t2), max(t1, t2)
    second = 0.5 * (t2 * t2 - t1 * t1)
    weights[piece, 0] += t2 - t1 - second
    weights[piece, 1] += second


@njit(**INLINE)
def _cover_slab(base, m, at_left, member, part, low, high, active, where, step, span, weights):
    """Covered area of a pixel between two heights; adds the weights of the pieces between body and background.

    at_left: whether any piece touches the pixel's left border.
    """
    middle = 0.5 * (low + high)
    winding, n = base, 0
    if at_left:
        for p in range(m):
            # Down the left border the winding falls by 1 where a piece comes in and rises by 1 where one goes out.
            out, into = part[p, 2] < ON_BORDER, part[p, 0] < ON_BORDER
            winding += int(out & (part[p, 3] < middle)) - int(into & (part[p, 1] < middle))
    for p in range(m):
        ya, yb = part[p, 1], part[p, 3]
        down, up = (ya < middle) & (middle < yb), (yb < middle) & (middle < ya)
        active[n], where[n] = p, part[p, 0] + (middle - ya) * part[p, 4]
        step[n] = int(down) - int(up)  # more body right of a piece that runs down, less of one that runs up
        n += down | up
    length = 1.0 if winding >= 1 else 0.0
    for p in range(n):
        to_left = winding
        for q in range(n):
            to_left += step[q] * int((where[q] < where[p]) | ((where[q] == where[p]) & (q < p)))
        if to_left == int(step[p] < 0):
            length += step[p] * (1.0 - where[p])
            _add_weights(part, active[p], low, high, span, member[active[p]], weights)
    return length * (high - low)


@njit(**LOOP)
def resolve(
    unsure, pixels, windings, width, outline, projected, newest, older, edge, span, weights,
    member, part, heights, sorted_heights, active, where, step,
):  # fmt: skip
    """Replace the mean winding of the unsure pixels by their covered share; fill the weights of their pieces."""
    for slot in range(unsure.shape[0]):
        pixel = pixels[unsure[slot]]
        row = pixel // width
        m, n, mean = _load(
            newest[slot], older, pixel - row * width, row, outline, projected, edge, span, member, part, heights
        )
        base = int(np.round(windings[unsure[slot]] - mean))
        n = _add_crossings(m, part, n, heights)
        _sort(n, heights, sorted_heights)
        at_left = False
        for p in range(m):
            at_left |= (part[p, 0] < ON_BORDER) | (part[p, 2] < ON_BORDER)
        covered = 0.0
        for s in range(1, n):
            low, high = sorted_heights[s - 1], sorted_heights[s]
            if high - low > THIN:
                covered += _cover_slab(base, m, at_left, member, part, low, high, active, where, step, span, weights)
        windings[unsure[slot]] = covered
