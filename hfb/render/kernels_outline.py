"""Compiled parts: projection, the outline of the front faces, and the exact share of each pixel inside it.

The front faces of a body form an oriented patchwork; the edges where it ends are its outline. The number of
front layers over a point is the winding number of the projected outline about it (Stokes), and the mean of
that number over a pixel is a sum of trapezoids, one per piece of outline in the pixel, carried along the row
(signed-area accumulation, the way fonts are rasterised). Where one strand of outline crosses a pixel, that mean
is the covered share; where layers may overlap, `kernels_overlap` finds the share. Cost: the outline's length,
whatever the number of faces.

Coordinates are pixels (x right, y down) in float64; `box` is (left, top, right, bottom) in whole pixels.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.render.kernels_compile import INLINE, LOOP

TINY = 1e-9  # coverage below this is none, above 1 minus this is full: rounding of the running sums
GOES_RIGHT, GOES_LEFT, GOES_DOWN, GOES_UP, ENTERED, ENTERED_AGAIN = 1, 2, 4, 8, 16, 32  # what a pixel's outline does
FAR_PX = 1e9  # a corner projected farther out than this is not used


@njit(**LOOP)
def project(vertices, lens, margin, projected, box):
    """Fill `projected` (V, 3) with x, y [px] and 1/z, 0 where the vertex cannot be used; `box` with their bounds,
    enlarged by a margin [px] and cut to the picture."""
    fx, fy, cx, cy, near, width, height = lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6]
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(vertices.shape[0]):
        projected[i, 2] = 0.0
        z = np.float64(vertices[i, 2])
        if z > near:  # false for NaN too
            inverse = 1.0 / z
            x = fx * np.float64(vertices[i, 0]) * inverse + cx
            y = fy * np.float64(vertices[i, 1]) * inverse + cy
            if abs(x) < FAR_PX and abs(y) < FAR_PX and inverse > 0.0:
                projected[i, 0], projected[i, 1], projected[i, 2] = x, y, inverse
                left, right = min(left, x), max(right, x)
                top, bottom = min(top, y), max(bottom, y)
    left, top, right, bottom = left - margin, top - margin, right + margin, bottom + margin
    if left > right:
        box[0], box[1], box[2], box[3] = 0, 0, 0, 0
        return
    box[0] = int(max(0.0, np.floor(min(left, width))))
    box[1] = int(max(0.0, np.floor(min(top, height))))
    box[2] = int(min(width, np.floor(max(right, 0.0)) + 1))
    box[3] = int(min(height, np.floor(max(bottom, 0.0)) + 1))
    if box[0] >= box[2] or box[1] >= box[3]:
        box[0], box[1], box[2], box[3] = 0, 0, 0, 0


@njit(**LOOP)
def to_metres(projected, vertices, lens, on_screen, gradient):
    """Chain rule through x = fx X / Z + cx, y = fy Y / Z + cy, q = 1 / Z."""
    fx, fy = lens[0], lens[1]
    for i in range(vertices.shape[0]):
        q = projected[i, 2]
        gx, gy = on_screen[i, 0] * fx, on_screen[i, 1] * fy
        gradient[i, 0] = gx * q
        gradient[i, 1] = gy * q
        by_inverse = on_screen[i, 2] + gx * np.float64(vertices[i, 0]) + gy * np.float64(vertices[i, 1])
        gradient[i, 2] = -q * q * by_inverse


@njit(**LOOP)
def find_front(projected, faces, front):
    """Mark the faces that look at the camera: negative signed area in (x right, y down)."""
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (projected[j, 0] - projected[i, 0]) * (projected[k, 1] - projected[i, 1]) - (
            projected[k, 0] - projected[i, 0]
        ) * (projected[j, 1] - projected[i, 1])
        usable = projected[i, 2] > 0.0 and projected[j, 2] > 0.0 and projected[k, 2] > 0.0
        front[f] = usable and area < 0.0


@njit(**LOOP)
def find_outline(front, edge_vertices, edge_faces, outline):
    """Fill rows (from, to, front face), directed as the front face traverses the edge; returns their number."""
    n = 0
    for e in range(edge_faces.shape[0]):
        first, second = edge_faces[e, 0], edge_faces[e, 1]
        is_first = front[first]
        is_second = front[second] if second >= 0 else False
        if is_first != is_second:
            if is_first:
                outline[n, 0], outline[n, 1], outline[n, 2] = edge_vertices[e, 0], edge_vertices[e, 1], first
            else:
                outline[n, 0], outline[n, 1], outline[n, 2] = edge_vertices[e, 1], edge_vertices[e, 0], second
            n += 1
    return n


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
    outline, projected, box, winding, marks, first, last, nearest, code, columns, rows, ends,
    piece_pixel, piece_edge, piece_span,
):  # fmt: skip
    """Add every outline edge to `winding` (region rows, columns + 1), whose running row sums are mean winding.

    marks: what the outline does in each pixel. first, last: per region row the columns touched. nearest, code:
    the z-buffer; where no face covers the pixel's centre (nearest <= 0) it receives squared distance - 4 and code
    ~k of the closest outline edge k; an empty `nearest` leaves that out. columns, rows, ends: room for the
    pieces of one edge. piece_*: every piece's region pixel (-1: none), edge, and span on it; returns their number.
    """
    left, top = box[0], box[1]
    coloured = nearest.shape[0] > 0
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
                if coloured and nearest[row, column] <= 0.0:
                    key = squared_distance(columns[p] + 0.5, rows[p] + 0.5, x0, y0, dx, dy) - 4.0
                    if key < nearest[row, column] - TINY:  # ties: the first edge, whatever the rounding
                        nearest[row, column] = key
                        code[row, column] = ~k
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
def collect(winding, marks, first, last, box, width, code, pixels, codes, windings, unsure, record):
    """List the pixels with any coverage, row by row: index, code, mean winding. Returns their number and that of
    the unsure ones, where layers may overlap; `unsure` (region) receives their running number + 1, `record` their
    place in the list.

    An empty `code` (silhouette only) leaves the codes out.
    """
    n, n_unsure = 0, 0
    coloured = code.shape[0] > 0
    for row in range(box[3] - box[1]):
        total = 0.0
        for column in range(first[row], box[2] - box[0]):
            if column <= last[row] + 1:
                total += winding[row, column]
            elif total <= TINY:  # past the last edge nothing changes any more
                break
            if total > TINY:
                pixels[n] = (row + box[1]) * width + column + box[0]
                windings[n] = total
                if coloured:
                    codes[n] = code[row, column]
                if may_overlap(marks[row, column]):
                    record[n_unsure] = n
                    n_unsure += 1
                    unsure[row * (box[2] - box[0]) + column] = n_unsure
                n += 1
    return n, n_unsure


@njit(**LOOP)
def outline_gradient(outline, projected, box, pixel_gradient, gradient, columns, rows, ends):
    """Add to `gradient` (V, 3) of x, y what the mean windings' `pixel_gradient` (region) asks of the outline.

    Moving the piece p(t), ta <= t <= tb, by v(t) changes the pixel's mean winding by the integral of
    cross(v, dp): the swept area. The edge's ends take their shares (1 - t) and t.
    """
    for k in range(outline.shape[0]):
        i, j = outline[k, 0], outline[k, 1]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        pieces, t = cut_edge(x0, y0, dx, dy, box, columns, rows, ends)
        at_start, at_end = 0.0, 0.0
        for p in range(pieces):
            t_end = ends[p]
            if columns[p] >= 0:
                g = pixel_gradient[rows[p] - box[1], columns[p] - box[0]]
                second = 0.5 * (t_end * t_end - t * t)
                at_end += g * second
                at_start += g * (t_end - t - second)
            t = t_end
        gradient[i, 0] -= dy * at_start
        gradient[i, 1] += dx * at_start
        gradient[j, 0] -= dy * at_end
        gradient[j, 1] += dx * at_end
