"""Compiled shading: the visible point of each pixel, its colour, and gradients, in batches of pixels.

The visible point of a pixel is a face's point at the pixel's centre or, where the centre just misses the body but the
pixel is partly covered, the closest point of the outline edge there: so a silhouette's rim has the body's colour, and
the colour is continuous as the outline passes the centre.

The computation of a pixel's colour is one long chain of operations, each waiting for the one before. So pixels are
processed in batches, step by step, one loop each: memory is gathered, arithmetic runs along rows (many pixels at once
in one register), texels are mixed, and gradients are scattered to the corners. Rows are in one array, BATCH apart, so
that the compiler knows that they do not overlap. They have the texture's precision; positions, which are large, are
taken relative to the first corner before they are rounded. Pixels of faces and pixels of the rim have separate batches,
and are sorted into them without branches, which no processor could predict.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, LOOP
from hfb.kernels.rendering.render_screen import NOTHING
from hfb.kernels.rendering.render_surface import corner_of
from hfb.kernels.rendering.render_vector import (
    BATCH,
    add_corner,
    add_to_texels,
    dots,
    gather_face,
    gather_four,
    mix_texels,
    untangle,
)

# Blocks of what is gathered, four numbers of a pixel side by side: the second corner as seen from the first (x, y, 1/z)
# and the third's u, the third corner as seen from the first and its v, the pixel as seen from there (x, y, - 1/z there,
# alpha), and texture coordinates of the first two corners. An edge is a face without a third corner.
SECOND, THIRD, PIXEL, UV = (BATCH * block for block in range(0, 16, 4))
GATHERED = 16 * BATCH
# The same as rows.
AX, AY, AZ, U2, BX, BY, BZ, V2, PX, PY, Z, ALPHA, U0, V0, U1, V1 = (BATCH * row for row in range(16))
# Weights of the last two corners and their slopes; of an edge its end's, and what the offset of the pixel adds.
B1, B2, B1_X, B1_Y, B2_X, B2_Y = (BATCH * row for row in range(16, 22))
OFF_X, OFF_Y = B2_X, B2_Y
# 1 / (sum of weights / z), texture coordinates, shares of the next texel, weights of the four texels.
SCALE, U, V, RIGHT, DOWN, W00, W01, W10, W11 = (BATCH * row for row in range(22, 31))
# Backward: the image's gradient times each of the four texels; then, in rows that are free by then, the gradients
# by the corners.
G00, G01, G10, G11, D0, D1, D2 = (BATCH * row for row in range(31, 38))
OF_ALPHA, OF_B1, OF_B2, PULL_X, PULL_Y = G00, G01, G10, G11, SCALE
FOUND = 38 * BATCH
# Rows of a batch's places (int32): the pixel's place in its list and in the image, corners in (V, 4), first texel.
SLOT, AT, CORNER_0, CORNER_1, CORNER_2, TEXEL = (BATCH * row for row in range(6))
PLACES = 6 * BATCH
TINY_PX2 = 1e-30  # twice the area of a face that is a line


@njit(**INLINE)
def _centre(pixel, width):
    """Return position [px] of a pixel's centre."""
    row = np.uint32(pixel) // np.uint32(width)
    return np.float64(np.uint32(pixel) - row * np.uint32(width)) + 0.5, np.float64(row) + 0.5


@njit(**LOOP)
def _gather_faces(n, width, pixels, codes, coverage, scale, projected, faces, uv, near, places):
    """Write what the n pixels of a batch need of their faces."""
    for q in range(n):
        m = np.uint32(places[SLOT + q])
        f, pixel = np.uint32(codes[m]), pixels[m]
        x, y = _centre(pixel, width)
        i, j, k = 4 * np.int64(faces[f, 0]), 4 * np.int64(faces[f, 1]), 4 * np.int64(faces[f, 2])
        alpha = scale * min(coverage[m], 1.0)
        gather_face(near, 4 * q, projected, i, j, k, x, y, alpha, uv[f, 2, 0], uv[f, 2, 1])
        gather_four(near, UV + 4 * q, uv, 6 * np.int64(f))
        places[AT + q] = 4 * pixel
        places[CORNER_0 + q], places[CORNER_1 + q], places[CORNER_2 + q] = i, j, k


