"""Warp kernels: gradients by the vertices from those by the pixels.

Every sum belongs to one thread, which adds in a fixed order: a face over the pixels that show it, an outline edge over
its pieces, a vertex over its faces and edges. No two threads write to one place.
"""
# mypy: ignore-errors
# (Warp compiles these: its types are not mypy's)

from typing import Any

import warp as wp

from hfb.kernels.warp.screen import (
    HALF,
    ONE,
    ZERO,
    closest_parameter,
    highest_centre,
    lowest_centre,
    outline_edge,
    twice_area,
)
from hfb.kernels.warp.surface import corner_of, face_weights

wp.set_module_options({"enable_backward": False})

TWO = wp.constant(wp.float64(2.0))


@wp.kernel
def faces_backward(
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    faces: wp.array2d(dtype=wp.int32),
    uv: wp.array2d(dtype=wp.vec2d),
    codes: wp.array3d(dtype=wp.int32),
    of_pixels: wp.array3d(dtype=wp.vec3d),
    on_corners: wp.array3d(dtype=wp.vec3d),
):
    """Compute gradients by each face's corners (x, y, 1/z) through the colours it shows. Threads: bodies, faces.

    A corner moving by d shifts any quantity q interpolated at a fixed position by -b (grad q . d); a change of its 1/z
    by e shifts u by b (u_corner - u) e / (sum b / z).

    Args:
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        faces: (F, 3), vertex numbers.
        uv: (F, 3), texture coordinates of the faces' corners.
        codes: (B, H, W), what each pixel shows.
        of_pixels: (B, H, W), gradient by each pixel's coverage, u and v.
        on_corners: (B, F, 3), gradient, filled.
    """
    b, f = wp.tid()
    sum_p, sum_q, sum_r = wp.vec3d(), wp.vec3d(), wp.vec3d()
    if front[b, f] != wp.uint8(0):
        p, q, r = projected[b, faces[f, 0]], projected[b, faces[f, 1]], projected[b, faces[f, 2]]
        depths, inverse = wp.vec3d(p[2], q[2], r[2]), ONE / twice_area(p, q, r)
        slope_q = wp.vec2d((r[1] - p[1]) * inverse, (p[0] - r[0]) * inverse)
        slope_r = wp.vec2d((p[1] - q[1]) * inverse, (q[0] - p[0]) * inverse)
        c_from, c_to = lowest_centre(p[0], q[0], r[0]), highest_centre(p[0], q[0], r[0], codes.shape[2])
        r_from, r_to = lowest_centre(p[1], q[1], r[1]), highest_centre(p[1], q[1], r[1], codes.shape[1])
        for row in range(r_from, r_to + 1):
            for column in range(c_from, c_to + 1):
                if codes[b, row, column] == f:
                    centre = wp.vec2d(wp.float64(column) + HALF, wp.float64(row) + HALF)
                    weights = face_weights(centre, p, q, r)
                    w = wp.cw_mul(weights, depths)
                    scale = ONE / (w[0] + w[1] + w[2])
                    at = (w[0] * uv[f, 0] + w[1] * uv[f, 1] + w[2] * uv[f, 2]) * scale
                    of_pixel = of_pixels[b, row, column]
                    slopes = wp.vec2d(of_pixel[1], of_pixel[2]) * scale
                    d_p, d_q = wp.dot(slopes, uv[f, 0] - at), wp.dot(slopes, uv[f, 1] - at)
                    d_r = wp.dot(slopes, uv[f, 2] - at)
                    base = d_p * p[2]
                    moved = (d_q * q[2] - base) * slope_q + (d_r * r[2] - base) * slope_r
                    sum_p = sum_p + weights[0] * wp.vec3d(-moved[0], -moved[1], d_p)
                    sum_q = sum_q + weights[1] * wp.vec3d(-moved[0], -moved[1], d_q)
                    sum_r = sum_r + weights[2] * wp.vec3d(-moved[0], -moved[1], d_r)
    on_corners[b, f, 0] = sum_p
    on_corners[b, f, 1] = sum_q
    on_corners[b, f, 2] = sum_r


@wp.func
def rim_pull(centre: wp.vec2d, start: wp.vec3d, end: wp.vec3d, by_uv: wp.float64):
    """Return gradients by an edge's ends, through its point closest to a pixel's centre.

    Args:
        centre: centre of the pixel [px].
        start: start of the edge, x, y [px], 1/z.
        end: end of the edge, likewise.
        by_uv: gradient by the share of the end in the texture coordinates, (slope . (uv_end - uv_start)).
    """
    x, y = end[0] - start[0], end[1] - start[1]
    t = closest_parameter(centre, start, end)
    scale = ONE / ((ONE - t) * start[2] + t * end[2])
    difference = by_uv * scale * scale  # d share / dt = z0 z1 scale^2
    of_start = wp.vec3d(ZERO, ZERO, -(ONE - t) * t * end[2] * difference)
    of_end = wp.vec3d(ZERO, ZERO, (ONE - t) * t * start[2] * difference)
    if t > ZERO and t < ONE:
        # t = (p - p0).d / d.d: its derivatives by p0 and p1 at fixed p.
        of_t = start[2] * end[2] * difference / (x * x + y * y)
        rx, ry = centre[0] - start[0], centre[1] - start[1]
        of_start = of_start + of_t * wp.vec3d(TWO * t * x - x - rx, TWO * t * y - y - ry, ZERO)
        of_end = of_end + of_t * wp.vec3d(rx - TWO * t * x, ry - TWO * t * y, ZERO)
    return of_start, of_end


