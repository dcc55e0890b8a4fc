"""Compiled entry points: one body's picture as a list of its pixels, and the way back to its vertices.

Every function works on one body and on memory of its own or of its caller, releases Python's lock and adds in
a fixed order: bodies may be drawn by any number of threads with the same bits as the result.

A body's *trace* is what the way back needs of its way forth:
(projected vertices, outline edges, pixels, coverage, overlap owners, overlap edges, overlap weights), the last
three for pieces of outline in pixels where layers may overlap (`kernels_overlap`).
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.render.kernels_compile import JIT, LOOP, entry, loop_entry
from hfb.render.kernels_outline import (
    TINY,
    collect,
    count_pieces,
    find_front,
    find_outline,
    outline_gradient,
    project,
    to_metres,
    wind_outline,
)
from hfb.render.kernels_overlap import chain_pieces, overlap_gradient, resolve
from hfb.render.kernels_surface import NOTHING, fill_depth, shade, shade_gradient


@njit(**JIT)
def _room_for_pieces(box):
    """Columns, rows and ends of the pieces of one edge: it crosses each row and column border at most twice."""
    size = 2 * (box[2] - box[0] + box[3] - box[1]) + 8
    return np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.float64)


@njit(**JIT)
def _front_and_outline(vertices, lens, faces, edge_vertices, edge_faces, box):
    projected = np.empty((vertices.shape[0], 3), np.float64)
    front = np.empty(faces.shape[0], np.bool_)
    outline = np.empty((edge_vertices.shape[0], 3), np.uint32)
    n = 0
    project(vertices, lens, 0.0, projected, box)
    if box[0] < box[2]:
        find_front(projected, faces, front)
        n = find_outline(front, edge_vertices, edge_faces, outline)
    return projected, front, outline[:n].copy()


@njit(**JIT)
def _resolve_overlaps(outline, projected, width, unsure, record, pixels, windings, piece_pixel, edge, span):
    """Exact coverage of the unsure pixels; (owners, edges, weights) of their pieces."""
    newest, older = np.full(record.shape[0], -1, np.int64), np.empty(piece_pixel.shape[0], np.int64)
    chain_pieces(piece_pixel, unsure, newest, older)
    longest, n = 0, 0
    for slot in range(record.shape[0]):
        piece, length = newest[slot], 0
        while piece >= 0:
            piece = older[piece]
            length += 1
        longest = max(longest, length)
        n += length
    weights = np.zeros((piece_pixel.shape[0], 2), np.float64)
    resolve(
        record, pixels, windings, width, outline, projected, newest, older, edge, span, weights,
        np.empty(longest, np.int64), np.empty((longest, 5), np.float64), np.empty((2 * longest, 2), np.float64),
        np.empty(3 + 2 * longest + longest * longest, np.float64),
        np.empty(longest, np.int64), np.empty(longest, np.float64),
    )  # fmt: skip
    owner, of_edge, kept = np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 2), np.float64)
    n = 0
    for slot in range(record.shape[0]):
        piece = newest[slot]
        while piece >= 0:
            owner[n], of_edge[n] = record[slot], edge[piece]
            kept[n, 0], kept[n, 1] = weights[piece, 0], weights[piece, 1]
            piece = older[piece]
            n += 1
    return owner, of_edge, kept


@njit(**JIT)
def _trace(outline, projected, box, width, nearest, code):
    """Pixels of one body: (indices, codes, coverage, overlap owners, edges, weights)."""
    height, breadth = box[3] - box[1], box[2] - box[0]
    winding = np.zeros((height, breadth + 1), np.float64)
    marks = np.zeros((height, breadth), np.uint8)
    first, last = np.full(height, breadth, np.int64), np.full(height, -1, np.int64)
    columns, rows, ends = _room_for_pieces(box)
    total = count_pieces(outline, projected, box)
    piece_pixel, edge, span = np.empty(total, np.int32), np.empty(total, np.int32), np.empty((total, 2), np.float64)
    total = wind_outline(
        outline, projected, box, winding, marks, first, last, nearest, code, columns, rows, ends,
        piece_pixel, edge, span,
    )  # fmt: skip
    pixels, windings = np.empty(height * breadth, np.int32), np.empty(height * breadth, np.float64)
    codes = np.empty(height * breadth if code.shape[0] > 0 else 0, np.int32)
    unsure, record = np.zeros(height * breadth, np.int32), np.empty(height * breadth, np.int32)
    n, n_unsure = collect(winding, marks, first, last, box, width, code, pixels, codes, windings, unsure, record)
    pixels, codes, windings = pixels[:n].copy(), codes[:n].copy(), windings[:n].copy()
    owner, of_edge, weights = _resolve_overlaps(
        outline, projected, width, unsure, record[:n_unsure], pixels, windings, piece_pixel[:total], edge, span
    )
    return pixels, codes, windings, owner, of_edge, weights


@entry
def cover_body(vertices, lens, faces, edge_vertices, edge_faces):
    """Silhouette of one body: its trace."""
    box = np.empty(4, np.int64)
    projected, _, outline = _front_and_outline(vertices, lens, faces, edge_vertices, edge_faces, box)
    nothing, no_code = np.empty((0, 0), np.float64), np.empty((0, 0), np.int32)
    pixels, _, coverage, owner, edge, weights = _trace(outline, projected, box, np.int64(lens[5]), nothing, no_code)
    return projected, outline, pixels, coverage, owner, edge, weights


@entry
def draw_body(vertices, lens, faces, uv, uv_faces, edge_vertices, edge_faces, texture):
    """One body: its trace, then the pixels' codes and premultiplied colours. The texture's 4th channel is 1."""
    box = np.empty(4, np.int64)
    projected, front, outline = _front_and_outline(vertices, lens, faces, edge_vertices, edge_faces, box)
    nearest = np.zeros((box[3] - box[1], box[2] - box[0]), np.float64)
    code = np.full(nearest.shape, NOTHING, np.int32)
    if outline.shape[0] > 0:
        fill_depth(projected, faces, front, box, nearest, code)
    width = np.int64(lens[5])
    pixels, codes, coverage, owner, edge, weights = _trace(outline, projected, box, width, nearest, code)
    colours = np.empty((pixels.shape[0], 4), texture.dtype)
    shade(pixels, codes, coverage, width, outline, projected, faces, uv, uv_faces, texture, colours)
    return projected, outline, pixels, coverage, owner, edge, weights, codes, colours


@loop_entry
def add_picture(pixels, colours, scale, picture):
    """Add `scale` times a body's pixels to a picture (H W, 4)."""
    for m in range(pixels.shape[0]):
        pixel = np.uint32(pixels[m])
        for q in range(4):
            picture[pixel, q] += colours[m, q] * scale


