"""Warp kernels: vertices on the screen, and which face is seen at each pixel's centre.

One thread per vertex or face of every body of a batch. Values written by several threads are maxima or sums of whole
numbers, which do not depend on the threads' order: results have the same bits on every run. Geometry is computed in
float64. Conventions (pixels, sides, ties) are those of `render_screen`.
"""
# mypy: ignore-errors
# (Warp compiles these: its types are not mypy's)

from typing import Any

import warp as wp

wp.config.log_level = wp.LOG_ERROR  # its messages on modules and drivers would disturb a command's output
wp.set_module_options({"enable_backward": False})

NONE = wp.constant(wp.int32(-(2**31)))  # code of a pixel that shows neither a face nor an outline edge
ZERO, HALF, ONE = (wp.constant(wp.float64(value)) for value in (0.0, 0.5, 1.0))
ON_EDGE = wp.constant(wp.float64(-1e-9))  # barycentric slack: a centre on a shared edge must not fall between faces
FAR_PX = wp.constant(wp.float64(1e9))  # a corner projected farther out than this is not used


@wp.kernel
def project(
    vertices: wp.array3d(dtype=Any),
    lenses: wp.array2d(dtype=wp.float64),
    subframes: wp.int32,
    near: wp.float64,
    projected: wp.array2d(dtype=wp.vec3d),
):
    """Project vertices; zeros where one cannot be used. Threads: bodies, vertices.

    Args:
        vertices: (B, V, 3) [m], camera coordinates.
        lenses: fx, fy, cx, cy of every image.
        subframes: bodies per image.
        near: nearest depth used [m].
        projected: (B, V), x, y [px], 1/z [1/m], filled.
    """
    b, i = wp.tid()
    n = b / subframes
    point = wp.vec3d()
    z = wp.float64(vertices[b, i, 2])
    if z > near:  # false for NaN too
        inverse = ONE / z
        x = lenses[n, 0] * wp.float64(vertices[b, i, 0]) * inverse + lenses[n, 2]
        y = lenses[n, 1] * wp.float64(vertices[b, i, 1]) * inverse + lenses[n, 3]
        if wp.abs(x) < FAR_PX and wp.abs(y) < FAR_PX and inverse > ZERO:
            point = wp.vec3d(x, y, inverse)
    projected[b, i] = point


wp.overload(project, {"vertices": wp.array3d(dtype=wp.float32)})
wp.overload(project, {"vertices": wp.array3d(dtype=wp.float64)})


@wp.func
def twice_area(p: wp.vec3d, q: wp.vec3d, r: wp.vec3d) -> wp.float64:
    """Return twice the signed area of a triangle on the screen: negative where it looks at the camera.

    Args:
        p: first corner, x, y [px], 1/z.
        q: second corner.
        r: third corner.
    """
    return (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])


@wp.func
def lowest_centre(p: wp.float64, q: wp.float64, r: wp.float64) -> wp.int32:
    """Return the first pixel whose centre is not before three coordinates.

    Args:
        p: first coordinate [px].
        q: second coordinate [px].
        r: third coordinate [px].
    """
    return wp.int32(wp.ceil(wp.max(wp.min(wp.min(p, q), r) - HALF, ZERO)))


@wp.func
def highest_centre(p: wp.float64, q: wp.float64, r: wp.float64, size: wp.int32) -> wp.int32:
    """Return the last pixel of `size` whose centre is not behind three coordinates.

    Args:
        p: first coordinate [px].
        q: second coordinate [px].
        r: third coordinate [px].
        size: number of pixels.
    """
    return wp.int32(wp.floor(wp.min(wp.max(wp.max(p, q), r) - HALF, wp.float64(size - 1))))


@wp.func
def pack(value: wp.float64, index: wp.int64, mask: wp.int64) -> wp.int64:
    """Replace the last bits of a positive number by an index; the order of numbers is kept (to some 11 digits).

    Args:
        value: positive number.
        index: number of a face.
        mask: bits of an index.
    """
    return (wp.cast(value, wp.int64) & (wp.int64(-1) - mask)) | index


