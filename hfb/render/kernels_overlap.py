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

from hfb.render.kernels_compile import INLINE, LOOP

ON_BORDER = 1e-9
THIN = 1e-12  # heights closer than this are one


@njit(**LOOP)
def chain_pieces(piece_pixel, unsure, newest, older):
    """Chain the outline's pieces of each unsure pixel (newest[pixel], then older[piece]; -1 ends it)."""
    for piece in range(piece_pixel.shape[0]):
        if piece_pixel[piece] >= 0:
            slot = unsure[piece_pixel[piece]] - 1
            if slot >= 0:
                older[piece] = newest[slot]
                newest[slot] = piece


@njit(**LOOP)
def _load(piece, older, column, row, outline, projected, edge, span, member, part, event):
    """Read one pixel's pieces; returns their number, that of the events, and the pixel's mean winding if 0 at its
    top left corner.

    part: (top, bottom, x at top, dx/dy, x at bottom), relative to the pixel; member: the piece, ~piece where it
    runs upwards. event: (height, step) at which the winding changes down the left border: -1 where a piece
    comes in, 1 where one goes out.
    """
    m, n_events, mean = 0, 0, 0.0
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
        if xa < ON_BORDER:
            event[n_events, 0], event[n_events, 1] = ya, -1.0
            mean -= 1.0 - ya
            n_events += 1
        if xb < ON_BORDER:
            event[n_events, 0], event[n_events, 1] = yb, 1.0
            mean += 1.0 - yb
            n_events += 1
        if yb - ya > THIN:
            member[m] = piece
            part[m, 0], part[m, 1], part[m, 2], part[m, 3], part[m, 4] = ya, yb, xa, (xb - xa) / (yb - ya), xb
            m += 1
        elif ya - yb > THIN:
            member[m] = ~piece
            part[m, 0], part[m, 1], part[m, 2], part[m, 3], part[m, 4] = yb, ya, xb, (xb - xa) / (yb - ya), xa
            m += 1
        piece = older[piece]
    return m, n_events, mean


@njit(**INLINE)
def _insert(value, n, heights):
    """Insert into a sorted list without repeating; returns its length."""
    q = n - 1
    while heights[q] > value:  # the first is 0
        q -= 1
    if value - heights[q] < THIN or (q + 1 < n and heights[q + 1] - value < THIN):
        return n
    for k in range(n, q + 1, -1):
        heights[k] = heights[k - 1]
    heights[q + 1] = value
    return n + 1


@njit(**LOOP)
def _find_heights(m, part, heights):
    """Sorted heights between which the pieces keep their order: their ends and crossings, 0 and 1."""
    n = 2
    heights[0], heights[1] = 0.0, 1.0
    for p in range(m):
        n = _insert(part[p, 0], n, heights)
        n = _insert(part[p, 1], n, heights)
        for q in range(p):
            low, high = max(part[p, 0], part[q, 0]), min(part[p, 1], part[q, 1])
            if low < high:
                at_low = part[p, 2] - part[q, 2] + (low - part[p, 0]) * part[p, 3] - (low - part[q, 0]) * part[q, 3]
                slope = part[p, 3] - part[q, 3]
                if at_low * (at_low + (high - low) * slope) < 0.0 and n < heights.shape[0]:
                    n = _insert(low - at_low / slope, n, heights)
    return n


@njit(**LOOP)
def _add_weights(piece, part, low, high, span, weights):
    """Give the stretch of a piece between two heights to the ends of its edge: integrals of 1 - t and t."""
    upwards = piece < 0
    if upwards:
        piece = ~piece
    ta, tb = span[piece, 0], span[piece, 1]
    slope = (tb - ta) / (part[1] - part[0])
    if upwards:
        t1, t2 = ta + (part[1] - high) * slope, ta + (part[1] - low) * slope
    else:
        t1, t2 = ta + (low - part[0]) * slope, ta + (high - part[0]) * slope
    second = 0.5 * (t2 * t2 - t1 * t1)
    weights[piece, 0] += t2 - t1 - second
    weights[piece, 1] += second


@njit(**LOOP)
def _cover_pixel(base, m, member, part, n_events, event, heights, order, where, span, weights):
    """Covered share of one pixel; adds the weights of the pieces between body and background."""
    slabs = _find_heights(m, part, heights)
    covered = 0.0
    for s in range(1, slabs):
        low, high = heights[s - 1], heights[s]
        middle = 0.5 * (low + high)
        winding, crossing = base, 0
        for p in range(n_events):
            if event[p, 0] < middle:
                winding += int(event[p, 1])
        for p in range(m):
            if part[p, 0] < middle < part[p, 1]:
                x, q = part[p, 2] + (middle - part[p, 0]) * part[p, 3], crossing - 1
                while q >= 0 and where[q] > x:
                    where[q + 1], order[q + 1] = where[q], order[q]
                    q -= 1
                where[q + 1], order[q + 1] = x, p
                crossing += 1
        length = 1.0 if winding >= 1 else 0.0
        for q in range(crossing):
            p = order[q]
            if member[p] >= 0:  # runs down: more body to its right
                winding += 1
                if winding == 1:
                    length += 1.0 - where[q]
                    _add_weights(member[p], part[p], low, high, span, weights)
            else:
                winding -= 1
                if winding == 0:
                    length -= 1.0 - where[q]
                    _add_weights(member[p], part[p], low, high, span, weights)
        covered += length * (high - low)
    return covered


@njit(**LOOP)
def resolve(
    record, pixels, windings, width, outline, projected, newest, older, edge, span, weights,
    member, part, event, heights, order, where,
):  # fmt: skip
    """Replace the mean winding of the unsure pixels by their covered share; fill the weights of their pieces."""
    for slot in range(record.shape[0]):
        pixel = pixels[record[slot]]
        row = pixel // width
        m, n_events, mean = _load(
            newest[slot], older, pixel - row * width, row, outline, projected, edge, span, member, part, event
        )
        base = int(np.round(windings[record[slot]] - mean))
        windings[record[slot]] = _cover_pixel(
            base, m, member, part, n_events, event, heights, order, where, span, weights
        )


@njit(**LOOP)
def overlap_gradient(outline, projected, owner, edge, weights, of_winding, gradient):
    """As `outline_gradient`, for the pieces of unsure pixels with their weights; `of_winding` is per pixel listed."""
    for p in range(edge.shape[0]):
        i, j = outline[edge[p], 0], outline[edge[p], 1]
        dx, dy = projected[j, 0] - projected[i, 0], projected[j, 1] - projected[i, 1]
        at_start, at_end = of_winding[owner[p]] * weights[p, 0], of_winding[owner[p]] * weights[p, 1]
        gradient[i, 0] -= dy * at_start
        gradient[i, 1] += dx * at_start
        gradient[j, 0] -= dy * at_end
        gradient[j, 1] += dx * at_end
