"""Warp kernels: the exact covered share of each pixel, from the outline of the front faces.

As in `render_outline`: an edge is cut at the pixel borders, its pieces add signed areas to their pixels, and running
sums along the rows are the mean winding number. One thread per edge of every body; areas are added as whole multiples
of UNIT, so the order of the threads does not matter. The pieces of a pixel are chained and handled by the pixel's own
thread, in the order of their numbers.
"""
# mypy: ignore-errors
# (Warp compiles these: its types are not mypy's)

import warp as wp

from hfb.kernels.warp.overlap import area_from_border, area_from_piece, base_of
from hfb.kernels.warp.screen import HALF, NONE, ONE, ZERO, outline_edge, pack, squared_distance

wp.set_module_options({"enable_backward": False})

STEPS = wp.constant(wp.float64(2.0**44))  # whole steps to a pixel's area
UNIT = wp.constant(wp.float64(2.0**-44))
TINY = wp.constant(wp.float64(1e-9))  # coverage below this is none, above 1 minus this is full
FULL = wp.constant(wp.float64(1.0 - 1e-9))
FOUR = wp.constant(wp.float64(4.0))
NEVER = wp.constant(wp.float64(1e300))
GOES_RIGHT, GOES_LEFT, GOES_DOWN, GOES_UP = (wp.constant(wp.int32(bit)) for bit in (1, 2, 4, 8))
SPARE = 5  # pieces of an edge beyond the whole pixels that it runs across and along


@wp.kernel
def count_pieces(
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    height: wp.int32,
    width: wp.int32,
    counts: wp.array2d(dtype=wp.int32),
):
    """Count an upper bound of the pieces into which pixel borders cut each outline edge. Threads: bodies, edges.

    Args:
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        height: height of the image [px].
        width: width of the image [px].
        counts: (B, E), filled.
    """
    b, e = wp.tid()
    edge = outline_edge(front, edge_vertices, edge_faces, b, e)
    n = wp.int32(0)
    if edge[2] >= 0:
        start, end = projected[b, edge[0]], projected[b, edge[1]]
        beside = wp.min(start[0], end[0]) >= wp.float64(width)
        beyond = wp.max(start[1], end[1]) <= ZERO or wp.min(start[1], end[1]) >= wp.float64(height)
        if not (beside or beyond):
            n = wp.int32(wp.min(wp.abs(start[0] - end[0]), wp.float64(width + 2)))
            n = n + wp.int32(wp.min(wp.abs(start[1] - end[1]), wp.float64(height + 2))) + SPARE
    counts[b, e] = n


@wp.func
def in_steps(area: wp.float64) -> wp.int64:
    """Convert an area to whole UNITs, so that the order of sums does not matter.

    Args:
        area: in pixels.
    """
    return wp.int64(wp.floor(area * STEPS + HALF))