@njit(**LOOP)
def _gather_edges(n, width, pixels, codes, coverage, scale, outline, projected, faces, uv, near, places):
    """Write what the n pixels of a batch need of their outline edges."""
    for q in range(n):
        m = np.uint32(places[SLOT + q])
        edge, pixel = np.uint32(~codes[m]), pixels[m]
        x, y = _centre(pixel, width)
        start, end, f = outline[edge, 0], outline[edge, 1], outline[edge, 2]
        i, j = 4 * np.int64(start), 4 * np.int64(end)
        gather_face(near, 4 * q, projected, i, j, i, x, y, scale * min(coverage[m], 1.0), 0.0, 0.0)
        first, second = corner_of(faces, f, start), corner_of(faces, f, end)
        near[UV + 4 * q], near[UV + 4 * q + 1] = uv[f, first, 0], uv[f, first, 1]
        near[UV + 4 * q + 2], near[UV + 4 * q + 3] = uv[f, second, 0], uv[f, second, 1]
        places[AT + q] = 4 * pixel
        places[CORNER_0 + q], places[CORNER_1 + q] = i, j


@njit(**LOOP)
def _untangle(n, near, table):
    """Transpose the gathered numbers to rows."""
    for q in range(0, n, 8):
        for block in range(0, GATHERED, 4 * BATCH):
            untangle(table, block + q, near, block + 4 * q)


@njit(**LOOP)
def _weigh_corners(n, table):
    """Compute weights of a face's corners at the pixel's centre, which is inside it, and their slopes."""
    kind = table.dtype.type
    zero, one, tiny = kind(0.0), kind(1.0), kind(TINY_PX2)
    for m in range(n):
        ax, ay, bx, by = table[AX + m], table[AY + m], table[BX + m], table[BY + m]
        px, py = table[PX + m], table[PY + m]
        area = ax * by - bx * ay
        inverse = one / area if abs(area) > tiny else zero
        b1_x, b1_y, b2_x, b2_y = by * inverse, -bx * inverse, -ay * inverse, ax * inverse
        # Within the face, whatever rounding makes of one that is almost a line.
        b1 = min(max(px * b1_x + py * b1_y, zero), one)
        b2 = min(max(px * b2_x + py * b2_y, zero), one - b1)
        table[B1 + m], table[B2 + m] = b1, b2
        table[B1_X + m], table[B1_Y + m], table[B2_X + m], table[B2_Y + m] = b1_x, b1_y, b2_x, b2_y


@njit(**LOOP)
def _weigh_ends(n, table):
    """Compute the weight of an edge's end at its point closest to the pixel's centre, and its derivatives.

    (OFF_X, OFF_Y) is the derivative by the edge's start moving against its end, since the point is off the centre.
    """
    kind = table.dtype.type
    zero, one, tiny = kind(0.0), kind(1.0), kind(TINY_PX2)
    for m in range(n):
        dx, dy, px, py = table[AX + m], table[AY + m], table[PX + m], table[PY + m]
        squared = dx * dx + dy * dy
        inverse = one / squared if squared > tiny else zero
        t = (px * dx + py * dy) * inverse
        inverse = inverse if (t > zero) & (t < one) else zero  # an end stays the closest point
        t = min(max(t, zero), one)
        table[B1 + m], table[B2 + m] = t, zero
        table[B1_X + m], table[B1_Y + m] = dx * inverse, dy * inverse
        table[OFF_X + m], table[OFF_Y + m] = (px - t * dx) * inverse, (py - t * dy) * inverse