@loop_entry
def add_silhouette(pixels, coverage, scale, picture):
    """Add `scale` times a body's coverage to a picture (H W)."""
    for m in range(pixels.shape[0]):
        picture[np.uint32(pixels[m])] += min(coverage[m], 1.0) * scale


@njit(**LOOP)
def _find_box(pixels, width, box):
    """Bounds of a list of pixels in reading order."""
    box[0], box[1], box[2], box[3] = width, 0, 0, 0
    if pixels.shape[0] == 0:
        box[0] = 0
        return
    row = box[1] = pixels[0] // width
    box[3] = pixels[pixels.shape[0] - 1] // width + 1
    for m in range(pixels.shape[0]):
        while pixels[m] >= (row + 1) * width:
            row += 1
        column = pixels[m] - row * width
        box[0], box[2] = min(box[0], column), max(box[2], column + 1)


@njit(**LOOP)
def _spread(pixels, width, coverage, of_coverage, owner, box, of_winding):
    """Put the coverage's gradient where `outline_gradient` looks for it: not for full pixels, which stay full, and
    not for those `overlap_gradient` takes care of."""
    row = box[1]
    for m in range(pixels.shape[0]):
        while pixels[m] >= (row + 1) * width:
            row += 1
        if coverage[m] < 1.0 - TINY:
            of_winding[row - box[1], pixels[m] - row * width - box[0]] = of_coverage[m]
    for p in range(owner.shape[0]):
        row = pixels[owner[p]] // width
        of_winding[row - box[1], pixels[owner[p]] - row * width - box[0]] = 0.0


@njit(**JIT)
def _move_outline(vertices, lens, trace, of_coverage, on_screen, gradient):
    """Add what the coverage's gradient asks of the outline, and go from pixels to metres."""
    projected, outline, pixels, coverage, owner, edge, weights = trace
    if pixels.shape[0] > 0:
        width = np.int64(lens[5])
        box = np.empty(4, np.int64)
        _find_box(pixels, width, box)
        of_winding = np.zeros((box[3] - box[1], box[2] - box[0]), np.float64)
        _spread(pixels, width, coverage, of_coverage, owner, box, of_winding)
        columns, rows, ends = _room_for_pieces(box)
        outline_gradient(outline, projected, box, of_winding, on_screen, columns, rows, ends)
        overlap_gradient(outline, projected, owner, edge, weights, of_coverage, on_screen)
    to_metres(projected, vertices, lens, on_screen, gradient)


@njit(**LOOP)
def _take(pixels, picture_gradient, scale, of_coverage):
    for m in range(pixels.shape[0]):
        of_coverage[m] = picture_gradient[np.uint32(pixels[m])] * scale


@entry
def cover_body_gradient(vertices, lens, trace, picture_gradient, scale, gradient):
    """Fill `gradient` (V, 3) with scale times the gradient of a silhouette whose picture's is given (H W)."""
    of_coverage = np.empty(trace[2].shape[0], np.float64)
    _take(trace[2], picture_gradient, scale, of_coverage)
    _move_outline(vertices, lens, trace, of_coverage, np.zeros((vertices.shape[0], 3), np.float64), gradient)


@entry
def draw_body_gradient(
    vertices, lens, faces, uv, uv_faces, texture, trace, codes, picture_gradient, scale, gradient, texture_gradient
):
    """Fill `gradient` (V, 3), add to `texture_gradient`, from that of the picture (H W, 4), times scale.

    An empty `gradient` or `texture_gradient` leaves that one out.
    """
    projected, outline, pixels, coverage, _, _, _ = trace
    on_screen = np.zeros((gradient.shape[0], 3), np.float64)
    of_coverage = np.empty(pixels.shape[0], np.float64)
    shade_gradient(
        np.int64(lens[5]), faces, uv, uv_faces, texture, projected, outline, pixels, coverage, codes,
        picture_gradient, scale, of_coverage, on_screen, texture_gradient,
    )  # fmt: skip
    if gradient.shape[0] > 0:
        _move_outline(vertices, lens, trace, of_coverage, on_screen, gradient)