@wp.func
def lay_down(
    start: wp.vec3d,
    along: wp.vec2d,
    t_from: wp.float64,
    t_to: wp.float64,
    b: wp.int32,
    e: wp.int32,
    row: wp.int32,
    column: wp.int32,
    n: wp.int32,
    winding: wp.array3d(dtype=wp.int64),
    newest: wp.array3d(dtype=wp.int32),
    older: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3i),
    span: wp.array(dtype=wp.vec2d),
    line: wp.array(dtype=wp.vec4d),
):
    """Add a piece to its pixel's winding and chain.

    Args:
        start: first end of the edge, x, y [px].
        along: second minus first end [px].
        t_from: parameter at which it begins.
        t_to: parameter at which it ends.
        b: number of the body.
        e: number of the edge among all bodies'.
        row: row of its pixel.
        column: column of its pixel; -1 where it is left of the image.
        n: number of the piece.
        winding: (B, H, W + 1), in UNITs, added to.
        newest: (B, H, W), newest piece of each pixel, -1 for none.
        older: next older piece in each piece's pixel.
        place: row, column and 1 + edge of each piece.
        span: parameters of each piece on its edge.
        line: start and end of each piece in its pixel.
    """
    cover = in_steps((t_to - t_from) * along[1])
    if column < 0:
        wp.atomic_add(winding, b, row, 0, cover)
        return
    x, y = start[0] - wp.float64(column), start[1] - wp.float64(row)
    share = x + along[0] * HALF * (t_from + t_to)  # of the pixel left of the piece
    right = in_steps((t_to - t_from) * along[1] * share)
    wp.atomic_add(winding, b, row, column, cover - right)
    wp.atomic_add(winding, b, row, column + 1, right)
    older[n] = wp.atomic_exch(newest, b, row, column, n)
    place[n] = wp.vec3i(row, column, e + 1)
    span[n] = wp.vec2d(t_from, t_to)
    line[n] = wp.vec4d(
        wp.clamp(x + t_from * along[0], ZERO, ONE),
        wp.clamp(y + t_from * along[1], ZERO, ONE),
        wp.clamp(x + t_to * along[0], ZERO, ONE),
        wp.clamp(y + t_to * along[1], ZERO, ONE),
    )


@wp.func
def next_border(cell: wp.int32, step: wp.int32, steps: wp.int32, origin: wp.float64, along: wp.float64) -> wp.float64:
    """Return the parameter at which an edge leaves its cell along one axis; NEVER where it ends within.

    Args:
        cell: row or column.
        step: 1 or -1.
        steps: cells left to cross.
        origin: origin of the edge along the axis [px].
        along: extent of the edge along the axis [px].
    """
    t = NEVER
    if steps > 0:
        border = cell
        if step > 0:
            border = cell + 1
        t = (wp.float64(border) - origin) / along
    return t


@wp.func
def cell_at(position: wp.float64, size: wp.int32) -> wp.int32:
    """Return the row or column of a position, clipped to the image.

    Args:
        position: [px].
        size: number of the image's rows or columns.
    """
    return wp.int32(wp.clamp(wp.floor(position), ZERO, wp.float64(size - 1)))


@wp.func
def walk(
    start: wp.vec3d,
    along: wp.vec2d,
    t_from: wp.float64,
    t_to: wp.float64,
    beside: wp.bool,
    b: wp.int32,
    e: wp.int32,
    n: wp.int32,
    winding: wp.array3d(dtype=wp.int64),
    newest: wp.array3d(dtype=wp.int32),
    older: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3i),
    span: wp.array(dtype=wp.vec2d),
    line: wp.array(dtype=wp.vec4d),
) -> wp.int32:
    """Lay down the pieces of a stretch of an edge; return the number after the last one.

    Args:
        start: first end of the edge, x, y [px].
        along: second minus first end [px].
        t_from: parameter at which it begins.
        t_to: parameter at which it ends.
        beside: the stretch is left of the image: only its rows count.
        b: number of the body.
        e: number of the edge among all bodies'.
        n: number of the first piece.
        winding: (B, H, W + 1), in UNITs, added to.
        newest: (B, H, W), newest piece of each pixel, -1 for none.
        older: next older piece in each piece's pixel.
        place: row, column and 1 + edge of each piece.
        span: parameters of each piece on its edge.
        line: start and end of each piece in its pixel.
    """
    height, width = newest.shape[1], newest.shape[2]
    row, row_end = cell_at(start[1] + t_from * along[1], height), cell_at(start[1] + t_to * along[1], height)
    down, across = wp.int32(1), wp.int32(1)
    if row_end < row:
        down = wp.int32(-1)
    column, steps_across = wp.int32(-1), wp.int32(0)
    if not beside:
        column = cell_at(start[0] + t_from * along[0], width)
        column_end = cell_at(start[0] + t_to * along[0], width)
        if column_end < column:
            across = wp.int32(-1)
        steps_across = (column_end - column) * across
    steps_down = (row_end - row) * down
    t, at = wp.float64(t_from), wp.int32(n)
    t_across = next_border(column, across, steps_across, start[0], along[0])
    t_down = next_border(row, down, steps_down, start[1], along[1])
    while steps_across + steps_down > 0:
        before, r, c = wp.float64(t), wp.int32(row), wp.int32(column)
        if t_across <= t_down:
            t = wp.clamp(t_across, t, t_to)
            column = column + across
            steps_across = steps_across - 1
            t_across = next_border(column, across, steps_across, start[0], along[0])
        else:
            t = wp.clamp(t_down, t, t_to)
            row = row + down
            steps_down = steps_down - 1
            t_down = next_border(row, down, steps_down, start[1], along[1])
        lay_down(start, along, before, t, b, e, r, c, at, winding, newest, older, place, span, line)
        at = at + 1
    lay_down(start, along, t, t_to, b, e, row, column, at, winding, newest, older, place, span, line)
    return at + 1