@njit(**LOOP)
def _find_texels(n, size, table, places):
    """Compute, from the corners' weights, perspective-correct texture coordinates and bilinear weights."""
    kind = table.dtype.type
    zero, half, one, across = kind(0.0), kind(0.5), kind(1.0), kind(size)
    last, most = across - one, np.int32(max(size, 2) - 2)
    for m in range(n):
        b1, b2, z0 = table[B1 + m], table[B2 + m], -table[Z + m]
        w0 = (one - b1 - b2) * z0
        w1, w2 = b1 * (z0 + table[AZ + m]), b2 * (z0 + table[BZ + m])
        scale = one / (w0 + w1 + w2)
        u = (w0 * table[U0 + m] + w1 * table[U1 + m] + w2 * table[U2 + m]) * scale
        v = (w0 * table[V0 + m] + w1 * table[V1 + m] + w2 * table[V2 + m]) * scale
        x, y = min(max(u * across - half, zero), last), min(max(v * across - half, zero), last)
        c, r = max(min(np.int32(x), most), 0), max(min(np.int32(y), most), 0)  # a texel even where x is not a number
        fc, fr = x - kind(c), y - kind(r)
        below, above = fr * table[ALPHA + m], (one - fr) * table[ALPHA + m]
        table[SCALE + m], table[U + m], table[V + m], table[RIGHT + m], table[DOWN + m] = scale, u, v, fc, fr
        table[W00 + m], table[W01 + m] = above * (one - fc), above * fc
        table[W10 + m], table[W11 + m] = below * (one - fc), below * fc
        places[TEXEL + m] = np.int32(4) * (r * np.int32(size) + c)


@njit(**LOOP)
def _mix(n, texture, table, places, colours):
    size = texture.shape[0]
    right = 4 * min(size - 1, 1)
    down = right * size
    for m in range(n):
        t00, at = np.int64(places[TEXEL + m]), 4 * np.int64(places[SLOT + m])
        mix_texels(
            texture,
            t00,
            t00 + right,
            t00 + down,
            t00 + down + right,
            table[W00 + m],
            table[W01 + m],
            table[W10 + m],
            table[W11 + m],
            colours,
            at,
        )


@njit(**LOOP)
def _mix_faces(n, width, pixels, codes, coverage, projected, faces, uv, texture, near, table, places, colours):
    _gather_faces(n, width, pixels, codes, coverage, 1.0, projected, faces, uv, near, places)
    _untangle(n, near, table)
    _weigh_corners(n, table)
    _find_texels(n, texture.shape[0], table, places)
    _mix(n, texture, table, places, colours)


@njit(**LOOP)
def shade(pixels, codes, coverage, width, outline, projected, faces, uv, texture, near, table, places, rim, colours):
    """Fill the pixels' colours: coverage times the texture (bilinear, clamped at its border).

    Args:
        pixels: index of each listed pixel.
        codes: what each pixel shows.
        coverage: coverage of each listed pixel.
        width: width of the image [px].
        outline: (n, 3), edges (from, to, front face).
        projected: (V, 4), x, y [px], 1/z [1/m], 0.
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        texture: (A, A, 4), the 4th channel 1.
        near: work space of GATHERED numbers of the texture's kind.
        table: work space of FOUND numbers of the texture's kind.
        places: work space of PLACES int32.
        rim: work space of n numbers.
        colours: (n, 4), filled.
    """
    n, n_rim = 0, 0
    for m in range(pixels.shape[0]):
        code = codes[m]
        places[SLOT + n], rim[n_rim] = m, m
        n += code >= 0
        n_rim += (code < 0) & (code != NOTHING)
        if code == NOTHING:
            colours[m, 0], colours[m, 1], colours[m, 2], colours[m, 3] = 0.0, 0.0, 0.0, min(coverage[m], 1.0)
        if n == BATCH or m == pixels.shape[0] - 1:
            _mix_faces(n, width, pixels, codes, coverage, projected, faces, uv, texture, near, table, places, colours)
            n = 0
    for first in range(0, n_rim, BATCH):
        n = min(n_rim - first, BATCH)
        for q in range(n):
            places[SLOT + q] = rim[first + q]
        _gather_edges(n, width, pixels, codes, coverage, 1.0, outline, projected, faces, uv, near, places)
        _untangle(n, near, table)
        _weigh_ends(n, table)
        _find_texels(n, texture.shape[0], table, places)
        _mix(n, texture, table, places, colours)


