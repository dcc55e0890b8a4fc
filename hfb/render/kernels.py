"""Compiled entry points: one body's picture as a list of its pixels, and the way back to its vertices.

Every function works on one body and on memory of its own or of its caller, releases Python's lock and adds in
a fixed order: bodies may be drawn by any number of threads with the same bits as the result.
"""

import numpy as np
from numba import njit

from hfb.render.kernels_outline import (
    JIT,
    LOOP,
    TINY,
    collect,
    find_front,
    find_outline,
    outline_gradient,
    project,
    wind_outline,
)
from hfb.render.kernels_surface import (
    NOTHING,
    edge_gradient,
    face_gradient,
    fill_depth,
    shade,
)


@njit(**JIT)
def _front_and_outline(vertices, lens, faces, edge_vertices, edge_faces, box):
    projected = np.empty((vertices.shape[0], 3), np.float64)
    front = np.empty(faces.shape[0], np.bool_)
    outline = np.empty((edge_vertices.shape[0], 3), np.uint32)
    project(vertices, lens, projected, box)
    if box[0] >= box[2]:
        return projected, front, outline, 0
    find_front(projected, faces, front)
    return projected, front, outline, find_outline(front, edge_vertices, edge_faces, outline)


@njit(**JIT)
def _room_for_pieces(box):
    """Columns, rows and ends of the pieces of one edge: it crosses each row and column border at most twice."""
    size = 2 * (box[2] - box[0] + box[3] - box[1]) + 8
    return np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.float64)


@njit(**JIT)
def cover_body(vertices, lens, faces, edge_vertices, edge_faces):
    """Silhouette of one body: (projected, outline, pixels, mean windings), the pixels in reading order."""
    box = np.empty(4, np.int64)
    projected, _, outline, n_edges = _front_and_outline(vertices, lens, faces, edge_vertices, edge_faces, box)
    height, width = box[3] - box[1], box[2] - box[0]
    winding = np.zeros((height, width + 1), np.float64)
    first, last = np.full(height, width, np.int64), np.full(height, -1, np.int64)
    nothing, no_code = np.empty((0, 0), np.float64), np.empty((0, 0), np.int32)
    columns, rows, ends = _room_for_pieces(box)
    wind_outline(
        outline, n_edges, projected, box, winding, first, last, nothing, no_code, columns, rows, ends
    )
    pixels = np.empty(height * width, np.int32)
    windings = np.empty(height * width, np.float64)
    n = collect(winding, first, last, box, np.int64(lens[5]), no_code, pixels, no_code[0:0].reshape(0), windings)
    return projected, outline[:n_edges].copy(), pixels[:n].copy(), windings[:n].copy()


@njit(**JIT)
def draw_body(vertices, lens, faces, uv, uv_faces, edge_vertices, edge_faces, texture):
    """One body: (projected, outline, pixels, codes, mean windings, premultiplied colours)."""
    box = np.empty(4, np.int64)
    projected, front, outline, n_edges = _front_and_outline(vertices, lens, faces, edge_vertices, edge_faces, box)
    height, width = box[3] - box[1], box[2] - box[0]
    nearest = np.zeros((height, width), np.float64)
    code = np.full((height, width), NOTHING, np.int32)
    winding = np.zeros((height, width + 1), np.float64)
    first, last = np.full(height, width, np.int64), np.full(height, -1, np.int64)
    if n_edges > 0:
        fill_depth(projected, faces, front, box, nearest, code)
        columns, rows, ends = _room_for_pieces(box)
        wind_outline(outline, n_edges, projected, box, winding, first, last, nearest, code, columns, rows, ends)
    pixels, codes = np.empty(height * width, np.int32), np.empty(height * width, np.int32)
    windings = np.empty(height * width, np.float64)
    n = collect(winding, first, last, box, np.int64(lens[5]), code, pixels, codes, windings)
    colours = np.empty((n, 4), texture.dtype)
    outline = outline[:n_edges].copy()
    shade(pixels, codes, windings, n, np.int64(lens[5]), outline, projected, faces, uv, uv_faces, texture, colours)
    return projected, outline, pixels[:n].copy(), codes[:n].copy(), windings[:n].copy(), colours


@njit(**LOOP)
def add_picture(pixels, colours, scale, picture):
    """Add `scale` times a body's pixels to a picture (H W, 4)."""
    for m in range(pixels.shape[0]):
        for q in range(4):
            picture[pixels[m], q] += colours[m, q] * scale


@njit(**LOOP)
def add_silhouette(pixels, windings, scale, picture):
    """Add `scale` times a body's coverage to a picture (H W)."""
    for m in range(pixels.shape[0]):
        picture[pixels[m]] += min(windings[m], 1.0) * scale