@wp.kernel
def wind(
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    begins: wp.array(dtype=wp.int32),
    winding: wp.array3d(dtype=wp.int64),
    newest: wp.array3d(dtype=wp.int32),
    older: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3i),
    span: wp.array(dtype=wp.vec2d),
    line: wp.array(dtype=wp.vec4d),
):
    """Cut the outline at the pixel borders. Threads: bodies, edges.

    Args:
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        begins: (B E + 1), number of each edge's first piece.
        winding: (B, H, W + 1), in UNITs, zeros before, filled.
        newest: (B, H, W), newest piece of each pixel, -1 before, filled.
        older: next older piece in each piece's pixel, filled.
        place: row, column and 1 + edge among all bodies' of each piece, zeros before, filled.
        span: parameters of each piece on its edge, filled.
        line: start and end of each piece in its pixel, filled.
    """
    b, e = wp.tid()
    first = begins[b * edge_vertices.shape[0] + e]
    if begins[b * edge_vertices.shape[0] + e + 1] == first:
        return
    edge = outline_edge(front, edge_vertices, edge_faces, b, e)
    start, end = projected[b, edge[0]], projected[b, edge[1]]
    along, of_all = wp.vec2d(end[0] - start[0], end[1] - start[1]), b * edge_vertices.shape[0] + e
    right, bottom = wp.float64(newest.shape[2]), wp.float64(newest.shape[1])
    ta, tb = wp.float64(0.0), wp.float64(1.0)
    if wp.min(start[1], end[1]) < ZERO or wp.max(start[1], end[1]) > bottom:
        at_top, at_bottom = (ZERO - start[1]) / along[1], (bottom - start[1]) / along[1]
        ta = wp.max(ta, wp.min(at_top, at_bottom))
        tb = wp.min(tb, wp.max(at_top, at_bottom))
    if wp.max(start[0], end[0]) > right:
        at_right = (right - start[0]) / along[0]
        if along[0] > ZERO:
            tb = wp.min(tb, at_right)
        else:
            ta = wp.max(ta, at_right)
    if ta >= tb:
        return
    if wp.min(start[0], end[0]) >= ZERO:
        walk(start, along, ta, tb, False, b, of_all, first, winding, newest, older, place, span, line)
    elif wp.max(start[0], end[0]) <= ZERO:
        walk(start, along, ta, tb, True, b, of_all, first, winding, newest, older, place, span, line)
    else:
        middle = wp.clamp((ZERO - start[0]) / along[0], ta, tb)
        enters = along[0] > ZERO
        n = walk(start, along, ta, middle, enters, b, of_all, first, winding, newest, older, place, span, line)
        walk(start, along, middle, tb, not enters, b, of_all, n, winding, newest, older, place, span, line)


