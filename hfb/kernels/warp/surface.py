"""Warp kernels: the texture's colour at each pixel, the images' means, and their gradients.

As in `render_surface`. The backward pass gathers: a face collects from its pixels, an outline edge from its own pieces
(`warp/gradient.py`), so that several threads add only to the texture's gradient, in whole steps.
"""
# mypy: ignore-errors
# (Warp compiles these: its types are not mypy's)

from typing import Any

import warp as wp

from hfb.kernels.warp.screen import HALF, NONE, ONE, ZERO, closest_parameter, outline_edge, twice_area

wp.set_module_options({"enable_backward": False})


@wp.func
def corner_of(faces: wp.array2d(dtype=wp.int32), f: wp.int32, vertex: wp.int32) -> wp.int32:
    """Return the corner (0, 1, 2) of face f that is a vertex.

    Args:
        faces: (F, 3), vertex numbers.
        f: number of the face.
        vertex: its number.
    """
    corner = wp.int32(2)
    if faces[f, 1] == vertex:
        corner = 1
    if faces[f, 0] == vertex:
        corner = 0
    return corner


@wp.func
def face_weights(centre: wp.vec2d, p: wp.vec3d, q: wp.vec3d, r: wp.vec3d) -> wp.vec3d:
    """Return barycentric coordinates on the screen.

    Args:
        centre: position [px].
        p: first corner, x, y [px], 1/z.
        q: second corner.
        r: third corner.
    """
    inverse = ONE / twice_area(p, q, r)
    x, y = centre[0] - p[0], centre[1] - p[1]
    b_q = (x * (r[1] - p[1]) - y * (r[0] - p[0])) * inverse
    b_r = (y * (q[0] - p[0]) - x * (q[1] - p[1])) * inverse
    return wp.vec3d(ONE - b_q - b_r, b_q, b_r)


@wp.func
def point_seen(
    b: wp.int32,
    row: wp.int32,
    column: wp.int32,
    code: wp.int32,
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    faces: wp.array2d(dtype=wp.int32),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    uv: wp.array2d(dtype=wp.vec2d),
) -> wp.vec2d:
    """Return the perspective-correct texture coordinates of what a pixel shows.

    That is a face's point at its centre, or the point of an outline edge closest to it.

    Args:
        b: number of the body.
        row: row of the pixel or texel.
        column: column of the pixel or texel.
        code: what the pixel shows.
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        faces: (F, 3), vertex numbers.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        uv: (F, 3), texture coordinates of the faces' corners.
    """
    centre = wp.vec2d(wp.float64(column) + HALF, wp.float64(row) + HALF)
    found = wp.vec2d()
    if code >= 0:
        p, q, r = projected[b, faces[code, 0]], projected[b, faces[code, 1]], projected[b, faces[code, 2]]
        w = wp.cw_mul(face_weights(centre, p, q, r), wp.vec3d(p[2], q[2], r[2]))
        found = (w[0] * uv[code, 0] + w[1] * uv[code, 1] + w[2] * uv[code, 2]) / (w[0] + w[1] + w[2])
    else:
        edge = outline_edge(front, edge_vertices, edge_faces, b, -1 - code)
        start, end = projected[b, edge[0]], projected[b, edge[1]]
        t = closest_parameter(centre, start, end)
        w0, w1 = (ONE - t) * start[2], t * end[2]
        i, j = corner_of(faces, edge[2], edge[0]), corner_of(faces, edge[2], edge[1])
        found = (w0 * uv[edge[2], i] + w1 * uv[edge[2], j]) / (w0 + w1)
    return found


@wp.func
def texel_position(coordinate: wp.float64, size: wp.int32) -> wp.float64:
    """Return a coordinate in texels from the first one's centre, clipped to the texture.

    Args:
        coordinate: in [0, 1].
        size: A, the texture's side [texels].
    """
    return wp.clamp(coordinate * wp.float64(size) - HALF, ZERO, wp.float64(size - 1))


@wp.func
def first_texel(position: wp.float64, size: wp.int32) -> wp.int32:
    """Return the first texel of the pair around a position.

    Args:
        position: by `texel_position`.
        size: A, the texture's side [texels].
    """
    return wp.min(wp.int32(wp.floor(position)), wp.max(size, 2) - 2)


