"""Warp functions: the exact covered share of a pixel in which layers of the body may overlap.

As in `render_overlap`: the pixel is cut into slabs at every height where a piece of outline begins, ends or crosses
another; within a slab the order of the pieces from left to right does not change, so the length covered at its
middle times its height is its area. Nothing is stored: heights are found one after the other, orders by counting.
Every piece has a thread of its own: a fingertip's pixel may have dozens of pieces, and a device would wait for the one
thread that had them all.
"""
# mypy: ignore-errors
# (Warp compiles these: its types are not mypy's)

import warp as wp

from hfb.kernels.warp.screen import HALF, ONE, ZERO

wp.set_module_options({"enable_backward": False})

ON_BORDER = wp.constant(wp.float64(1e-9))
INNER = wp.constant(wp.float64(1.0 - 1e-12))
THIN = wp.constant(wp.float64(1e-12))  # heights closer than this are one


@wp.func
def mean_without_corner(
    newest: wp.int32, older: wp.array(dtype=wp.int32), line: wp.array(dtype=wp.vec4d)
) -> wp.float64:
    """Return a pixel's mean winding number if that of its top left corner were 0.

    Args:
        newest: first piece of the pixel's chain.
        older: next piece in the chain of each piece.
        line: start and end of each piece in its pixel.
    """
    mean, piece = wp.float64(0.0), wp.int32(newest)
    while piece >= 0:
        at = line[piece]
        mean = mean + (at[3] - at[1]) * (ONE - HALF * (at[0] + at[2]))
        if at[0] < ON_BORDER:
            mean = mean - (ONE - at[1])
        if at[2] < ON_BORDER:
            mean = mean + (ONE - at[3])
        piece = older[piece]
    return mean


@wp.func
def slope_of(at: wp.vec4d) -> wp.float64:
    """Return dx/dy of a piece; 0 of a level one.

    Args:
        at: start and end of a piece in its pixel.
    """
    slope = ZERO
    if at[3] != at[1]:
        slope = (at[2] - at[0]) / (at[3] - at[1])
    return slope


@wp.func
def crossing_of(p: wp.vec4d, q: wp.vec4d) -> wp.float64:
    """Return the height at which two pieces cross; 1 where they do not.

    Args:
        p: start and end of one piece.
        q: start and end of the other one.
    """
    low = wp.max(wp.min(p[1], p[3]), wp.min(q[1], q[3]))
    high = wp.min(wp.max(p[1], p[3]), wp.max(q[1], q[3]))
    height = ONE
    if low < high:
        slope_p, slope_q = slope_of(p), slope_of(q)
        apart = p[0] - q[0] + (low - p[1]) * slope_p - (low - q[1]) * slope_q
        slope = slope_p - slope_q
        if apart * (apart + (high - low) * slope) < ZERO:
            height = low - apart / slope
    return height


@wp.func
def next_height(
    above: wp.float64,
    piece: wp.int32,
    newest: wp.int32,
    older: wp.array(dtype=wp.int32),
    line: wp.array(dtype=wp.vec4d),
) -> wp.float64:
    """Return the next height below `above` (y runs down) where a piece begins, ends or crosses this one, or the bottom.

    Args:
        above: height to start from.
        piece: number of the piece; -1 for the pixel's left border.
        newest: first piece of the pixel's chain.
        older: next piece in the chain of each piece.
        line: start and end of each piece in its pixel.
    """
    lowest, best = above + THIN, wp.float64(ONE)
    q = wp.int32(newest)
    while q >= 0:
        at = line[q]
        if at[1] > lowest:
            best = wp.min(best, at[1])
        if at[3] > lowest:
            best = wp.min(best, at[3])
        if piece >= 0 and q != piece:
            crossing = crossing_of(line[piece], at)
            if crossing > lowest:
                best = wp.min(best, crossing)
        q = older[q]
    return best


@wp.func
def step_of(at: wp.vec4d, y: wp.float64) -> wp.int32:
    """Return 1 for a piece that runs down past a height (more body to its right), -1 for one that runs up, 0 for none.

    Args:
        at: start and end of a piece in its pixel.
        y: the height.
    """
    step = wp.int32(0)
    if at[1] < y and y < at[3]:
        step = 1
    if at[3] < y and y < at[1]:
        step = -1
    return step


