"""Compiled parts: the exact share of each pixel that lies inside the outline of the front faces.

The front faces of a body form an oriented patchwork; the edges where it ends are its outline. The number of
front layers over a point is the winding number of the projected outline about it (Stokes), and the mean of
that number over a pixel is a sum of trapezoids, one per piece of outline in the pixel, carried along the row
(signed-area accumulation, the way fonts are rasterised). Where one strand of outline crosses a pixel, that mean
is the covered share; where layers may overlap, `kernels_overlap` finds the share. Cost: the outline's length,
whatever the number of faces.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE, LOOP
from hfb.render.kernels_screen import code_of, pack

TINY = 1e-9  # coverage below this is none, above 1 minus this is full: rounding of the running sums
GOES_RIGHT, GOES_LEFT, GOES_DOWN, GOES_UP, ENTERED, ENTERED_AGAIN = (1, 2, 4, 8, 16, 32)  # what a pixel's outline does


@njit(**LOOP)
def _walk(x0, y0, dx, dy, ta, tb, box, beside, n, columns, rows, ends):
    """Append the pixels that the stretch [ta, tb] of an edge crosses, with the parameter at which it leaves each.

    beside: the stretch lies left of the box; its columns are not counted and written as -1.
    """
    r = min(max(int(np.floor(y0 + ta * dy)), box[1]), box[3] - 1)
    r_end = min(max(int(np.floor(y0 + tb * dy)), box[1]), box[3] - 1)
    down = 1 if r_end > r else -1
    steps_r = (r_end - r) * down
    if beside:
        c, steps_c, along = -1, 0, 1
    else:
        c = min(max(int(np.floor(x0 + ta * dx)), box[0]), box[2] - 1)
        c_end = min(max(int(np.floor(x0 + tb * dx)), box[0]), box[2] - 1)
        along = 1 if c_end > c else -1
        steps_c = (c_end - c) * along
    t = ta
    t_c = ((c + (along > 0)) - x0) / dx if steps_c > 0 else np.inf
    t_r = ((r + (down > 0)) - y0) / dy if steps_r > 0 else np.inf
    while steps_c + steps_r > 0:
        columns[n], rows[n] = c, r
        if t_c <= t_r:
            t = min(max(t_c, t), tb)
            c += along
            steps_c -= 1
            t_c = ((c + (along > 0)) - x0) / dx if steps_c > 0 else np.inf
        else:
            t = min(max(t_r, t), tb)
            r += down
            steps_r -= 1
            t_r = ((r + (down > 0)) - y0) / dy if steps_r > 0 else np.inf
        ends[n] = t
        n += 1
    columns[n], rows[n], ends[n] = c, r, tb
    return n + 1


@njit(**LOOP)
def cut_edge(x0, y0, dx, dy, box, columns, rows, ends):
    """Cut an edge at the pixel borders: the pixels it crosses, in order, and where it leaves each.

    Returns (number of pieces, parameter where the first begins). Pieces above, below and right of the box are
    dropped; those left of it are kept with column -1, for they still wind about every pixel to their right.
    """
    ta, tb = 0.0, 1.0
    x1, y1 = x0 + dx, y0 + dy
    left, top, right, bottom = box[0], box[1], box[2], box[3]
    if min(y0, y1) < top or max(y0, y1) > bottom:
        if max(y0, y1) <= top or min(y0, y1) >= bottom:
            return 0, 0.0
        at_top, at_bottom = (top - y0) / dy, (bottom - y0) / dy
        ta, tb = max(ta, min(at_top, at_bottom)), min(tb, max(at_top, at_bottom))
    if max(x0, x1) > right:
        if min(x0, x1) >= right:
            return 0, 0.0
        at_right = (right - x0) / dx
        if dx > 0:
            tb = min(tb, at_right)
        else:
            ta = max(ta, at_right)
    if ta >= tb:
        return 0, 0.0
    if min(x0, x1) >= left:
        return _walk(x0, y0, dx, dy, ta, tb, box, False, 0, columns, rows, ends), ta
    if max(x0, x1) <= left:
        return _walk(x0, y0, dx, dy, ta, tb, box, True, 0, columns, rows, ends), ta
    at_left = min(max((left - x0) / dx, ta), tb)
    n = _walk(x0, y0, dx, dy, ta, at_left, box, dx > 0, 0, columns, rows, ends)
    return _walk(x0, y0, dx, dy, at_left, tb, box, dx < 0, n, columns, rows, ends), ta


@njit(**INLINE)
def closest_parameter(px, py, x0, y0, dx, dy):
    """Parameter in [0, 1] of the point of an edge closest to (px, py)."""
    squared_length = dx * dx + dy * dy
    if squared_length == 0.0:
        return 0.0
    return min(max(((px - x0) * dx + (py - y0) * dy) / squared_length, 0.0), 1.0)


@njit(**INLINE)
def squared_distance(px, py, x0, y0, dx, dy):
    """Squared distance [px^2] of (px, py) from an edge."""
    t = closest_parameter(px, py, x0, y0, dx, dy)
    return (x0 + t * dx - px) ** 2 + (y0 + t * dy - py) ** 2


@njit(**LOOP)
def count_pieces(outline, projected, box):
    """No fewer than the pieces into which pixel borders cut the outline."""
    n = 0
    width, height = box[2] - box[0] + 2.0, box[3] - box[1] + 2.0
    for k in range(outline.shape[0]):
        i, j = outline[k, 0], outline[k, 1]
        across, along = abs(projected[i, 0] - projected[j, 0]), abs(projected[i, 1] - projected[j, 1])
        n += int(min(across, width)) + int(min(along, height)) + 5
    return n


@njit(**LOOP)
def wind_outline(
    outline, projected, box, winding, marks, first, last, seen, mask, columns, rows, ends,
    piece_pixel, piece_edge, piece_span,
):  # fmt: skip
    """Add every outline edge to `winding` (region rows, columns + 1), whose running row sums are mean winding.

    marks: what the outline does in each pixel. first, last: per region row the columns touched. seen: where no face
    is seen at the pixel's centre (<= 0) it receives the closest outline edge k, as -pack(4 - squared distance,
    mask - k): of equals the first; an empty `seen` leaves that out. columns, rows, ends: room for the pieces of one
    edge. piece_*: every piece's region pixel (-1: none), edge, and span on it; returns their number.
    """
    left, top = box[0], box[1]
    coloured = seen.shape[0] > 0
    total = 0
    breadth = box[2] - left
    for k in range(outline.shape[0]):
        i, j = outline[k, 0], outline[k, 1]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        pieces, t = cut_edge(x0, y0, dx, dy, box, columns, rows, ends)
        heading = (GOES_RIGHT if dx > 0.0 else GOES_LEFT) | (GOES_DOWN if dy > 0.0 else GOES_UP)
        for p in range(pieces):
            row, t_end = rows[p] - top, ends[p]
            cover = (t_end - t) * dy
            piece_pixel[total] = -1
            piece_edge[total], piece_span[total, 0], piece_span[total, 1] = k, t, t_end
            if columns[p] < 0:
                winding[row, 0] += cover
                first[row] = 0
                last[row] = max(last[row], 0)
            else:
                column = columns[p] - left
                piece_pixel[total] = row * breadth + column
                share = x0 + dx * 0.5 * (t + t_end) - columns[p]  # of the pixel left of the piece
                winding[row, column] += cover * (1.0 - share)
                winding[row, column + 1] += cover * share
                first[row] = min(first[row], column)
                last[row] = max(last[row], column)
                mark = marks[row, column] | heading
                if t > 0.0:
                    mark |= ENTERED_AGAIN if mark & ENTERED else ENTERED
                marks[row, column] = mark
                if coloured and seen[row, column] <= 0:
                    squared = squared_distance(columns[p] + 0.5, rows[p] + 0.5, x0, y0, dx, dy)
                    seen[row, column] = min(seen[row, column], -pack(4.0 - squared, mask - k, mask))
            total += 1
            t = t_end
    return total


@njit(**INLINE)
def may_overlap(mark):
    """Whether layers may overlap within a pixel: several strands of outline in it, or one that may cross itself.

    A strand that never turns back in x, or never in y, cannot cross itself.
    """
    turns_back = (mark & (GOES_RIGHT | GOES_LEFT)) == 3 and (mark & (GOES_DOWN | GOES_UP)) == 12
    return (mark & ENTERED_AGAIN) != 0 or turns_back


@njit(**LOOP)
def collect(winding, marks, first, last, box, width, seen, mask, pixels, codes, windings, place, unsure):
    """List the pixels with any coverage, row by row: index, code, mean winding. Returns their number and that of
    the unsure ones, where layers may overlap.

    unsure: their places in the list. place (region): 1 + place in the list of a pixel that the outline crosses,
    - 1 - place in `unsure` of an unsure one, 0 elsewhere. An empty `seen` (silhouette only) leaves the codes out.
    """
    n, n_unsure = 0, 0
    coloured = seen.shape[0] > 0
    breadth = box[2] - box[0]
    for row in range(box[3] - box[1]):
        total = 0.0
        for column in range(first[row], breadth):
            if column <= last[row] + 1:
                total += winding[row, column]
            elif total <= TINY:  # past the last edge nothing changes any more
                break
            if total > TINY:
                pixels[n] = (row + box[1]) * width + column + box[0]
                windings[n] = total
                if coloured:
                    codes[n] = code_of(seen[row, column], mask)
                if may_overlap(marks[row, column]):
                    unsure[n_unsure] = n
                    n_unsure += 1
                    place[row * breadth + column] = -n_unsure
                elif total < 1.0 - TINY:
                    place[row * breadth + column] = n + 1
                n += 1
    return n, n_unsure


@njit(**LOOP)
def weigh_pieces(piece_pixel, piece_edge, piece_span, place, unsure, coverage, weights, owner, edge, shares):
    """List the pieces that can change a pixel's coverage: the pixel's place, the edge, and how much its two ends
    move it (integrals of 1 - t and t along the piece). `weights` has them for the unsure pixels. Returns the number.

    A full pixel stays full: its pieces are left out.
    """
    n = 0
    for p in range(piece_pixel.shape[0]):
        at = place[piece_pixel[p]] if piece_pixel[p] >= 0 else 0
        if at > 0:
            t1, t2 = piece_span[p, 0], piece_span[p, 1]
            shares[n, 1] = 0.5 * (t2 * t2 - t1 * t1)
            shares[n, 0] = t2 - t1 - shares[n, 1]
            owner[n], edge[n] = at - 1, piece_edge[p]
            n += 1
        elif at < 0 and weights[p, 0] + weights[p, 1] > 0.0 and coverage[unsure[-1 - at]] < 1.0 - TINY:
            shares[n, 0], shares[n, 1] = weights[p, 0], weights[p, 1]
            owner[n], edge[n] = unsure[-1 - at], piece_edge[p]
            n += 1
    return n


@njit(**LOOP)
def pull_outline(outline, projected, owner, edge, shares, of_coverage, gradient):
    """Add to `gradient` (V, 3) of x, y what the pixels' coverage asks of the outline.

    Moving a piece p(t) by v(t) changes its pixel's coverage by the integral of cross(v, dp): the swept area. The
    edge's ends take their shares (1 - t) and t.
    """
    for p in range(owner.shape[0]):
        k = np.uint32(edge[p])
        i, j = outline[k, 0], outline[k, 1]
        g = of_coverage[np.uint32(owner[p])]
        dx, dy = (projected[j, 0] - projected[i, 0]) * g, (projected[j, 1] - projected[i, 1]) * g
        gradient[i, 0] -= dy * shares[p, 0]
        gradient[i, 1] += dx * shares[p, 0]
        gradient[j, 0] -= dy * shares[p, 1]
        gradient[j, 1] += dx * shares[p, 1]