@wp.func
def texture_of(n: wp.int32, pictures: wp.int32, textures: wp.int32) -> wp.int32:
    """Return the texture of image n: each belongs to a run of images, all runs of one length.

    Args:
        n: number of the image.
        pictures: number of images.
        textures: number of textures.
    """
    return n / (pictures / textures)


@wp.func
def colour_at(textures: wp.array4d(dtype=Any), g: wp.int32, row: wp.int32, column: wp.int32) -> wp.vec3d:
    """Return the colour of a texel.

    Args:
        textures: (G, A, A, 3), linear light; empty for silhouettes alone.
        g: number of the texture.
        row: row of the pixel or texel.
        column: column of the pixel or texel.
    """
    return wp.vec3d(
        wp.float64(textures[g, row, column, 0]),
        wp.float64(textures[g, row, column, 1]),
        wp.float64(textures[g, row, column, 2]),
    )


@wp.kernel
def shade(
    alpha: wp.array3d(dtype=wp.float64),
    codes: wp.array3d(dtype=wp.int32),
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    faces: wp.array2d(dtype=wp.int32),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    uv: wp.array2d(dtype=wp.vec2d),
    textures: wp.array4d(dtype=Any),
    subframes: wp.int32,
    pictures: wp.array4d(dtype=Any),
):
    """Compute the mean of each run of `subframes` bodies. Threads: images, rows, columns.

    It is coverage times the texture (bilinear, clamped at its border), and the coverage.

    Args:
        alpha: (B, H, W), coverage.
        codes: (B, H, W), what each pixel shows.
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        faces: (F, 3), vertex numbers.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        uv: (F, 3), texture coordinates of the faces' corners.
        textures: (G, A, A, 3), linear light; empty for silhouettes alone.
        subframes: bodies per image.
        pictures: (images, H, W, 4), filled; (images, H, W, 1) for silhouettes alone.
    """
    n, row, column = wp.tid()
    size, step = textures.shape[1], wp.min(textures.shape[1] - 1, 1)
    g = texture_of(n, pictures.shape[0], textures.shape[0])
    colour, opacity = wp.vec3d(), wp.float64(0.0)
    for s in range(subframes):
        b = n * subframes + s
        share = alpha[b, row, column]
        if share > ZERO:
            opacity = opacity + share
            if size > 0:
                code = codes[b, row, column]
                if code != NONE:
                    at = point_seen(b, row, column, code, projected, front, faces, edge_vertices, edge_faces, uv)
                    x, y = texel_position(at[0], size), texel_position(at[1], size)
                    c, r = first_texel(x, size), first_texel(y, size)
                    right, below = x - wp.float64(c), y - wp.float64(r)
                    upper = (ONE - right) * colour_at(textures, g, r, c) + right * colour_at(textures, g, r, c + step)
                    lower = (ONE - right) * colour_at(textures, g, r + step, c)
                    lower = lower + right * colour_at(textures, g, r + step, c + step)
                    colour = colour + share * ((ONE - below) * upper + below * lower)
    scale, last = ONE / wp.float64(subframes), pictures.shape[3] - 1
    if size > 0:
        for q in range(3):
            pictures[n, row, column, q] = pictures.dtype(colour[q] * scale)
    pictures[n, row, column, last] = pictures.dtype(opacity * scale)


@wp.func
def add_in_steps(
    value: wp.vec3d,
    steps: wp.float64,
    g: wp.int32,
    row: wp.int32,
    column: wp.int32,
    total: wp.array4d(dtype=wp.int64),
):
    """Add a colour to a texel as whole numbers of steps, so that the order of sums does not matter.

    Args:
        value: the colour.
        steps: number of steps in 1.
        g: number of the texture.
        row: row of the pixel or texel.
        column: column of the pixel or texel.
        total: (G, A, A, 3), added to.
    """
    for q in range(3):
        wp.atomic_add(total, g, row, column, q, wp.int64(wp.floor(value[q] * steps + HALF)))


