"""Compiled parts: colours of all of a body's pixels, and the way back, a batch of pixels at a time.

A pixel's way from its face through the texture is one long chain of operations, each waiting for the one before. A
batch goes through it in steps, one loop each: memory is gathered into rows, arithmetic runs along the rows (many pixels
at once in one register), texels are mixed, and what is asked of the corners is scattered. Rows lie in one array, BATCH
apart: so the compiler sees that they never overlap.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE, LOOP
from hfb.render.kernels_screen import NOTHING
from hfb.render.kernels_surface import edge_colour, edge_gradient
from hfb.render.kernels_vector import (
    BATCH,
    add_corner,
    add_to_texels,
    dots,
    gather_face,
    gather_four,
    mix_texels,
)
from hfb.vector_code import prefetch

# Blocks of what is gathered, several numbers of a pixel side by side: the face's second and third corner as seen from
# its first (x, y, 1/z, -), the pixel as seen from there (x, y, - 1/z there, alpha), and texture coordinates (of the
# first two corners, of the third).
SECOND, THIRD, PIXEL, UV, UV_2 = (BATCH * block for block in (0, 4, 8, 12, 16))
GATHERED = 18 * BATCH
# Rows of what is found: weights of the last two corners and their slopes, 1 / (sum of weights / z), texture
# coordinates, shares of the next texel, weights of the four texels.
B1, B2, B1_X, B1_Y, B2_X, B2_Y, SCALE, U, V, RIGHT, DOWN, W00, W01, W10, W11 = (BATCH * row for row in range(15))
# Way back: the picture's gradient times each of the four texels; then what is asked of the corners.
G00, G01, G10, G11, D0, D1, D2, SLOPE_X, SLOPE_Y = (BATCH * row for row in range(15, 24))
FOUND = 24 * BATCH
# Rows of a batch's places (int32): the pixel's place in its list and in the picture, corners in (V, 4), first texel.
SLOT, AT, CORNER_0, CORNER_1, CORNER_2, TEXEL = (BATCH * row for row in range(6))
PLACES = 6 * BATCH


@njit(**INLINE)
def _look_ahead(m, codes, projected, faces, uv):
    """Ask for the memory that pixels further down the list will need."""
    last = codes.shape[0] - 1
    f = np.int64(max(codes[min(m + 32, last)], 0))
    prefetch(faces, 3 * f)
    prefetch(uv, 6 * f)
    prefetch(uv, 6 * f + 5)
    f = np.int64(max(codes[min(m + 16, last)], 0))
    prefetch(projected, 4 * np.int64(faces[f, 0]))
    prefetch(projected, 4 * np.int64(faces[f, 1]))
    prefetch(projected, 4 * np.int64(faces[f, 2]))


@njit(**INLINE)
def _gather(n, m, pixel, row, column, alpha, projected, faces, uv, f, near, places):
    """Write what pixel m of the list needs of face f into column n of the batch."""
    i, j, k = 4 * np.int64(faces[f, 0]), 4 * np.int64(faces[f, 1]), 4 * np.int64(faces[f, 2])
    gather_face(near, 4 * n, projected, i, j, k, column + 0.5, row + 0.5, alpha)
    gather_four(near, UV + 4 * n, uv, 6 * np.int64(f))
    near[UV_2 + 2 * n], near[UV_2 + 2 * n + 1] = uv[f, 2, 0], uv[f, 2, 1]
    places[SLOT + n], places[AT + n] = m, 4 * pixel
    places[CORNER_0 + n], places[CORNER_1 + n], places[CORNER_2 + n] = i, j, k


@njit(**LOOP)
def _interpolate(n, size, near, table, places):
    """From the faces' corners to the texels: perspective-correct texture coordinates and bilinear weights."""
    last, most = size - 1.0, np.int32(max(size, 2) - 2)
    for m in range(n):
        ax, ay, bx, by = near[SECOND + 4 * m], near[SECOND + 4 * m + 1], near[THIRD + 4 * m], near[THIRD + 4 * m + 1]
        px, py, z0 = near[PIXEL + 4 * m], near[PIXEL + 4 * m + 1], -near[PIXEL + 4 * m + 2]
        inverse = 1.0 / (ax * by - bx * ay)
        b1_x, b1_y, b2_x, b2_y = by * inverse, -bx * inverse, -ay * inverse, ax * inverse
        b1, b2 = px * b1_x + py * b1_y, px * b2_x + py * b2_y
        table[B1 + m], table[B2 + m] = b1, b2
        table[B1_X + m], table[B1_Y + m], table[B2_X + m], table[B2_Y + m] = b1_x, b1_y, b2_x, b2_y
        w0 = (1.0 - b1 - b2) * z0
        w1, w2 = b1 * (z0 + near[SECOND + 4 * m + 2]), b2 * (z0 + near[THIRD + 4 * m + 2])
        scale = 1.0 / (w0 + w1 + w2)
        u = (w0 * near[UV + 4 * m] + w1 * near[UV + 4 * m + 2] + w2 * near[UV_2 + 2 * m]) * scale
        v = (w0 * near[UV + 4 * m + 1] + w1 * near[UV + 4 * m + 3] + w2 * near[UV_2 + 2 * m + 1]) * scale
        table[SCALE + m], table[U + m], table[V + m] = scale, u, v
        x, y = min(max(u * size - 0.5, 0.0), last), min(max(v * size - 0.5, 0.0), last)
        c, r = max(min(np.int32(x), most), 0), max(min(np.int32(y), most), 0)  # a texel even where x is not a number
        fc, fr = x - c, y - r
        alpha = near[PIXEL + 4 * m + 3]
        table[RIGHT + m], table[DOWN + m] = fc, fr
        below, above = fr * alpha, (1.0 - fr) * alpha
        table[W00 + m], table[W01 + m] = above * (1.0 - fc), above * fc
        table[W10 + m], table[W11 + m] = below * (1.0 - fc), below * fc
        places[TEXEL + m] = np.int32(4) * (r * np.int32(size) + c)