@wp.kernel
def see_faces(
    projected: wp.array2d(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    mask: wp.int64,
    front: wp.array2d(dtype=wp.uint8),
    seen: wp.array3d(dtype=wp.int64),
):
    """Mark the faces that look at the camera, and find the nearest one at each pixel's centre. Threads: bodies, faces.

    Args:
        projected: (B, V), x, y [px], 1/z [1/m].
        faces: (F, 3), vertex numbers.
        mask: bits of an index.
        front: (B, F), filled.
        seen: (B, H, W), zeros before: the largest 1/z with the face in the bits of the mask; an empty one is skipped.
    """
    b, f = wp.tid()
    p, q, r = projected[b, faces[f, 0]], projected[b, faces[f, 1]], projected[b, faces[f, 2]]
    usable = p[2] > ZERO and q[2] > ZERO and r[2] > ZERO
    area = twice_area(p, q, r)
    if not (usable and area < ZERO):
        front[b, f] = wp.uint8(0)
        return
    front[b, f] = wp.uint8(1)
    if seen.shape[0] == 0:
        return
    height, width = seen.shape[1], seen.shape[2]
    c_from, c_to = lowest_centre(p[0], q[0], r[0]), highest_centre(p[0], q[0], r[0], width)
    r_from, r_to = lowest_centre(p[1], q[1], r[1]), highest_centre(p[1], q[1], r[1], height)
    inverse = ONE / area
    slope_q = wp.vec2d((r[1] - p[1]) * inverse, (p[0] - r[0]) * inverse)
    slope_r = wp.vec2d((p[1] - q[1]) * inverse, (q[0] - p[0]) * inverse)
    for row in range(r_from, r_to + 1):
        for column in range(c_from, c_to + 1):
            off = wp.vec2d(wp.float64(column) + HALF - p[0], wp.float64(row) + HALF - p[1])
            b_q, b_r = wp.dot(off, slope_q), wp.dot(off, slope_r)
            b_p = ONE - b_q - b_r
            if wp.min(wp.min(b_p, b_q), b_r) >= ON_EDGE:
                depth = b_p * p[2] + b_q * q[2] + b_r * r[2]
                wp.atomic_max(seen, b, row, column, pack(depth, wp.int64(f), mask))


@wp.func
def outline_edge(
    front: wp.array2d(dtype=wp.uint8),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    b: wp.int32,
    e: wp.int32,
) -> wp.vec3i:
    """Return (from, to, front face) of an edge where the front faces end, as that face traverses it; face -1 elsewhere.

    Args:
        front: (B, F), faces that look at the camera.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        b: number of the body.
        e: number of the edge.
    """
    first, second = edge_faces[e, 0], edge_faces[e, 1]
    start, end = edge_vertices[e, 0], edge_vertices[e, 1]
    is_first = front[b, first] != wp.uint8(0)
    is_second = False
    if second >= 0:
        is_second = front[b, second] != wp.uint8(0)
    edge = wp.vec3i(start, end, -1)
    if is_first and not is_second:
        edge = wp.vec3i(start, end, first)
    if is_second and not is_first:
        edge = wp.vec3i(end, start, second)
    return edge


@wp.func
def closest_parameter(point: wp.vec2d, start: wp.vec3d, end: wp.vec3d) -> wp.float64:
    """Return the parameter in [0, 1] of the point of an edge closest to a position.

    Args:
        point: position [px].
        start: first end of the edge, x, y [px].
        end: second end of the edge.
    """
    along = wp.vec2d(end[0] - start[0], end[1] - start[1])
    squared_length = wp.dot(along, along)
    t = ZERO
    if squared_length > ZERO:
        away = wp.vec2d(point[0] - start[0], point[1] - start[1])
        t = wp.min(wp.max(wp.dot(away, along) / squared_length, ZERO), ONE)
    return t


@wp.func
def squared_distance(point: wp.vec2d, start: wp.vec3d, end: wp.vec3d) -> wp.float64:
    """Return the squared distance [px^2] of a position from an edge.

    Args:
        point: position [px].
        start: first end of the edge, x, y [px].
        end: second end of the edge.
    """
    t = closest_parameter(point, start, end)
    off = wp.vec2d(
        start[0] + t * (end[0] - start[0]) - point[0],
        start[1] + t * (end[1] - start[1]) - point[1],
    )
    return wp.dot(off, off)