@njit(**LOOP)
def _ask_texels(n, texture, picture_gradient, table, places, texture_gradient):
    """Multiply the image's gradient with each of the four texels; add the texture's own gradient where it is wanted."""
    size = texture.shape[0]
    right = 4 * min(size - 1, 1)
    down = right * size
    for m in range(n):
        t00, at = np.int64(places[TEXEL + m]), np.int64(places[AT + m])
        t01, t10, t11 = t00 + right, t00 + down, t00 + down + right
        g00, g01, g10, g11 = dots(picture_gradient, at, texture, t00, t01, t10, t11)
        table[G00 + m], table[G01 + m], table[G10 + m], table[G11 + m] = g00, g01, g10, g11
        if texture_gradient.shape[0] > 0:
            add_to_texels(
                texture_gradient,
                t00,
                t01,
                t10,
                t11,
                table[W00 + m],
                table[W01 + m],
                table[W10 + m],
                table[W11 + m],
                picture_gradient,
                at,
            )


@njit(**LOOP)
def _ask_corners(n, size, table):
    """Compute gradients by alpha and by the two weights from the texels', and D, of which a corner's 1/z has a share.

    A corner moving by d shifts any quantity q interpolated at a fixed position by -b (grad q . d); a change of
    its 1/z by e shifts u by b (u_corner - u) e / (sum b / z).
    """
    kind = table.dtype.type
    zero, half, one, across = kind(0.0), kind(0.5), kind(1.0), kind(size)
    last = across - one
    for m in range(n):
        g00, g01, g10, g11 = table[G00 + m], table[G01 + m], table[G10 + m], table[G11 + m]
        fc, fr, u, v = table[RIGHT + m], table[DOWN + m], table[U + m], table[V + m]
        above, below = g00 + fc * (g01 - g00), g10 + fc * (g11 - g10)
        of_alpha = above + fr * (below - above)
        steep = table[ALPHA + m] * across * table[SCALE + m]
        x, y = u * across - half, v * across - half
        slope_u = steep * ((one - fr) * (g01 - g00) + fr * (g11 - g10))
        slope_v = steep * (below - above)
        slope_u = slope_u if (x > zero) & (x < last) else zero
        slope_v = slope_v if (y > zero) & (y < last) else zero
        d0 = slope_u * (table[U0 + m] - u) + slope_v * (table[V0 + m] - v)
        d1 = slope_u * (table[U1 + m] - u) + slope_v * (table[V1 + m] - v)
        d2 = slope_u * (table[U2 + m] - u) + slope_v * (table[V2 + m] - v)
        z0 = -table[Z + m]
        table[D0 + m], table[D1 + m], table[D2 + m] = d0, d1, d2
        table[OF_ALPHA + m] = of_alpha
        table[OF_B1 + m] = d1 * (z0 + table[AZ + m]) - d0 * z0
        table[OF_B2 + m] = d2 * (z0 + table[BZ + m]) - d0 * z0


@njit(**LOOP)
def _corners_backward(n, table, places, gradient):
    """Add each pixel's gradient by its face's corners."""
    for m in range(n):
        first, second = table[OF_B1 + m], table[OF_B2 + m]
        table[PULL_X + m] = -(first * table[B1_X + m] + second * table[B2_X + m])
        table[PULL_Y + m] = -(first * table[B1_Y + m] + second * table[B2_Y + m])
    for m in range(n):
        b1, b2 = table[B1 + m], table[B2 + m]
        b0 = 1.0 - b1 - b2
        x, y = table[PULL_X + m], table[PULL_Y + m]
        add_corner(gradient, places[CORNER_0 + m], b0, x, y, table[D0 + m])
        add_corner(gradient, places[CORNER_1 + m], b1, x, y, table[D1 + m])
        add_corner(gradient, places[CORNER_2 + m], b2, x, y, table[D2 + m])