@njit(**LOOP)
def _mix(n, texture, table, places, colours):
    size, kind = texture.shape[0], texture.dtype.type
    right = 4 * min(size - 1, 1)
    down = right * size
    for m in range(n):
        t00, at = np.int64(places[TEXEL + m]), 4 * np.int64(places[SLOT + m])
        mix_texels(
            texture, t00, t00 + right, t00 + down, t00 + down + right,
            kind(table[W00 + m]), kind(table[W01 + m]), kind(table[W10 + m]), kind(table[W11 + m]), colours, at,
        )  # fmt: skip


@njit(**LOOP)
def shade(pixels, codes, coverage, width, outline, projected, faces, uv, texture, near, table, places, colours):
    """Fill `colours` (n, 4): coverage times the texture (bilinear, clamped at its border), whose 4th channel is 1.

    near, table, places: room for a batch, GATHERED and FOUND numbers (float64: faces may be thin) and PLACES int32.
    """
    size = texture.shape[0]
    row, n = 0, 0
    for m in range(pixels.shape[0]):
        pixel = np.int64(pixels[m])
        while pixel >= (row + 1) * width:
            row += 1
        column, code, alpha = pixel - row * width, codes[m], min(coverage[m], 1.0)
        if code >= 0:
            _look_ahead(m, codes, projected, faces, uv)
            _gather(n, m, pixel, row, column, alpha, projected, faces, uv, np.uint32(code), near, places)
            n += 1
            if n == BATCH:
                _interpolate(n, size, near, table, places)
                _mix(n, texture, table, places, colours)
                n = 0
        elif code != NOTHING:
            k = np.uint32(~code)
            edge_colour(
                column + 0.5, row + 0.5, projected, faces, uv, outline[k, 0], outline[k, 1], outline[k, 2],
                texture, alpha, colours, 4 * m,
            )  # fmt: skip
        else:
            colours[m, 0], colours[m, 1], colours[m, 2], colours[m, 3] = 0.0, 0.0, 0.0, alpha
    _interpolate(n, size, near, table, places)
    _mix(n, texture, table, places, colours)


@njit(**LOOP)
def _ask_texels(n, texture, picture_gradient, table, places, texture_gradient):
    """The picture's gradient times each of the four texels; adds the texture's own gradient where it is wanted."""
    size, kind = texture.shape[0], texture.dtype.type
    right = 4 * min(size - 1, 1)
    down = right * size
    for m in range(n):
        t00, at = np.int64(places[TEXEL + m]), np.int64(places[AT + m])
        t01, t10, t11 = t00 + right, t00 + down, t00 + down + right
        g00, g01, g10, g11 = dots(picture_gradient, at, texture, t00, t01, t10, t11)
        table[G00 + m], table[G01 + m], table[G10 + m], table[G11 + m] = g00, g01, g10, g11
        if texture_gradient.shape[0] > 0:
            add_to_texels(
                texture_gradient, t00, t01, t10, t11,
                kind(table[W00 + m]), kind(table[W01 + m]), kind(table[W10 + m]), kind(table[W11 + m]),
                picture_gradient, at,
            )  # fmt: skip