@njit(**LOOP)
def _box_of(pixels, width, box):
    if pixels.shape[0] == 0:
        box[0], box[1], box[2], box[3] = 0, 0, 0, 0
        return
    left, right = width, -1
    for m in range(pixels.shape[0]):
        column = pixels[m] % width
        left, right = min(left, column), max(right, column)
    box[0], box[1] = left, pixels[0] // width
    box[2], box[3] = right + 1, pixels[pixels.shape[0] - 1] // width + 1


@njit(**LOOP)
def _to_metres(projected, vertices, lens, on_screen, gradient):
    """Chain rule through x = fx X / Z + cx, y = fy Y / Z + cy, q = 1 / Z."""
    fx, fy = lens[0], lens[1]
    for i in range(vertices.shape[0]):
        q = projected[i, 2]
        gx, gy = on_screen[i, 0] * fx, on_screen[i, 1] * fy
        gradient[i, 0] = gx * q
        gradient[i, 1] = gy * q
        by_inverse = on_screen[i, 2] + gx * np.float64(vertices[i, 0]) + gy * np.float64(vertices[i, 1])
        gradient[i, 2] = -q * q * by_inverse


@njit(**LOOP)
def _cover_gradient(width, pixels, windings, picture_gradient, scale, box, of_winding):
    """Fill the mean windings' gradient (region): a full pixel stays full."""
    for m in range(pixels.shape[0]):
        if windings[m] < 1.0 - TINY:
            row = pixels[m] // width
            of_winding[row - box[1], pixels[m] - row * width - box[0]] = picture_gradient[pixels[m]] * scale


@njit(**JIT)
def cover_body_gradient(vertices, lens, projected, outline, pixels, windings, picture_gradient, scale, gradient):
    """Fill `gradient` (V, 3) with scale times the gradient of a silhouette whose picture's is given (H W)."""
    width = np.int64(lens[5])
    box = np.empty(4, np.int64)
    _box_of(pixels, width, box)
    of_winding = np.zeros((box[3] - box[1], box[2] - box[0]), np.float64)
    _cover_gradient(width, pixels, windings, picture_gradient, scale, box, of_winding)
    on_screen = np.zeros((vertices.shape[0], 3), np.float64)
    if pixels.shape[0] > 0:
        columns, rows, ends = _room_for_pieces(box)
        outline_gradient(outline, outline.shape[0], projected, box, of_winding, on_screen, columns, rows, ends)
    _to_metres(projected, vertices, lens, on_screen, gradient)


@njit(**LOOP)
def _shade_gradient(
    width, faces, uv, uv_faces, texture, projected, outline, pixels, codes, windings,
    picture_gradient, scale, box, of_winding, on_screen, texture_gradient,
):  # fmt: skip
    """Way back of `shade`: fills the mean windings' gradient, adds to the corners' and to the texture's."""
    row = 0
    for m in range(pixels.shape[0]):
        pixel = pixels[m]
        while pixel >= (row + 1) * width:
            row += 1
        column = pixel - row * width
        code, alpha = codes[m], min(np.float64(windings[m]), 1.0)
        of_alpha = 0.0
        g = (
            picture_gradient[pixel, 0] * scale,
            picture_gradient[pixel, 1] * scale,
            picture_gradient[pixel, 2] * scale,
            picture_gradient[pixel, 3] * scale,
        )
        if code >= 0:
            of_alpha = face_gradient(
                column + 0.5, row + 0.5, projected, faces, uv, uv_faces, np.uint32(code),
                texture, alpha, g, texture_gradient, on_screen,
            )  # fmt: skip
        elif code != NOTHING:
            of_alpha = edge_gradient(
                column + 0.5, row + 0.5, projected, faces, uv, uv_faces, outline[np.uint32(~code)],
                texture, alpha, g, texture_gradient, on_screen,
            )  # fmt: skip
        if windings[m] < 1.0 - TINY:
            of_winding[row - box[1], column - box[0]] = of_alpha


@njit(**JIT)
def draw_body_gradient(
    vertices, lens, faces, uv, uv_faces, texture,
    projected, outline, pixels, codes, windings, picture_gradient, scale, gradient, texture_gradient,
):  # fmt: skip
    """Fill `gradient` (V, 3), add to `texture_gradient`, from that of the picture (H W, 4), times scale.

    An empty `gradient` or `texture_gradient` leaves that one out.
    """
    width = np.int64(lens[5])
    box = np.empty(4, np.int64)
    _box_of(pixels, width, box)
    of_winding = np.zeros((box[3] - box[1], box[2] - box[0]), np.float64)
    on_screen = np.zeros((gradient.shape[0], 3), np.float64)
    _shade_gradient(
        width, faces, uv, uv_faces, texture, projected, outline, pixels, codes, windings,
        picture_gradient, scale, box, of_winding, on_screen, texture_gradient,
    )  # fmt: skip
    if gradient.shape[0] > 0:
        if pixels.shape[0] > 0:
            columns, rows, ends = _room_for_pieces(box)
            outline_gradient(outline, outline.shape[0], projected, box, of_winding, on_screen, columns, rows, ends)
        _to_metres(projected, vertices, lens, on_screen, gradient)