@njit(**LOOP)
def _ends_backward(n, table, places, gradient):
    """Add each pixel's gradient by the two ends of its edge: t = (p - start).d / d.d, its derivatives at fixed p."""
    for m in range(n):
        t, pull = table[B1 + m], table[OF_B1 + m]
        x, y, off_x, off_y = table[B1_X + m], table[B1_Y + m], table[OFF_X + m], table[OFF_Y + m]
        s = 1.0 - t
        add_corner(
            gradient, places[CORNER_0 + m], 1.0, -pull * (s * x + off_x), -pull * (s * y + off_y), s * table[D0 + m]
        )
        add_corner(
            gradient, places[CORNER_1 + m], 1.0, pull * (off_x - t * x), pull * (off_y - t * y), t * table[D1 + m]
        )


@njit(**INLINE)
def _ask(n, texture, picture_gradient, scale, table, places, of_coverage, texture_gradient):
    """Compute the gradients from the pixels to the weights of their corners; fill those by coverage."""
    _find_texels(n, texture.shape[0], table, places)
    _ask_texels(n, texture, picture_gradient, table, places, texture_gradient)
    _ask_corners(n, texture.shape[0], table)
    for m in range(n):
        of_coverage[np.uint32(places[SLOT + m])] = scale * table[OF_ALPHA + m]


@njit(**LOOP)
def _ask_faces(
    n,
    width,
    faces,
    uv,
    texture,
    projected,
    pixels,
    coverage,
    codes,
    picture_gradient,
    scale,
    near,
    table,
    places,
    of_coverage,
    on_screen,
    texture_gradient,
):
    _gather_faces(n, width, pixels, codes, coverage, scale, projected, faces, uv, near, places)
    _untangle(n, near, table)
    _weigh_corners(n, table)
    _ask(n, texture, picture_gradient, scale, table, places, of_coverage, texture_gradient)
    if on_screen.shape[0] > 0:
        _corners_backward(n, table, places, on_screen)


@njit(**LOOP)
def shade_gradient(
    width,
    faces,
    uv,
    texture,
    projected,
    outline,
    pixels,
    coverage,
    codes,
    picture_gradient,
    scale,
    near,
    table,
    places,
    rim,
    of_coverage,
    on_screen,
    texture_gradient,
):
    """Compute the gradients of `shade`.

    An empty `on_screen` or `texture_gradient` is skipped.

    Args:
        width: width of the image [px].
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        texture: (A, A, 4), the 4th channel 1.
        projected: (V, 4), x, y [px], 1/z [1/m], 0.
        outline: (n, 3), edges (from, to, front face).
        pixels: index of each listed pixel.
        coverage: coverage of each listed pixel.
        codes: what each pixel shows.
        picture_gradient: (H W, 4), gradient by the image.
        scale: factor of the image.
        near: work space of GATHERED numbers of the texture's kind.
        table: work space of FOUND numbers of the texture's kind.
        places: work space of PLACES int32.
        rim: work space of n numbers.
        of_coverage: gradient by each pixel's coverage, filled.
        on_screen: (V, 4), gradient by the vertices' x, y, 1/z, added to; the last is unused.
        texture_gradient: (A, A, 4), gradient by the texture, added to.
    """
    n, n_rim = 0, 0
    for m in range(pixels.shape[0]):
        code = codes[m]
        places[SLOT + n], rim[n_rim] = m, m
        n += code >= 0
        n_rim += (code < 0) & (code != NOTHING)
        if code == NOTHING:
            of_coverage[m] = scale * np.float64(picture_gradient[np.uint32(pixels[m]), 3])
        if n == BATCH or m == pixels.shape[0] - 1:
            _ask_faces(
                n,
                width,
                faces,
                uv,
                texture,
                projected,
                pixels,
                coverage,
                codes,
                picture_gradient,
                scale,
                near,
                table,
                places,
                of_coverage,
                on_screen,
                texture_gradient,
            )
            n = 0
    for first in range(0, n_rim, BATCH):
        n = min(n_rim - first, BATCH)
        for q in range(n):
            places[SLOT + q] = rim[first + q]
        _gather_edges(n, width, pixels, codes, coverage, scale, outline, projected, faces, uv, near, places)
        _untangle(n, near, table)
        _weigh_ends(n, table)
        _ask(n, texture, picture_gradient, scale, table, places, of_coverage, texture_gradient)
        if on_screen.shape[0] > 0:
            _ends_backward(n, table, places, on_screen)
