"""Compiled parts: the exact covered share of the few pixels in which layers of the body may overlap.

An arm's outline before the torso's: the mean winding counts their common area twice. There the pixel is cut
into slabs at every height where a piece of outline begins, ends or crosses another; within a slab the order of
the pieces from left to right does not change, so the length covered at its middle times its height is its
area. Walking from left to right also tells which pieces separate body from background: only these are seen to
move, and their weights are kept for the way back.
"""

import numpy as np
from numba import njit

from hfb.render.kernels_outline import LOOP, cut_edge

ON_BORDER = 1e-9
THIN = 1e-13  # slabs below this height hold nothing


@njit(**LOOP)
def gather_pieces(outline, n, projected, box, unsure, newest, older, edge, span, columns, rows, ends):
    """List the outline's pieces in unsure pixels: their edge and span (from, to); returns their number.

    newest, older: the pieces of one pixel as a chain (newest[pixel], older[piece]; -1 ends it).
    """
    found = 0
    for k in range(n):
        i, j = outline[k, 0], outline[k, 1]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        pieces, t = cut_edge(x0, y0, dx, dy, box, columns, rows, ends)
        for p in range(pieces):
            if columns[p] >= 0:
                slot = unsure[rows[p] - box[1], columns[p] - box[0]] - 1
                if slot >= 0:
                    edge[found], span[found, 0], span[found, 1] = k, t, ends[p]
                    older[found] = newest[slot]
                    newest[slot] = found
                    found += 1
            t = ends[p]
    return found


@njit(**LOOP)
def _load(chain, older, column, row, outline, projected, edge, span, member, ends):
    """Copy one pixel's pieces: `member` their numbers, `ends` (xa, ya, xb, yb) relative to the pixel."""
    m = 0
    while chain >= 0:
        i, j = outline[edge[chain], 0], outline[edge[chain], 1]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        x0, y0 = x0 - column, y0 - row
        member[m] = chain
        ends[m, 0] = min(max(x0 + span[chain, 0] * dx, 0.0), 1.0)
        ends[m, 1] = min(max(y0 + span[chain, 0] * dy, 0.0), 1.0)
        ends[m, 2] = min(max(x0 + span[chain, 1] * dx, 0.0), 1.0)
        ends[m, 3] = min(max(y0 + span[chain, 1] * dy, 0.0), 1.0)
        m += 1
        chain = older[chain]
    return m


@njit(**LOOP)
def _base_winding(m, ends, mean):
    """Winding at the pixel's top left corner: the integer that brings the mean over the pixel to the known one.

    Down the left border the winding falls by 1 where a piece comes in and rises by 1 where one goes out.
    """
    rest = mean
    for p in range(m):
        xa, ya, xb, yb = ends[p, 0], ends[p, 1], ends[p, 2], ends[p, 3]
        rest -= (yb - ya) * (1.0 - 0.5 * (xa + xb))
        if xa < ON_BORDER:
            rest += 1.0 - ya
        if xb < ON_BORDER:
            rest -= 1.0 - yb
    return int(np.round(rest))


@njit(**LOOP)
def _find_heights(m, ends, heights):
    """Sorted heights between which the pieces keep their order: their ends and crossings, 0 and 1."""
    n = 2
    heights[0], heights[1] = 0.0, 1.0
    for p in range(m):
        heights[n], heights[n + 1] = ends[p, 1], ends[p, 3]
        n += 2
    for p in range(m):
        ax, ay = ends[p, 2] - ends[p, 0], ends[p, 3] - ends[p, 1]
        for q in range(p):
            bx, by = ends[q, 2] - ends[q, 0], ends[q, 3] - ends[q, 1]
            cx, cy = ends[q, 0] - ends[p, 0], ends[q, 1] - ends[p, 1]
            across = ax * by - ay * bx
            s, t = cx * by - cy * bx, cx * ay - cy * ax
            if across < 0.0:
                across, s, t = -across, -s, -t
            if 0.0 < s < across and 0.0 < t < across and n < heights.shape[0]:
                heights[n] = ends[p, 1] + ay * (s / across)
                n += 1
    for p in range(1, n):
        value, q = heights[p], p - 1
        while q >= 0 and heights[q] > value:
            heights[q + 1] = heights[q]
            q -= 1
        heights[q + 1] = value
    return n


@njit(**LOOP)
def _add_weights(piece, ya, yb, low, high, span, weights):
    """Give the stretch of a piece between two heights to the ends of its edge: integrals of 1 - t and t."""
    ta, tb = span[piece, 0], span[piece, 1]
    slope = (tb - ta) / (yb - ya)
    t1, t2 = ta + (low - ya) * slope, ta + (high - ya) * slope
    if t1 > t2:
        t1, t2 = t2, t1
    second = 0.5 * (t2 * t2 - t1 * t1)
    weights[piece, 0] += t2 - t1 - second
    weights[piece, 1] += second


@njit(**LOOP)
def _cover_pixel(m, base, member, ends, heights, order, where, span, weights):
    """Covered share of one pixel; adds the weights of the pieces between body and background."""
    slabs = _find_heights(m, ends, heights)
    covered = 0.0
    for s in range(1, slabs):
        low, high = heights[s - 1], heights[s]
        if high - low < THIN:
            continue
        middle = 0.5 * (low + high)
        winding, crossing = base, 0
        for p in range(m):
            xa, ya, xb, yb = ends[p, 0], ends[p, 1], ends[p, 2], ends[p, 3]
            if xa < ON_BORDER and ya < middle:
                winding -= 1
            if xb < ON_BORDER and yb < middle:
                winding += 1
            if min(ya, yb) < middle < max(ya, yb):
                x, q = xa + (xb - xa) * ((middle - ya) / (yb - ya)), crossing - 1
                while q >= 0 and where[q] > x:
                    where[q + 1], order[q + 1] = where[q], order[q]
                    q -= 1
                where[q + 1], order[q + 1] = x, p
                crossing += 1
        since = 0.0
        for q in range(crossing):
            p = order[q]
            ya, yb = ends[p, 1], ends[p, 3]
            step = 1 if yb > ya else -1
            if winding >= 1:
                covered += (where[q] - since) * (high - low)
            if (winding == 0 and step > 0) or (winding == 1 and step < 0):
                _add_weights(member[p], ya, yb, low, high, span, weights)
            since = where[q]
            winding += step
        if winding >= 1:
            covered += (1.0 - since) * (high - low)
    return covered


@njit(**LOOP)
def resolve(
    n_unsure, record, pixels, windings, width, outline, projected, newest, older, edge, span, weights,
    member, ends, heights, order, where,
):  # fmt: skip
    """Replace the mean winding of the unsure pixels by their covered share; fill the weights of their pieces."""
    for slot in range(n_unsure):
        pixel = pixels[record[slot]]
        row = pixel // width
        m = _load(newest[slot], older, pixel - row * width, row, outline, projected, edge, span, member, ends)
        base = _base_winding(m, ends, windings[record[slot]])
        windings[record[slot]] = _cover_pixel(m, base, member, ends, heights, order, where, span, weights)


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