@wp.kernel
def pixels_backward(
    alpha: wp.array3d(dtype=wp.float64),
    codes: wp.array3d(dtype=wp.int32),
    projected: wp.array2d(dtype=wp.vec3d),
    front: wp.array2d(dtype=wp.uint8),
    faces: wp.array2d(dtype=wp.int32),
    edge_vertices: wp.array2d(dtype=wp.int32),
    edge_faces: wp.array2d(dtype=wp.int32),
    uv: wp.array2d(dtype=wp.vec2d),
    textures: wp.array4d(dtype=Any),
    subframes: wp.int32,
    of_pictures: wp.array4d(dtype=Any),
    steps: wp.array(dtype=wp.float64),
    of_pixels: wp.array3d(dtype=wp.vec3d),
    of_textures: wp.array4d(dtype=wp.int64),
):
    """Compute the gradients of `shade` by what each pixel shows. Threads: bodies, rows, columns.

    Args:
        alpha: (B, H, W), coverage.
        codes: (B, H, W), what each pixel shows.
        projected: (B, V), x, y [px], 1/z [1/m].
        front: (B, F), faces that look at the camera.
        faces: (F, 3), vertex numbers.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        uv: (F, 3), texture coordinates of the faces' corners.
        textures: (G, A, A, 3), linear light; empty for silhouettes alone.
        subframes: bodies per image.
        of_pictures: gradient by the images.
        steps: number of steps in 1, of each texture.
        of_pixels: (B, H, W), gradient by coverage, u and v, filled.
        of_textures: (G, A, A, 3), gradient in steps, zeros before, added to; an empty one is skipped.
    """
    b, row, column = wp.tid()
    of_pixel, share, size = wp.vec3d(), alpha[b, row, column], textures.shape[1]
    if share > ZERO:
        n, scale = b / subframes, ONE / wp.float64(subframes)
        g = texture_of(n, of_pictures.shape[0], textures.shape[0])
        of_pixel = wp.vec3d(wp.float64(of_pictures[n, row, column, of_pictures.shape[3] - 1]) * scale, ZERO, ZERO)
        if size > 0:
            code = codes[b, row, column]
            if code != NONE:
                grad_colour = scale * wp.vec3d(
                    wp.float64(of_pictures[n, row, column, 0]),
                    wp.float64(of_pictures[n, row, column, 1]),
                    wp.float64(of_pictures[n, row, column, 2]),
                )
                at = point_seen(b, row, column, code, projected, front, faces, edge_vertices, edge_faces, uv)
                x, y, step = texel_position(at[0], size), texel_position(at[1], size), wp.min(size - 1, 1)
                c, r = first_texel(x, size), first_texel(y, size)
                right, below = x - wp.float64(c), y - wp.float64(r)
                t00, t01 = (
                    wp.dot(grad_colour, colour_at(textures, g, r, c)),
                    wp.dot(grad_colour, colour_at(textures, g, r, c + step)),
                )
                t10 = wp.dot(grad_colour, colour_at(textures, g, r + step, c))
                t11 = wp.dot(grad_colour, colour_at(textures, g, r + step, c + step))
                upper, lower = t00 + right * (t01 - t00), t10 + right * (t11 - t10)
                slope_u, slope_v, last = ZERO, ZERO, wp.float64(size - 1)
                if x > ZERO and x < last:
                    slope_u = share * wp.float64(size) * ((ONE - below) * (t01 - t00) + below * (t11 - t10))
                if y > ZERO and y < last:
                    slope_v = share * wp.float64(size) * (lower - upper)
                of_pixel = wp.vec3d(of_pixel[0] + upper + below * (lower - upper), slope_u, slope_v)
                if of_textures.shape[1] > 0:
                    grad_colour = share * grad_colour
                    add_in_steps((ONE - below) * (ONE - right) * grad_colour, steps[g], g, r, c, of_textures)
                    add_in_steps((ONE - below) * right * grad_colour, steps[g], g, r, c + step, of_textures)
                    add_in_steps(below * (ONE - right) * grad_colour, steps[g], g, r + step, c, of_textures)
                    add_in_steps(below * right * grad_colour, steps[g], g, r + step, c + step, of_textures)
    of_pixels[b, row, column] = of_pixel


for _real in (wp.float32, wp.float64):
    _some = {"textures": wp.array4d(dtype=_real)}
    wp.overload(shade, {**_some, "pictures": wp.array4d(dtype=_real)})
    wp.overload(pixels_backward, {**_some, "of_pictures": wp.array4d(dtype=_real)})
