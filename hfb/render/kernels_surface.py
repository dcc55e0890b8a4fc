"""Compiled parts: the point of the body that a pixel shows, the texture's colour there, and the way back.

The visible point of a pixel is a face's point at the pixel's centre or, where the centre just misses the body
but the pixel is partly covered, the closest point of the outline edge there: so a silhouette's rim carries the
body's colour, and the colour is continuous as the outline passes the centre.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE
from hfb.render.kernels_outline import closest_parameter
from hfb.render.kernels_vector import add_to_texels, dots, mix_texels


@njit(**INLINE)
def corner_of(faces, f, vertex):
    """Which corner (0, 1, 2) of face f the vertex is."""
    if faces[f, 0] == vertex:
        return 0
    return 1 if faces[f, 1] == vertex else 2


@njit(**INLINE)
def face_point(px, py, projected, i, j, k):
    """Barycentric coordinates of a pixel position in face (i, j, k) on the screen, and the slopes of the last two."""
    x0, y0 = projected[i, 0], projected[i, 1]
    ax, ay = projected[j, 0] - x0, projected[j, 1] - y0
    bx, by = projected[k, 0] - x0, projected[k, 1] - y0
    inverse = 1.0 / (ax * by - bx * ay)
    b1_x, b1_y, b2_x, b2_y = by * inverse, -bx * inverse, -ay * inverse, ax * inverse
    b1 = (px - x0) * b1_x + (py - y0) * b1_y
    b2 = (px - x0) * b2_x + (py - y0) * b2_y
    return 1.0 - b1 - b2, b1, b2, b1_x, b1_y, b2_x, b2_y


@njit(**INLINE)
def uv_of_face(px, py, projected, faces, uv, f):
    """Texture coordinates seen at a pixel position of face f: perspective-correct."""
    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
    b0, b1, b2, _, _, _, _ = face_point(px, py, projected, i, j, k)
    w0, w1, w2 = b0 * projected[i, 2], b1 * projected[j, 2], b2 * projected[k, 2]
    scale = 1.0 / (w0 + w1 + w2)
    return (
        (w0 * uv[f, 0, 0] + w1 * uv[f, 1, 0] + w2 * uv[f, 2, 0]) * scale,
        (w0 * uv[f, 0, 1] + w1 * uv[f, 1, 1] + w2 * uv[f, 2, 1]) * scale,
    )


@njit(**INLINE)
def uv_of_edge(px, py, projected, faces, uv, start, end, f):
    """Texture coordinates at the point of an outline edge (of front face f) closest to a pixel position."""
    x0, y0 = projected[start, 0], projected[start, 1]
    t = closest_parameter(px, py, x0, y0, projected[end, 0] - x0, projected[end, 1] - y0)
    i, j = corner_of(faces, f, start), corner_of(faces, f, end)
    w0, w1 = (1.0 - t) * projected[start, 2], t * projected[end, 2]
    scale = 1.0 / (w0 + w1)
    return (w0 * uv[f, i, 0] + w1 * uv[f, j, 0]) * scale, (w0 * uv[f, i, 1] + w1 * uv[f, j, 1]) * scale


@njit(**INLINE)
def texel_cell(coordinate, size):
    """First texel, share of the next one, and whether the coordinate lies between texel centres (not clamped)."""
    position = coordinate * size - 0.5
    inside = 0.0 < position < size - 1.0
    position = min(max(position, 0.0), size - 1.0)
    texel = min(np.uint32(position), np.uint32(max(size, 2) - 2))
    return texel, position - texel, inside


@njit(**INLINE)
def edge_colour(px, py, projected, faces, uv, start, end, f, texture, alpha, colours, at):
    """Write alpha times the texture's colour at the point of an outline edge (of front face f) closest to (px, py) to
    number `at` of the colours on."""
    size = texture.shape[0]
    step = min(size - 1, 1)
    u, v = uv_of_edge(px, py, projected, faces, uv, start, end, f)
    c, fc, _ = texel_cell(u, size)
    r, fr, _ = texel_cell(v, size)
    kind, t00 = texture.dtype.type, 4 * (r * size + c)
    w00, w01 = kind((1.0 - fr) * (1.0 - fc) * alpha), kind((1.0 - fr) * fc * alpha)
    w10, w11 = kind(fr * (1.0 - fc) * alpha), kind(fr * fc * alpha)
    t01, t10 = t00 + 4 * step, t00 + 4 * step * size
    mix_texels(texture, t00, t01, t10, t10 + 4 * step, w00, w01, w10, w11, colours, at)


@njit(**INLINE)
def sample_gradient(u, v, texture, alpha, picture_gradient, at, texture_gradient):
    """g . texture(u, v), g being the picture's gradient from number `at` on, and alpha times its slopes by u and v;
    adds the texture's own gradient.

    An empty `texture_gradient` leaves that one out.
    """
    size = texture.shape[0]
    step = min(size - 1, 1)
    c, fc, c_inside = texel_cell(u, size)
    r, fr, r_inside = texel_cell(v, size)
    t00 = 4 * (r * size + c)
    t01, t10 = t00 + 4 * step, t00 + 4 * step * size
    t11 = t10 + 4 * step
    g00, g01, g10, g11 = dots(picture_gradient, at, texture, t00, t01, t10, t11)
    if texture_gradient.shape[0] > 0:
        kind = texture.dtype.type
        w00, w01 = kind((1.0 - fr) * (1.0 - fc) * alpha), kind((1.0 - fr) * fc * alpha)
        w10, w11 = kind(fr * (1.0 - fc) * alpha), kind(fr * fc * alpha)
        add_to_texels(texture_gradient, t00, t01, t10, t11, w00, w01, w10, w11, picture_gradient, at)
    above, below = g00 + fc * (g01 - g00), g10 + fc * (g11 - g10)
    slope_u = alpha * size * ((1.0 - fr) * (g01 - g00) + fr * (g11 - g10)) if c_inside else 0.0
    slope_v = alpha * size * (below - above) if r_inside else 0.0
    return above + fr * (below - above), slope_u, slope_v


@njit(**INLINE)
def edge_gradient(
    px, py, projected, faces, uv, start, end, f, texture, alpha, picture_gradient, at, texture_gradient, gradient
):
    """Way back of one rim pixel: returns the pull on alpha, adds those on the two ends of its outline edge."""
    x0, y0 = projected[start, 0], projected[start, 1]
    dx, dy = projected[end, 0] - x0, projected[end, 1] - y0
    t = closest_parameter(px, py, x0, y0, dx, dy)
    i, j = corner_of(faces, f, start), corner_of(faces, f, end)
    u0, v0, u1, v1 = uv[f, i, 0], uv[f, i, 1], uv[f, j, 0], uv[f, j, 1]
    z0, z1 = projected[start, 2], projected[end, 2]
    scale = 1.0 / ((1.0 - t) * z0 + t * z1)
    share = t * z1 * scale
    u, v = u0 + share * (u1 - u0), v0 + share * (v1 - v0)
    of_alpha, slope_u, slope_v = sample_gradient(u, v, texture, alpha, picture_gradient, at, texture_gradient)
    if gradient.shape[0] == 0:
        return of_alpha
    # d share / dt = z0 z1 scale^2
    difference = (slope_u * (u1 - u0) + slope_v * (v1 - v0)) * scale * scale
    gradient[start, 2] -= (1.0 - t) * t * z1 * difference
    gradient[end, 2] += (1.0 - t) * t * z0 * difference
    if 0.0 < t < 1.0:
        pull = z0 * z1 * difference / (dx * dx + dy * dy)
        # t = (p - p0).d / d.d: its derivatives by p0 and p1 at fixed p.
        rx, ry = px - x0, py - y0
        gradient[start, 0] += pull * (2.0 * t * dx - dx - rx)
        gradient[start, 1] += pull * (2.0 * t * dy - dy - ry)
        gradient[end, 0] += pull * (rx - 2.0 * t * dx)
        gradient[end, 1] += pull * (ry - 2.0 * t * dy)
    return of_alpha