@wp.func
def sort_chain(newest: wp.int32, older: wp.array(dtype=wp.int32)) -> wp.int32:
    """Chain a pixel's pieces by falling number, since threads chained them in any order; return the first.

    Args:
        newest: newest piece of the pixel.
        older: next older piece in each piece's pixel.
    """
    head, piece = wp.int32(-1), wp.int32(newest)
    while piece >= 0:
        following = older[piece]
        if head < piece:
            older[piece] = head
            head = piece
        else:
            before = wp.int32(head)
            while older[before] > piece:
                before = older[before]
            older[piece] = older[before]
            older[before] = piece
        piece = following
    return head


@wp.func
def may_overlap(
    newest: wp.int32, older: wp.array(dtype=wp.int32), span: wp.array(dtype=wp.vec2d), line: wp.array(dtype=wp.vec4d)
) -> wp.bool:
    """Return whether layers may overlap within a pixel: several strands of outline in it, or one that may cross itself.

    A strand that never turns back in x, or never in y, cannot cross itself.

    Args:
        newest: newest piece of the pixel.
        older: next older piece in each piece's pixel.
        span: parameters of each piece on its edge.
        line: start and end of each piece in its pixel.
    """
    heading, entered = wp.int32(0), wp.int32(0)
    piece = wp.int32(newest)
    while piece >= 0:
        at = line[piece]
        if at[2] > at[0]:
            heading = heading | GOES_RIGHT
        else:
            heading = heading | GOES_LEFT
        if at[3] > at[1]:
            heading = heading | GOES_DOWN
        else:
            heading = heading | GOES_UP
        if span[piece][0] > ZERO:
            entered = entered + 1
        piece = older[piece]
    return entered > 1 or heading == GOES_RIGHT | GOES_LEFT | GOES_DOWN | GOES_UP


@wp.kernel
def cover(
    running: wp.array3d(dtype=wp.int64),
    newest: wp.array3d(dtype=wp.int32),
    older: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3i),
    span: wp.array(dtype=wp.vec2d),
    line: wp.array(dtype=wp.vec4d),
    projected: wp.array2d(dtype=wp.vec3d),
    edge_vertices: wp.array2d(dtype=wp.int32),
    seen: wp.array3d(dtype=wp.int64),
    mask: wp.int64,
    alpha: wp.array3d(dtype=wp.float64),
    codes: wp.array3d(dtype=wp.int32),
    shares: wp.array(dtype=wp.vec2d),
    base: wp.array3d(dtype=wp.int32),
):
    """Compute each pixel's covered share where layers do not overlap. Threads: bodies, rows, columns.

    Args:
        running: (B, H, W), sums of `winding` along the rows.
        newest: (B, H, W), newest piece of each pixel; sorted where layers may overlap.
        older: next older piece in each piece's pixel.
        place: row, column and 1 + edge of each piece.
        span: parameters of each piece on its edge.
        line: start and end of each piece in its pixel.
        projected: (B, V), x, y [px], 1/z [1/m].
        edge_vertices: (E, 2), vertex numbers.
        seen: (B, H, W), nearest face at each centre, packed; an empty one leaves the codes out.
        mask: bits of an index.
        alpha: (B, H, W), filled.
        codes: (B, H, W), filled: a face f as f, the outline edge e closest to the centre as -1 - e.
        shares: shares of each piece that can change its pixel's coverage, derivative by the edge's two ends (integrals
            of 1 - t and t along the piece), zeros before, filled.
        base: (B, H, W), filled: NONE, or the winding number of the top left corner where layers may overlap.
    """
    b, row, column = wp.tid()
    base[b, row, column] = NONE
    covered, code = wp.float64(running[b, row, column]) * UNIT, wp.int32(NONE)
    if covered <= TINY:
        alpha[b, row, column] = ZERO
        if seen.shape[0] > 0:
            codes[b, row, column] = code
        return
    first = newest[b, row, column]
    if first >= 0:
        first = sort_chain(first, older)
        if may_overlap(first, older, span, line):
            base[b, row, column] = base_of(covered, first, older, line)
            newest[b, row, column] = first
        elif covered < FULL:
            piece = wp.int32(first)
            while piece >= 0:
                t = span[piece]
                second = HALF * (t[1] * t[1] - t[0] * t[0])
                shares[piece] = wp.vec2d(t[1] - t[0] - second, second)
                piece = older[piece]
    alpha[b, row, column] = wp.min(covered, ONE)
    if seen.shape[0] == 0:
        return
    if seen[b, row, column] > wp.int64(0):
        code = wp.int32(seen[b, row, column] & mask)
    else:
        centre = wp.vec2d(wp.float64(column) + HALF, wp.float64(row) + HALF)
        best = wp.int64(0)
        piece = wp.int32(first)
        while piece >= 0:
            e = place[piece][2] - 1 - b * edge_vertices.shape[0]
            start, end = projected[b, edge_vertices[e, 0]], projected[b, edge_vertices[e, 1]]
            squared = squared_distance(centre, start, end)
            rank = pack(FOUR - squared, mask - wp.int64(e), mask)
            if rank > best:
                best = rank
                code = -1 - e
            piece = older[piece]
    codes[b, row, column] = code