@wp.kernel
def edges_backward(
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    faces: wp.array2d(dtype=wp.int32),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    uv: wp.array2d(dtype=wp.vec2d),
    begins: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3i),
    shares: wp.array(dtype=wp.vec2d),
    codes: wp.array3d(dtype=wp.int32),
    of_pixels: wp.array3d(dtype=wp.vec3d),
    on_ends: wp.array3d(dtype=wp.vec3d),
):
    """Compute gradients by the ends of each outline edge, in the order of `edge_vertices`. Threads: bodies, edges.

    Moving a piece p(t) by v(t) changes its pixel's coverage by the integral of cross(v, dp): the swept area. An edge
    that gives a pixel its colour crosses it, so those pixels are among the pieces' too.

    Args:
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        faces: (F, 3), vertex numbers.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        uv: (F, 3), texture coordinates of the faces' corners.
        begins: number of each edge's first piece.
        place: row, column and edge of each piece.
        shares: shares of each piece, derivative of coverage by the edge's ends.
        codes: (B, H, W), what each pixel shows.
        of_pixels: (B, H, W), gradient by each pixel's coverage, u and v.
        on_ends: (B, E, 2), gradient, filled.
    """
    b, e = wp.tid()
    of_start, of_end = wp.vec3d(), wp.vec3d()
    n, beyond = begins[b * edge_vertices.shape[0] + e], begins[b * edge_vertices.shape[0] + e + 1]
    edge = outline_edge(front, edge_vertices, edge_faces, b, e)
    if n < beyond:
        start, end, owner = projected[b, edge[0]], projected[b, edge[1]], edge[2]
        x, y = end[0] - start[0], end[1] - start[1]
        across = wp.vec2d()
        if codes.shape[0] > 0:
            across = uv[owner, corner_of(faces, owner, edge[1])] - uv[owner, corner_of(faces, owner, edge[0])]
        for piece in range(n, beyond):
            at = place[piece]
            if at[2] > 0:
                of_pixel, share = of_pixels[b, at[0], at[1]], shares[piece]
                swept = of_pixel[0] * wp.vec3d(-y, x, ZERO)
                of_start = of_start + share[0] * swept
                of_end = of_end + share[1] * swept
                if codes.shape[0] > 0:  # noqa: SIM102 (of an "and" Warp would read both sides)
                    if codes[b, at[0], at[1]] == -1 - e:
                        centre = wp.vec2d(wp.float64(at[1]) + HALF, wp.float64(at[0]) + HALF)
                        by_uv = of_pixel[1] * across[0] + of_pixel[2] * across[1]
                        more_start, more_end = rim_pull(centre, start, end, by_uv)
                        of_start = of_start + more_start
                        of_end = of_end + more_end
    if edge[0] == edge_vertices[e, 0]:
        on_ends[b, e, 0] = of_start
        on_ends[b, e, 1] = of_end
    else:
        on_ends[b, e, 0] = of_end
        on_ends[b, e, 1] = of_start


@wp.kernel
def gather(
    vertices: wp.array3d(dtype=Any),
    projected: wp.array2d(dtype=wp.vec3d),
    lenses: wp.array2d(dtype=wp.float64),
    subframes: wp.int32,
    corner_begins: wp.array(dtype=wp.int32),
    corners: wp.array(dtype=wp.int32),
    end_begins: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    on_corners: wp.array3d(dtype=wp.vec3d),
    on_ends: wp.array3d(dtype=wp.vec3d),
    gradient: wp.array3d(dtype=Any),
):
    """Sum the gradients by the corners and ends of each vertex [1/m]. Threads: bodies, vertices.

    The chain rule through x = fx X / Z + cx, y = fy Y / Z + cy, q = 1 / Z.

    Args:
        vertices: (B, V, 3) [m], camera coordinates.
        projected: (B, V), x, y [px], 1/z [1/m].
        lenses: fx, fy, cx, cy of every image.
        subframes: bodies per image.
        corner_begins: position of each vertex's first corner.
        corners: numbers 3 f + k of each vertex's corners.
        end_begins: position of each vertex's first end.
        ends: numbers 2 e + k of each vertex's ends.
        on_corners: (B, F, 3), by `faces_backward`.
        on_ends: (B, E, 2), by `edges_backward`.
        gradient: (B, V, 3), filled.
    """
    b, i = wp.tid()
    total, point = wp.vec3d(), projected[b, i]
    if on_corners.shape[0] > 0:
        for m in range(corner_begins[i], corner_begins[i + 1]):
            total = total + on_corners[b, corners[m] / 3, corners[m] % 3]
    for m in range(end_begins[i], end_begins[i + 1]):
        total = total + on_ends[b, ends[m] / 2, ends[m] % 2]
    found = wp.vec3d()
    if point[2] > ZERO:
        n = b / subframes
        gx, gy = total[0] * lenses[n, 0], total[1] * lenses[n, 1]
        by_inverse = total[2] + gx * wp.float64(vertices[b, i, 0]) + gy * wp.float64(vertices[b, i, 1])
        found = wp.vec3d(gx * point[2], gy * point[2], -point[2] * point[2] * by_inverse)
    for k in range(3):
        gradient[b, i, k] = gradient.dtype(found[k])


for _real in (wp.float32, wp.float64):
    wp.overload(gather, {"vertices": wp.array3d(dtype=_real), "gradient": wp.array3d(dtype=_real)})