@njit(**LOOP)
def _ask_corners(n, size, near, table):
    """From the texels to the corners: G00 receives the pull on alpha, D and SLOPE what `_scatter` needs.

    A corner moving by d shifts any quantity q interpolated at a fixed position by -b (grad q . d); a change of
    its 1/z by e shifts u by b (u_corner - u) e / (sum b / z).
    """
    last = size - 1.0
    for m in range(n):
        g00, g01, g10, g11 = table[G00 + m], table[G01 + m], table[G10 + m], table[G11 + m]
        fc, fr, u, v = table[RIGHT + m], table[DOWN + m], table[U + m], table[V + m]
        above, below = g00 + fc * (g01 - g00), g10 + fc * (g11 - g10)
        of_alpha = above + fr * (below - above)
        steep = near[PIXEL + 4 * m + 3] * size * table[SCALE + m]
        x, y = u * size - 0.5, v * size - 0.5
        slope_u = steep * ((1.0 - fr) * (g01 - g00) + fr * (g11 - g10))
        slope_v = steep * (below - above)
        slope_u = slope_u if (x > 0.0) & (x < last) else 0.0
        slope_v = slope_v if (y > 0.0) & (y < last) else 0.0
        d0 = slope_u * (near[UV + 4 * m] - u) + slope_v * (near[UV + 4 * m + 1] - v)
        d1 = slope_u * (near[UV + 4 * m + 2] - u) + slope_v * (near[UV + 4 * m + 3] - v)
        d2 = slope_u * (near[UV_2 + 2 * m] - u) + slope_v * (near[UV_2 + 2 * m + 1] - v)
        z0 = -near[PIXEL + 4 * m + 2]
        at_0 = d0 * z0
        first = d1 * (z0 + near[SECOND + 4 * m + 2]) - at_0
        second = d2 * (z0 + near[THIRD + 4 * m + 2]) - at_0
        table[G00 + m], table[D0 + m], table[D1 + m], table[D2 + m] = of_alpha, d0, d1, d2
        table[SLOPE_X + m] = -(first * table[B1_X + m] + second * table[B2_X + m])
        table[SLOPE_Y + m] = -(first * table[B1_Y + m] + second * table[B2_Y + m])


@njit(**LOOP)
def _scatter(n, scale, table, places, of_coverage, gradient):
    """Hand each pixel's pull on alpha to its coverage, and what it asks of its face's corners to them."""
    for m in range(n):
        of_coverage[np.uint32(places[SLOT + m])] = scale * table[G00 + m]
    if gradient.shape[0] > 0:
        for m in range(n):
            b1, b2 = table[B1 + m], table[B2 + m]
            b0 = 1.0 - b1 - b2
            x, y = table[SLOPE_X + m], table[SLOPE_Y + m]
            add_corner(gradient, places[CORNER_0 + m], b0, x, y, table[D0 + m])
            add_corner(gradient, places[CORNER_1 + m], b1, x, y, table[D1 + m])
            add_corner(gradient, places[CORNER_2 + m], b2, x, y, table[D2 + m])


@njit(**LOOP)
def _batch_gradient(n, texture, picture_gradient, scale, near, table, places, of_coverage, on_screen, texture_gradient):
    size = texture.shape[0]
    _interpolate(n, size, near, table, places)
    _ask_texels(n, texture, picture_gradient, table, places, texture_gradient)
    _ask_corners(n, size, near, table)
    _scatter(n, scale, table, places, of_coverage, on_screen)


@njit(**LOOP)
def shade_gradient(
    width, faces, uv, texture, projected, outline, pixels, coverage, codes,
    picture_gradient, scale, near, table, places, of_coverage, on_screen, texture_gradient,
):  # fmt: skip
    """Way back of `shade`: fills the coverage's gradient, adds to the corners' (V, 4; the last unused) and to the
    texture's. An empty `on_screen` or `texture_gradient` leaves that one out."""
    row, n = 0, 0
    for m in range(pixels.shape[0]):
        pixel = np.int64(pixels[m])
        while pixel >= (row + 1) * width:
            row += 1
        column, code, alpha = pixel - row * width, codes[m], scale * min(coverage[m], 1.0)
        if code >= 0:
            _look_ahead(m, codes, projected, faces, uv)
            _gather(n, m, pixel, row, column, alpha, projected, faces, uv, np.uint32(code), near, places)
            n += 1
            if n == BATCH:
                _batch_gradient(
                    n, texture, picture_gradient, scale, near, table, places, of_coverage, on_screen, texture_gradient
                )
                n = 0
        elif code != NOTHING:
            k = np.uint32(~code)
            of_alpha = edge_gradient(
                column + 0.5, row + 0.5, projected, faces, uv, outline[k, 0], outline[k, 1], outline[k, 2],
                texture, alpha, picture_gradient, 4 * pixel, texture_gradient, on_screen,
            )  # fmt: skip
            of_coverage[m] = scale * of_alpha
        else:
            of_coverage[m] = scale * np.float64(picture_gradient[pixel, 3])
    _batch_gradient(n, texture, picture_gradient, scale, near, table, places, of_coverage, on_screen, texture_gradient)