@wp.kernel
def part(
    newest: wp.array3d(dtype=wp.int32),
    older: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3i),
    span: wp.array(dtype=wp.vec2d),
    line: wp.array(dtype=wp.vec4d),
    base: wp.array3d(dtype=wp.int32),
    edges: wp.int32,
    shares: wp.array(dtype=wp.vec2d),
    areas: wp.array(dtype=wp.float64),
):
    """Compute each piece's part of the covered share of a pixel in which layers may overlap. Threads: pieces.

    Args:
        newest: (B, H, W), newest piece of each pixel, -1 for none.
        older: next older piece in each piece's pixel.
        place: row, column and 1 + edge of each piece.
        span: parameters of each piece on its edge.
        line: start and end of each piece in its pixel.
        base: (B, H, W), winding number of the top left corner where layers may overlap, else NONE.
        edges: number of one body's edges.
        shares: as of `cover`, filled.
        areas: areas of each piece, filled.
    """
    piece = wp.tid()
    at = place[piece]
    if at[2] == 0:
        return
    b = (at[2] - 1) / edges
    winding = base[b, at[0], at[1]]
    if winding != NONE:
        first = newest[b, at[0], at[1]]
        areas[piece] = area_from_piece(piece, winding, first, older, span, line, shares)


@wp.kernel
def join(
    newest: wp.array3d(dtype=wp.int32),
    older: wp.array(dtype=wp.int32),
    line: wp.array(dtype=wp.vec4d),
    base: wp.array3d(dtype=wp.int32),
    areas: wp.array(dtype=wp.float64),
    shares: wp.array(dtype=wp.vec2d),
    alpha: wp.array3d(dtype=wp.float64),
):
    """Sum the covered share of the pixels in which layers may overlap, from `part`. Threads: bodies, rows, columns.

    Args:
        newest: (B, H, W), newest piece of each pixel, -1 for none.
        older: next older piece in each piece's pixel.
        line: start and end of each piece in its pixel.
        base: (B, H, W), winding number of the top left corner where layers may overlap, else NONE.
        areas: areas of each piece, by `part`.
        shares: shares of each piece, derivative of coverage by the edge's two ends.
        alpha: (B, H, W), updated.
    """
    b, row, column = wp.tid()
    winding = base[b, row, column]
    if winding == NONE:
        return
    first = newest[b, row, column]
    covered = area_from_border(winding, first, older, line)
    piece = wp.int32(first)
    while piece >= 0:
        covered = covered + areas[piece]
        piece = older[piece]
    if covered >= FULL:
        piece = wp.int32(first)
        while piece >= 0:
            shares[piece] = wp.vec2d()
            piece = older[piece]
    alpha[b, row, column] = wp.min(covered, ONE)