@wp.func
def winding_to_left(
    base: wp.int32,
    piece: wp.int32,
    y: wp.float64,
    newest: wp.int32,
    older: wp.array(dtype=wp.int32),
    line: wp.array(dtype=wp.vec4d),
) -> wp.int32:
    """Return the winding number just left of a piece at a height.

    Down the left border it falls by 1 where a piece enters and rises by 1 where one leaves.

    Args:
        base: winding number of the pixel's top left corner.
        piece: number of the piece; -1 for the pixel's left border.
        y: the height.
        newest: first piece of the pixel's chain.
        older: next piece in the chain of each piece.
        line: start and end of each piece in its pixel.
    """
    x = wp.float64(0.0)
    if piece >= 0:
        x = line[piece][0] + (y - line[piece][1]) * slope_of(line[piece])
    winding, before = wp.int32(base), wp.bool(True)
    q = wp.int32(newest)
    while q >= 0:
        at = line[q]
        if at[2] < ON_BORDER and at[3] < y:
            winding = winding + 1
        if at[0] < ON_BORDER and at[1] < y:
            winding = winding - 1
        if q == piece:
            before = False
        elif piece >= 0:
            step = step_of(at, y)
            where = at[0] + (y - at[1]) * slope_of(at)
            if step != 0 and (where < x or (where == x and before)):
                winding = winding + step
        q = older[q]
    return winding


@wp.func
def stretch_shares(t: wp.vec2d, at: wp.vec4d, low: wp.float64, high: wp.float64) -> wp.vec2d:
    """Return the derivative of coverage by the edge's ends for a stretch of a piece: integrals of 1 - t and t.

    Args:
        t: parameters of the piece on its edge.
        at: start and end of a piece in its pixel.
        low: upper height of the stretch.
        high: lower height of the stretch.
    """
    slope = (t[1] - t[0]) / (at[3] - at[1])
    t1, t2 = t[0] + (low - at[1]) * slope, t[0] + (high - at[1]) * slope
    t_from, t_to = wp.min(t1, t2), wp.max(t1, t2)
    second = HALF * (t_to * t_to - t_from * t_from)
    return wp.vec2d(t_to - t_from - second, second)


@wp.func
def base_of(
    mean: wp.float64, newest: wp.int32, older: wp.array(dtype=wp.int32), line: wp.array(dtype=wp.vec4d)
) -> wp.int32:
    """Return the winding number of a pixel's top left corner from the pixel's mean winding number and its pieces.

    Args:
        mean: the pixel's mean winding number.
        newest: first piece of the pixel's chain.
        older: next piece in the chain of each piece.
        line: start and end of each piece in its pixel.
    """
    return wp.int32(wp.floor(mean - mean_without_corner(newest, older, line) + HALF))


@wp.func
def area_from_border(
    base: wp.int32, newest: wp.int32, older: wp.array(dtype=wp.int32), line: wp.array(dtype=wp.vec4d)
) -> wp.float64:
    """Return the area that would be covered if nothing changed from the pixel's left border on.

    Args:
        base: winding number of the pixel's top left corner.
        newest: first piece of the pixel's chain.
        older: next piece in the chain of each piece.
        line: start and end of each piece in its pixel.
    """
    area, low = wp.float64(0.0), wp.float64(0.0)
    while low < INNER:
        high = next_height(low, -1, newest, older, line)
        if winding_to_left(base, -1, HALF * (low + high), newest, older, line) >= 1:
            area = area + high - low
        low = high
    return area


@wp.func
def area_from_piece(
    piece: wp.int32,
    base: wp.int32,
    newest: wp.int32,
    older: wp.array(dtype=wp.int32),
    span: wp.array(dtype=wp.vec2d),
    line: wp.array(dtype=wp.vec4d),
    shares: wp.array(dtype=wp.vec2d),
) -> wp.float64:
    """Return the change of the area by the stretches of a piece that separate body from background; add their shares.

    These stretches change only where the piece meets another, or another begins or ends.

    Args:
        piece: number of the piece; -1 for the pixel's left border.
        base: winding number of the pixel's top left corner.
        newest: first piece of the pixel's chain.
        older: next piece in the chain of each piece.
        span: parameters of each piece on its edge.
        line: start and end of each piece in its pixel.
        shares: shares of each piece, updated.
    """
    at, area = line[piece], wp.float64(0.0)
    low, end = wp.min(at[1], at[3]), wp.max(at[1], at[3])
    while low + THIN < end:
        high = wp.min(next_height(low, piece, newest, older, line), end)
        middle = HALF * (low + high)
        step, outside = step_of(at, middle), wp.int32(0)
        if step < 0:
            outside = 1
        if step != 0 and winding_to_left(base, piece, middle, newest, older, line) == outside:
            where = at[0] + (middle - at[1]) * slope_of(at)
            area = area + wp.float64(step) * (ONE - where) * (high - low)
            shares[piece] = shares[piece] + stretch_shares(span[piece], at, low, high)
        low = high
    return area
