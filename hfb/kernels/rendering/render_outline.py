"""Compiled coverage: the exact share of each pixel inside the outline of the front faces.

The front faces of a body form an oriented patchwork; the edges where it ends are its outline. The number of
front layers over a point is the winding number of the projected outline about it (Stokes), and the mean of
that number over a pixel is a sum of trapezoids, one per piece of outline in the pixel, carried along the row
(signed-area accumulation, the way fonts are rasterised). Where one strand of outline crosses a pixel, that mean
is the covered share; where layers may overlap, `render_overlap` finds the share. Cost: the outline's length,
whatever the number of faces.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, LOOP
from hfb.kernels.rendering.render_screen import code_of, pack
from hfb.kernels.rendering.render_vector import BATCH
from hfb.kernels.simd import LANES, floor_lanes, if_less, lane_numbers, lanes, larger, load_lanes, smaller, store_lanes

TINY = 1e-9  # coverage below this is none, above 1 minus this is full: rounding of the running sums
# Rows of what is found of a batch of edges, then of the piece that LANES of them have in a pixel.
X0, Y0, DX, DY, WITHIN, STEPS = (BATCH * row for row in range(6))
COLUMN, ROW, FROM, TO, MARK, LEFT, RIGHT, NEAR = (6 * BATCH + LANES * row for row in range(8))
CUT = 6 * BATCH + 8 * LANES
GOES_RIGHT, GOES_LEFT, GOES_DOWN, GOES_UP, ENTERED, ENTERED_AGAIN = (1, 2, 4, 8, 16, 32)  # what a pixel's outline does


@njit(**LOOP)
def _walk(x0, y0, dx, dy, ta, tb, box, beside, n, columns, rows, ends):
    """Append the pixels that the stretch [ta, tb] of an edge crosses, with the parameter at which it leaves each.

    With `beside` the stretch is left of the box; its columns are not counted and written as -1.
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
    """Cut an edge at the pixel borders: list the pixels it crosses, in order, and where it leaves each.

    Pieces above, below and right of the box are dropped; those left of it are kept with column -1, for they still wind
    about every pixel to their right.

    Args:
        x0: start of the edge [px].
        y0: start of the edge [px].
        dx: end minus start [px].
        dy: end minus start [px].
        box: left, top, right, bottom [px] of the region.
        columns: columns of the pieces, filled.
        rows: rows of the pieces, filled.
        ends: parameter at which each piece ends, filled.

    Returns:
        the number of pieces, and the edge's parameter where the first begins.
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
    """Return the parameter in [0, 1] of the point of an edge closest to a position.

    Args:
        px: position [px].
        py: position [px].
        x0: start of the edge [px].
        y0: start of the edge [px].
        dx: end minus start [px].
        dy: end minus start [px].
    """
    squared_length = dx * dx + dy * dy
    if squared_length == 0.0:
        return 0.0
    return min(max(((px - x0) * dx + (py - y0) * dy) / squared_length, 0.0), 1.0)


@njit(**INLINE)
def squared_distance(px, py, x0, y0, dx, dy):
    """Return the squared distance [px^2] of a position from an edge.

    Args:
        px: position [px].
        py: position [px].
        x0: start of the edge [px].
        y0: start of the edge [px].
        dx: end minus start [px].
        dy: end minus start [px].
    """
    t = closest_parameter(px, py, x0, y0, dx, dy)
    return (x0 + t * dx - px) ** 2 + (y0 + t * dy - py) ** 2


@njit(**LOOP)
def count_pieces(outline, projected, box):
    """Return an upper bound of the number of pieces into which pixel borders cut the outline.

    Args:
        outline: (n, 3), edges (from, to, front face).
        projected: (V, 4), x, y [px], 1/z [1/m].
        box: left, top, right, bottom [px] of the region.
    """
    n = 0
    width, height = box[2] - box[0] + 2.0, box[3] - box[1] + 2.0
    for k in range(outline.shape[0]):
        i, j = outline[k, 0], outline[k, 1]
        across, along = abs(projected[i, 0] - projected[j, 0]), abs(projected[i, 1] - projected[j, 1])
        n += int(min(across, width)) + int(min(along, height)) + 5
    return n


@njit(**INLINE)
def _put_piece(pieces, n, k, row, column, breadth, t, t_end, mark, left, right, near):
    """Write piece n: of edge k from t to t_end, in a pixel of the region; for the rest see `cut_outline`."""
    pixel, edge, span, places, marks, amounts = pieces
    pixel[n], edge[n], places[n] = row * breadth + column, k, row
    span[n, 0], span[n, 1], marks[n] = t, t_end, mark
    amounts[n, 0], amounts[n, 1], amounts[n, 2] = left, right, near


@njit(**LOOP)
def _cut_far(k, x0, y0, dx, dy, box, columns, rows, ends, pieces, n):
    """Append the pieces of an edge that the box cuts; returns the new number."""
    count, t = cut_edge(x0, y0, dx, dy, box, columns, rows, ends)
    heading = (GOES_RIGHT if dx > 0.0 else GOES_LEFT) | (GOES_DOWN if dy > 0.0 else GOES_UP)
    for p in range(count):
        row, t_end = rows[p] - box[1], ends[p]
        cover = (t_end - t) * dy
        if columns[p] < 0:
            _put_piece(pieces, n, k, row, 0, box[2] - box[0], t, t_end, 0, cover, 0.0, 0.0)
            pieces[0][n] = -1
        else:
            share = x0 + dx * 0.5 * (t + t_end) - columns[p]  # of the pixel left of the piece
            near = 4.0 - squared_distance(columns[p] + 0.5, rows[p] + 0.5, x0, y0, dx, dy)
            mark, column = heading | (ENTERED if t > 0.0 else 0), columns[p] - box[0]
            left, right = cover * (1.0 - share), cover * share
            _put_piece(pieces, n, k, row, column, box[2] - box[0], t, t_end, mark, left, right, near)
        n += 1
        t = t_end
    return n


@njit(**LOOP)
def _cut_near(first, at, n_edges, box, found, pieces, n):
    """Append the pieces of up to LANES edges, a step to the next pixel of all of them at a time; returns their number.

    It is free of branches, since no processor can predict the next edge's course. `first` is the batch's first edge,
    `at` the first of these in the batch. Edges that the box cuts are left out and have a zero in row WITHIN, others a
    one.
    """
    x0, y0 = load_lanes(found, X0 + at), load_lanes(found, Y0 + at)
    dx, dy = load_lanes(found, DX + at), load_lanes(found, DY + at)
    x1, y1 = x0 + dx, y0 + dy
    left, top, right, bottom = np.float64(box[0]), np.float64(box[1]), np.float64(box[2]), np.float64(box[3])
    c = smaller(floor_lanes(x0), right - 1.0)
    r = smaller(floor_lanes(y0), bottom - 1.0)
    c_end, r_end = smaller(floor_lanes(x1), right - 1.0), smaller(floor_lanes(y1), bottom - 1.0)
    within = if_less(smaller(x0, x1), left, 0.0, if_less(right, larger(x0, x1), 0.0, 1.0))
    within = within * if_less(smaller(y0, y1), top, 0.0, if_less(bottom, larger(y0, y1), 0.0, 1.0))
    within = if_less(lane_numbers(), np.float64(n_edges), within, 0.0)
    store_lanes(found, WITHIN + at, within)
    along, down = if_less(c, c_end, 1.0, -1.0), if_less(r, r_end, 1.0, -1.0)
    steps_c, steps_r = (c_end - c) * along, (r_end - r) * down
    steps = if_less(0.5, within, steps_c + steps_r, -1.0)
    store_lanes(found, STEPS + at, steps)
    most = 0
    for lane in range(LANES):
        most = max(most, int(found[STEPS + at + lane]))
    # Where an edge leaves its pixel sideways, up or down; a whole number of steps farther each time.
    of_c, of_r = lanes(1.0) / dx, lanes(1.0) / dy
    ahead_c, ahead_r = if_less(0.0, along, 1.0, 0.0) - x0, if_less(0.0, down, 1.0, 0.0) - y0
    heading = if_less(0.0, dx, np.float64(GOES_RIGHT), np.float64(GOES_LEFT))
    heading = heading + if_less(0.0, dy, np.float64(GOES_DOWN), np.float64(GOES_UP))
    squared = dx * dx + dy * dy
    inverse = if_less(0.0, squared, lanes(1.0) / squared, 0.0)
    t = lanes(0.0)
    for _ in range(most + 1):
        t_c = if_less(0.5, steps_c, (c + ahead_c) * of_c, np.inf)
        t_r = if_less(0.5, steps_r, (r + ahead_r) * of_r, np.inf)
        t_end = larger(t, smaller(smaller(t_c, t_r), 1.0))
        cover, share = (t_end - t) * dy, x0 + dx * (0.5 * (t + t_end)) - c
        px, py = c + 0.5 - x0, r + 0.5 - y0
        nearest = larger(smaller((px * dx + py * dy) * inverse, 1.0), 0.0)
        off_x, off_y = nearest * dx - px, nearest * dy - py
        store_lanes(found, COLUMN, c - left)
        store_lanes(found, ROW, r - top)
        store_lanes(found, FROM, t)
        store_lanes(found, TO, t_end)
        store_lanes(found, MARK, heading + if_less(0.0, t, np.float64(ENTERED), 0.0))
        store_lanes(found, LEFT, cover - cover * share)
        store_lanes(found, RIGHT, cover * share)
        store_lanes(found, NEAR, 4.0 - (off_x * off_x + off_y * off_y))
        store_lanes(found, STEPS + at, steps)
        for lane in range(LANES):
            _put_piece(
                pieces,
                n,
                first + at + lane,
                np.int32(found[ROW + lane]),
                np.int32(found[COLUMN + lane]),
                box[2] - box[0],
                found[FROM + lane],
                found[TO + lane],
                np.uint8(np.int32(found[MARK + lane])),
                found[LEFT + lane],
                found[RIGHT + lane],
                found[NEAR + lane],
            )
            n += found[STEPS + at + lane] >= 0.0
        sideways = if_less(t_r, t_c, 0.0, 1.0)
        c, r = c + along * sideways, r + down * (1.0 - sideways)
        steps_c, steps_r = steps_c - sideways, steps_r - (1.0 - sideways)
        steps = steps - 1.0
        t = t_end
    return n


@njit(**LOOP)
def cut_outline(outline, projected, box, found, columns, rows, ends, pieces):
    """Cut the outline at the pixel borders; return the number of pieces.

    Args:
        outline: (n, 3), edges (from, to, front face).
        projected: (V, 4), x, y [px], 1/z [1/m].
        box: left, top, right, bottom [px] of the region.
        found: work space of CUT numbers.
        columns: work space for the pieces of one edge.
        rows: work space for the pieces of one edge.
        ends: work space for the pieces of one edge.
        pieces: filled: for every piece its region pixel (-1: left of the region), edge, span on it, region row, what it
            does there, and as amounts: what it adds to the mean winding of its pixel and of the next one, 4 - squared
            distance of the pixel's centre from the edge.
    """
    n = 0
    for first in range(0, outline.shape[0], BATCH):
        n_edges = min(BATCH, outline.shape[0] - first)
        for q in range(n_edges):
            i, j = outline[first + q, 0], outline[first + q, 1]
            x0, y0 = projected[i, 0], projected[i, 1]
            found[X0 + q], found[Y0 + q] = x0, y0
            found[DX + q], found[DY + q] = projected[j, 0] - x0, projected[j, 1] - y0
        for at in range(0, n_edges, LANES):
            n = _cut_near(first, at, n_edges - at, box, found, pieces, n)
        for q in range(n_edges):
            if found[WITHIN + q] == 0.0:
                x0, y0, dx, dy = found[X0 + q], found[Y0 + q], found[DX + q], found[DY + q]
                n = _cut_far(first + q, x0, y0, dx, dy, box, columns, rows, ends, pieces, n)
    return n


@njit(**LOOP)
def wind_outline(n, pieces, breadth, winding, marks, first, last, seen, mask):
    """Add n pieces of outline to the winding.

    Args:
        n: number of pieces.
        pieces: by `cut_outline`.
        breadth: columns of the region.
        winding: (rows, columns + 1) of the region, added to; running sums along the rows are mean winding.
        marks: what the outline does in each pixel, updated.
        first: per region row the first column touched, updated.
        last: per region row the last column touched, updated.
        seen: where no face is seen at the pixel's centre (<= 0) it receives the closest outline edge k, as -pack(4 -
            squared distance, mask - k): of equals the first; an empty one is skipped.
        mask: bits of an index, by `mask_for`.
    """
    piece_pixel, piece_edge, _, piece_row, piece_mark, amounts = pieces
    coloured = seen.shape[0] > 0
    for p in range(n):
        row = np.uint32(piece_row[p])
        if piece_pixel[p] < 0:
            winding[row, 0] += amounts[p, 0]
            first[row] = 0
            last[row] = max(last[row], 0)
            continue
        column = np.uint32(piece_pixel[p] - np.int64(row) * breadth)
        winding[row, column] += amounts[p, 0]
        winding[row, column + 1] += amounts[p, 1]
        first[row] = min(first[row], column)
        last[row] = max(last[row], column)
        mark = marks[row, column]
        entered = piece_mark[p] & ENTERED
        marks[row, column] = mark | piece_mark[p] | ((mark & entered) << 1)  # ENTERED_AGAIN is the next bit
        if coloured:
            held = seen[row, column]
            mine = -pack(amounts[p, 2], mask - piece_edge[p], mask)
            seen[row, column] = mine if (held <= 0) & (mine < held) else held


@njit(**INLINE)
def may_overlap(mark):
    """Return whether layers may overlap within a pixel: several strands of outline in it, or one that may cross itself.

    A strand that never turns back in x, or never in y, cannot cross itself.

    Args:
        mark: what the outline does in the pixel.
    """
    turns_back = (mark & (GOES_RIGHT | GOES_LEFT | GOES_DOWN | GOES_UP)) == 15
    return (mark >= ENTERED_AGAIN) | turns_back


@njit(**LOOP)
def collect(winding, marks, first, last, box, width, seen, mask, pixels, codes, windings, place, unsure):
    """List the pixels with any coverage, row by row.

    Args:
        winding: (rows, columns + 1) of the region; running sums along the rows are mean winding.
        marks: what the outline does in each pixel.
        first: per region row the first column touched.
        last: per region row the last column touched.
        box: left, top, right, bottom [px] of the region.
        width: width of the image [px].
        seen: nearest face or edge at each pixel, packed; an empty one leaves the codes out.
        mask: bits of an index, by `mask_for`.
        pixels: index of each pixel, filled.
        codes: what each pixel shows, filled.
        windings: mean winding of each pixel, filled.
        place: filled for pixels that the outline crosses: 1 + place in the list, or -1 - place in `unsure`; 0
            elsewhere.
        unsure: their places in the list, filled.

    Returns:
        their number, and that of the unsure ones, in which layers may overlap.
    """
    n, n_unsure = 0, 0
    coloured = seen.shape[0] > 0
    breadth = box[2] - box[0]
    for row in range(box[3] - box[1]):
        total, column, end = 0.0, first[row], min(last[row] + 2, breadth)
        from_pixel = (row + box[1]) * width + box[0]
        while column < breadth:
            # A pixel of the outline or the one after it, written to the end of the lists whether it is kept or not.
            mark = marks[row, column]
            total += winding[row, column]
            kept = total > TINY
            doubted = kept & may_overlap(mark)
            pixels[n], windings[n], unsure[n_unsure] = from_pixel + column, total, n
            if coloured:
                codes[n] = code_of(seen[row, column], mask)
            crossed = n + 1 if kept & (total < 1.0 - TINY) else 0
            place[row * breadth + column] = -1 - n_unsure if doubted else crossed
            n += kept
            n_unsure += doubted
            column += 1
            if mark != 0:
                continue
            # From here to the outline's next pixel nothing changes.
            until = column
            while until < end and marks[row, until] == 0:
                until += 1
            until = until if until < end else breadth
            if kept:
                for k in range(until - column):
                    pixels[n + k], windings[n + k] = from_pixel + column + k, total
                if coloured:
                    for k in range(until - column):
                        codes[n + k] = code_of(seen[row, column + k], mask)
                n += until - column
            column = until
    return n, n_unsure


@njit(**LOOP)
def weigh_pieces(piece_pixel, piece_edge, piece_span, place, unsure, coverage, weights, owner, edge, shares):
    """List the pieces that can change a pixel's coverage; return their number.

    A full pixel stays full: its pieces are left out.

    Args:
        piece_pixel: region pixel of each piece.
        piece_edge: edge of each piece.
        piece_span: parameters on the edge.
        place: place of the region's pixels in the lists, see `collect`.
        unsure: places of pixels in which layers may overlap.
        coverage: coverage of each listed pixel.
        weights: shares of the pieces in unsure pixels.
        owner: place of each piece's pixel, filled.
        edge: edge of each piece, filled.
        shares: derivative of coverage by the edge's two ends (integrals of 1 - t and t along the piece), filled.
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
def outline_backward(outline, projected, owner, edge, shares, of_coverage, gradient):
    """Add the gradient by the outline's x and y through the pixels' coverage.

    Moving a piece p(t) by v(t) changes its pixel's coverage by the integral of cross(v, dp): the swept area. The
    edge's ends take their shares (1 - t) and t.

    Args:
        outline: (n, 3), edges (from, to, front face).
        projected: (V, 4), x, y [px], 1/z [1/m].
        owner: by `weigh_pieces`.
        edge: by `weigh_pieces`.
        shares: by `weigh_pieces`.
        of_coverage: gradient by each listed pixel's coverage.
        gradient: (V, 3) of x, y, added to.
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
