"""Compiled projection: vertices on the screen, the face seen at each pixel's centre, the outline of the front faces.

Coordinates are pixels (x right, y down) in float64; `box` is (left, top, right, bottom) in whole pixels; `lens` is
(fx, fy, cx, cy, nearest depth used, width, height).
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, JIT, LOOP
from hfb.kernels.rendering.render_vector import BATCH, keep_nearest, store_corners
from hfb.kernels.simd import (
    LANES,
    floor_lanes,
    if_less,
    lane_numbers,
    lanes,
    larger,
    load_apart,
    load_lanes,
    multiply_add,
    smaller,
    store_lanes,
    where_more,
    where_no_less,
    widen_lanes,
)

NOTHING = np.iinfo(np.int32).min  # code of a pixel that shows neither a face nor an outline edge
TILE_COLUMNS, TILE_ROWS = 4, 2  # most faces' centres lie in one such tile
# Rows of what is found of a batch of faces.
X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, B1_X, B1_Y, B2_X, B2_Y, C_FROM, C_TO, R_FROM, R_TO = (
    BATCH * row for row in range(17)
)
SET_UP = 17 * BATCH
FAR_PX = 1e9  # a corner projected farther out than this is not used


@njit(**INLINE)
def mask_for(faces, edges):
    """Return a mask of the bits that hold any index of a face or an edge.

    Args:
        faces: (F, 3), vertex numbers.
        edges: (E, ...).
    """
    mask = 1
    while mask < faces.shape[0] or mask < edges.shape[0]:
        mask *= 2
    return mask - 1


@njit(**INLINE)
def pack(value, index, mask):
    """Replace the last bits of a positive number by an index; the order of numbers is kept (to some 11 digits).

    Args:
        value: positive number.
        index: number of a face or an edge.
        mask: bits of an index, by `mask_for`.
    """
    return (np.float64(value).view(np.int64) & ~mask) | index


@njit(**INLINE)
def code_of(seen, mask):
    """Return what a pixel shows: a face f as f, the outline edge k as ~k.

    Args:
        seen: packed, positive for a face, negative for an edge, 0 for nothing.
        mask: bits of an index, by `mask_for`.
    """
    edge = ~(mask - (-seen & mask)) if seen < 0 else np.int64(NOTHING)
    return seen & mask if seen > 0 else edge


@njit(**INLINE)
def _bound(left, top, right, bottom, lens, box):
    """Fill `box` with bounds cut to the image."""
    width, height = lens[5], lens[6]
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
def project(vertices, lens, margin, screen, projected, boxes, bounds):
    """Project up to LANES bodies.

    Vertices that cannot be used become zeros.

    Args:
        vertices: (n, V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        margin: added to the boxes [px].
        screen: (V, 3 x LANES), filled with x, y and 1/z of all bodies side by side; lanes beyond repeat the last body.
        projected: (n, V, 4), filled with x, y [px], 1/z [1/m], 0.
        boxes: (n, 4), filled with the bodies' bounds, enlarged by the margin and clipped to the image.
        bounds: work space of 4 LANES numbers.
    """
    fx, fy, cx, cy, near = lens[0], lens[1], lens[2], lens[3], lens[4]
    count, stride, many = vertices.shape[0], 3 * vertices.shape[1], lanes(np.inf)
    left, top, right, bottom = many, many, 0.0 - many, 0.0 - many
    for v in range(vertices.shape[1]):
        at = 3 * LANES * v
        if count == LANES:
            x, y = (
                widen_lanes(load_apart(vertices, 3 * v, stride)),
                widen_lanes(load_apart(vertices, 3 * v + 1, stride)),
            )
            z = widen_lanes(load_apart(vertices, 3 * v + 2, stride))
        else:
            for q in range(3):
                for s in range(LANES):
                    screen[v, q * LANES + s] = vertices[min(s, count - 1), v, q]
            x, y, z = load_lanes(screen, at), load_lanes(screen, at + LANES), load_lanes(screen, at + 2 * LANES)
        inverse = lanes(1.0) / z
        x, y = multiply_add(x * fx, inverse, lanes(cx)), multiply_add(y * fy, inverse, lanes(cy))
        used = if_less(near, z, if_less(0.0, inverse, 1.0, 0.0), 0.0)  # not where one is not a number, either
        used = if_less(larger(larger(x, 0.0 - x), larger(y, 0.0 - y)), FAR_PX, used, 0.0)
        left, right = smaller(if_less(0.0, used, x, many), left), larger(if_less(0.0, used, x, 0.0 - many), right)
        top, bottom = smaller(if_less(0.0, used, y, many), top), larger(if_less(0.0, used, y, 0.0 - many), bottom)
        x, y, inverse = if_less(0.0, used, x, 0.0), if_less(0.0, used, y, 0.0), if_less(0.0, used, inverse, 0.0)
        store_lanes(screen, at, x)
        store_lanes(screen, at + LANES, y)
        store_lanes(screen, at + 2 * LANES, inverse)
        if count == LANES:
            store_corners(projected, 4 * v, 4 * vertices.shape[1], x, y, inverse)
        else:
            for s in range(count):
                for q in range(3):
                    projected[s, v, q] = screen[v, q * LANES + s]
                projected[s, v, 3] = 0.0
    store_lanes(bounds, 0, left - margin)
    store_lanes(bounds, LANES, top - margin)
    store_lanes(bounds, 2 * LANES, right + margin)
    store_lanes(bounds, 3 * LANES, bottom + margin)
    for s in range(count):
        _bound(bounds[s], bounds[LANES + s], bounds[2 * LANES + s], bounds[3 * LANES + s], lens, boxes[s])


@njit(**LOOP)
def to_metres(projected, vertices, lens, on_screen, gradient):
    """Apply the chain rule through x = fx X / Z + cx, y = fy Y / Z + cy, q = 1 / Z.

    Args:
        projected: (V, 4), x, y [px], 1/z [1/m], 0.
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        on_screen: (V, 3), gradient by x, y, q.
        gradient: (V, 3), filled.
    """
    fx, fy = lens[0], lens[1]
    for i in range(vertices.shape[0]):
        q = projected[i, 2]
        gx, gy = on_screen[i, 0] * fx, on_screen[i, 1] * fy
        gradient[i, 0] = gx * q
        gradient[i, 1] = gy * q
        by_inverse = on_screen[i, 2] + gx * np.float64(vertices[i, 0]) + gy * np.float64(vertices[i, 1])
        gradient[i, 2] = -q * q * by_inverse


@njit(**LOOP)
def find_front(screen, faces, boxes, bounds, front, candidates, counts):
    """Find the faces that look at the camera: negative signed area in (x right, y down).

    All of up to LANES bodies at once and without branches: most faces are smaller than a pixel, and whether one
    contains a centre is unpredictable.

    Args:
        screen: (V, 3 x LANES), see `project`.
        faces: (F, 3), vertex numbers.
        boxes: left, top, right, bottom [px] of each body.
        bounds: work space of 4 LANES numbers.
        front: (F), filled, a bit per body.
        candidates: per body the faces with a pixel's centre in their bounding box, filled; an empty one is skipped.
        counts: number of candidates per body, updated.
    """
    for s in range(LANES):
        body = min(s, boxes.shape[0] - 1)
        bounds[s], bounds[LANES + s] = boxes[body, 0], boxes[body, 1]
        bounds[2 * LANES + s], bounds[3 * LANES + s] = boxes[body, 2] - 1.0, boxes[body, 3] - 1.0
    left, top = load_lanes(bounds, 0), load_lanes(bounds, LANES)
    right, bottom = load_lanes(bounds, 2 * LANES), load_lanes(bounds, 3 * LANES)
    for f in range(faces.shape[0]):
        first, second, third = np.int64(faces[f, 0]), np.int64(faces[f, 1]), np.int64(faces[f, 2])
        i, j, k = 3 * LANES * first, 3 * LANES * second, 3 * LANES * third
        x0, x1, x2 = load_lanes(screen, i), load_lanes(screen, j), load_lanes(screen, k)
        y0, y1, y2 = load_lanes(screen, i + LANES), load_lanes(screen, j + LANES), load_lanes(screen, k + LANES)
        q0, q1 = load_lanes(screen, i + 2 * LANES), load_lanes(screen, j + 2 * LANES)
        q2 = load_lanes(screen, k + 2 * LANES)
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        looks = where_more(0.0, area) & where_more(smaller(q0, smaller(q1, q2)), 0.0)
        front[f] = looks
        if looks != 0 and candidates.shape[0] > 0:
            # The first and the last centre between the bounds.
            c_from = larger(smaller(x0, smaller(x1, x2)) - 0.5, left)
            c_to = smaller(larger(x0, larger(x1, x2)) - 0.5, right)
            r_from = larger(smaller(y0, smaller(y1, y2)) - 0.5, top)
            r_to = smaller(larger(y0, larger(y1, y2)) - 0.5, bottom)
            looks &= where_no_less(floor_lanes(c_to), c_from) & where_no_less(floor_lanes(r_to), r_from)
            for s in range(boxes.shape[0]):
                candidates[s, counts[s]] = f
                counts[s] += (looks >> s) & 1


@njit(**LOOP)
def find_outline(front, edge_faces, sides, counts):
    """List, for each of n bodies, the edges at which its front faces end.

    Args:
        front: (F), faces that look at the camera, a bit per body.
        edge_faces: (E, 2), faces on both sides.
        sides: per body 2 e where the first face of edge e is in front, 2 e + 1 where the second is, filled.
        counts: number of sides per body, updated.
    """
    for e in range(edge_faces.shape[0]):
        first, second = edge_faces[e, 0], edge_faces[e, 1]
        is_first = front[first]
        differ = is_first ^ (front[second] if second < front.shape[0] else 0)
        if differ != 0:
            for s in range(counts.shape[0]):
                sides[s, counts[s]] = 2 * e + 1 - ((is_first >> s) & 1)
                counts[s] += (differ >> s) & 1


@njit(**LOOP)
def trace_outline(sides, edge_vertices, edge_faces, outline):
    """Fill rows (from, to, front face), directed as the front face traverses the edge.

    Args:
        sides: sides of one body, by `find_outline`.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        outline: (n, 3), filled.
    """
    for n in range(sides.shape[0]):
        e, side = np.uint32(sides[n] >> 1), np.uint32(sides[n] & 1)
        outline[n, 0], outline[n, 1] = edge_vertices[e, side], edge_vertices[e, 1 - side]
        outline[n, 2] = edge_faces[e, side]


@njit(**LOOP)
def _set_up(projected, faces, candidates, box, found):
    """Fill `found`, rows of BATCH numbers, for at most BATCH faces.

    The rows are the first corner, the differences of the others' 1/z, the slopes of their weights, and the first and
    the last column and row of centres in the face's bounds.
    """
    for n in range(candidates.shape[0]):
        f = candidates[n]
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        found[X0 + n], found[Y0 + n], found[Z0 + n] = projected[i, 0], projected[i, 1], projected[i, 2]
        found[X1 + n], found[Y1 + n], found[Z1 + n] = projected[j, 0], projected[j, 1], projected[j, 2]
        found[X2 + n], found[Y2 + n], found[Z2 + n] = projected[k, 0], projected[k, 1], projected[k, 2]
    left, top, right, bottom = np.float64(box[0]), np.float64(box[1]), np.float64(box[2]), np.float64(box[3])
    for n in range(0, candidates.shape[0], LANES):
        x0, y0, z0 = load_lanes(found, X0 + n), load_lanes(found, Y0 + n), load_lanes(found, Z0 + n)
        x1, y1, x2, y2 = (
            load_lanes(found, X1 + n),
            load_lanes(found, Y1 + n),
            load_lanes(found, X2 + n),
            load_lanes(found, Y2 + n),
        )
        store_lanes(found, Z1 + n, load_lanes(found, Z1 + n) - z0)
        store_lanes(found, Z2 + n, load_lanes(found, Z2 + n) - z0)
        inverse = lanes(1.0) / ((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
        store_lanes(found, B1_X + n, (y2 - y0) * inverse)
        store_lanes(found, B1_Y + n, (x0 - x2) * inverse)
        store_lanes(found, B2_X + n, (y0 - y1) * inverse)
        store_lanes(found, B2_Y + n, (x1 - x0) * inverse)
        # The whole number not below a is minus the one not above -a.
        store_lanes(found, C_FROM + n, 0.0 - floor_lanes(0.0 - larger(smaller(x0, smaller(x1, x2)) - 0.5, left)))
        store_lanes(found, C_TO + n, floor_lanes(smaller(larger(x0, larger(x1, x2)) - 0.5, right - 1.0)))
        store_lanes(found, R_FROM + n, 0.0 - floor_lanes(0.0 - larger(smaller(y0, smaller(y1, y2)) - 0.5, top)))
        store_lanes(found, R_TO + n, floor_lanes(smaller(larger(y0, larger(y1, y2)) - 0.5, bottom - 1.0)))


@njit(**LOOP)
def fill_depth(projected, faces, candidates, box, mask, found, tiles):
    """Keep the nearest of some faces at each pixel's centre.

    A 1/z and its face are one number, as the larger of two numbers can be taken without a branch.

    Args:
        projected: (V, 4), x, y [px], 1/z [1/m], 0.
        faces: (F, 3), vertex numbers.
        candidates: faces that may be seen.
        box: left, top, right, bottom [px] of the region.
        mask: bits of an index, by `mask_for`.
        found: work space of SET_UP numbers.
        tiles: the region, and what tiles extend beyond it, updated: the largest 1/z with the face in the bits of the
            mask.
    """
    left, top = box[0], box[1]
    stride, lane = tiles.shape[1], lane_numbers()
    below = if_less(lane, np.float64(TILE_COLUMNS), 0.0, 1.0)
    right_of = lane - np.float64(TILE_COLUMNS) * below
    for first in range(0, candidates.shape[0], BATCH):
        batch = candidates[first : first + BATCH]
        _set_up(projected, faces, batch, box, found)
        for n in range(batch.shape[0]):
            x0, y0, z0, z1, z2 = found[X0 + n], found[Y0 + n], found[Z0 + n], found[Z1 + n], found[Z2 + n]
            b1_x, b1_y, b2_x, b2_y = found[B1_X + n], found[B1_Y + n], found[B2_X + n], found[B2_Y + n]
            f, c_from, c_to = np.int64(batch[n]), int(found[C_FROM + n]), int(found[C_TO + n])
            # Pixels beyond a face's bounds are outside of it; those beyond the box are not used.
            for r in range(int(found[R_FROM + n]), int(found[R_TO + n]) + 1, TILE_ROWS):
                py = below + (r + 0.5 - y0)
                for c in range(c_from, c_to + 1, TILE_COLUMNS):
                    px = right_of + (c + 0.5 - x0)
                    b1, b2 = px * b1_x + py * b1_y, px * b2_x + py * b2_y
                    least = smaller(1.0 - b1 - b2, smaller(b1, b2))
                    at = (r - top) * stride + c - left
                    keep_nearest(tiles, at, at + stride, b1 * z1 + b2 * z2 + z0, least, f, mask)


@njit(**JIT)
def see_faces(projected, faces, candidates, box, mask):
    """Return the nearest of some faces at each pixel's centre, for the region and for what tiles extend beyond it.

    Args:
        projected: (V, 4), x, y [px], 1/z [1/m], 0.
        faces: (F, 3), vertex numbers.
        candidates: faces that may be seen.
        box: left, top, right, bottom [px] of the region.
        mask: bits of an index, by `mask_for`.
    """
    height, width = box[3] - box[1], box[2] - box[0]
    tiles = np.zeros((height + TILE_ROWS - 1, width + TILE_COLUMNS - 1), np.int64)
    fill_depth(projected, faces, candidates, box, mask, np.empty(SET_UP, np.float64), tiles)
    return tiles


@njit(**JIT)
def look_at_faces(vertices, lens, margin, faces, wants_candidates):
    """Project up to LANES bodies and find their front faces; see `project` and `find_front`.

    Args:
        vertices: (n, V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        margin: added to the boxes [px].
        faces: (F, 3), vertex numbers.
        wants_candidates: list the candidates.

    Returns:
        projected, boxes, front, candidates, counts.
    """
    count = vertices.shape[0]
    boxes, projected = np.empty((count, 4), np.int64), np.empty((count, vertices.shape[1], 4), np.float64)
    front, counts = np.empty(faces.shape[0], np.uint8), np.zeros(count, np.int64)
    candidates = np.empty((count if wants_candidates else 0, faces.shape[0] + 1), np.uint32)
    screen, bounds = np.empty((vertices.shape[1], 3 * LANES), np.float64), np.empty(4 * LANES, np.float64)
    project(vertices, lens, margin, screen, projected, boxes, bounds)
    find_front(screen, faces, boxes, bounds, front, candidates, counts)
    return projected, boxes, front, candidates, counts


@njit(**JIT)
def see_body(vertices, lens, margin, faces, mask):
    """Return one body's projected vertices, its box, and the face seen at each centre of the box's pixels.

    Args:
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        margin: added to the boxes [px].
        faces: (F, 3), vertex numbers.
        mask: bits of an index, by `mask_for`.
    """
    whole = vertices.reshape(1, vertices.shape[0], 3)
    projected, boxes, _, candidates, counts = look_at_faces(whole, lens, margin, faces, True)
    box = boxes[0]
    seen = see_faces(projected[0], faces, candidates[0, : counts[0]], box, mask)
    return projected[0], box, seen[: box[3] - box[1], : box[2] - box[0]]
