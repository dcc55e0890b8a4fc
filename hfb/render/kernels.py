"""Compiled entry points: one body's picture as a list of its pixels, and the way back to its vertices.

Every function works on one body, or on a few that do not know of each other, and on memory of its own or of its caller,
releases Python's lock and adds in a fixed order: bodies may be drawn by any number of threads with the same bits as the
result.

A body's *trace* is what the way back needs of its way forth: (projected vertices, outline edges, pixels,
coverage, owners, edges, shares), the last three for every piece of outline that can change a pixel's coverage.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import JIT, LOOP, entry, loop_entry
from hfb.render.kernels_outline import (
    CUT,
    collect,
    count_pieces,
    cut_outline,
    pull_outline,
    weigh_pieces,
    wind_outline,
)
from hfb.render.kernels_overlap import chain_pieces, resolve
from hfb.render.kernels_screen import (
    find_outline,
    look_at_faces,
    mask_for,
    project,
    see_faces,
    to_metres,
    trace_outline,
)
from hfb.render.kernels_shading import FOUND, GATHERED, PLACES, shade, shade_gradient
from hfb.render.kernels_vector import add_scaled
from hfb.vector_code import LANES


@njit(**JIT)
def _resolve_overlaps(outline, projected, width, place, unsure, pixels, windings, piece_pixel, edge, span):
    """Turn the unsure pixels' mean winding into coverage; returns the shares of their pieces."""
    newest, older = np.full(unsure.shape[0], -1, np.int64), np.empty(piece_pixel.shape[0], np.int64)
    chain_pieces(piece_pixel, place, newest, older)
    longest = 0
    for slot in range(unsure.shape[0]):
        piece, length = newest[slot], 0
        while piece >= 0:
            piece = older[piece]
            length += 1
        longest = max(longest, length)
    weights = np.zeros((piece_pixel.shape[0], 2), np.float64)
    most = 3 + 2 * longest + longest * longest // 2  # heights: borders, ends and crossings
    resolve(
        unsure, pixels, windings, width, outline, projected, newest, older, edge, span, weights,
        np.empty(longest, np.int64), np.empty((longest, 6), np.float64), np.zeros(most + LANES, np.float64),
        np.empty(most + LANES, np.float64), np.empty(most + LANES, np.float64), np.empty(longest, np.int64),
        np.empty(2 * LANES * longest, np.float64),
    )  # fmt: skip
    return weights


@njit(**JIT)
def _trace(outline, projected, box, width, seen, mask):
    """Pixels of one body and what moves them: (indices, codes, coverage, owners, edges, shares)."""
    height, breadth = box[3] - box[1], box[2] - box[0]
    winding, marks = np.zeros((height, breadth + 1), np.float64), np.zeros((height, breadth), np.uint8)
    first, last = np.full(height, breadth, np.int64), np.full(height, -1, np.int64)
    most = count_pieces(outline, projected, box) + 1  # and one that is written to and not kept
    piece_pixel, piece_edge, piece_row = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    piece_span, piece_mark, amounts = np.empty((most, 2), np.float64), np.empty(most, np.uint8), np.empty((most, 3))
    pieces = (piece_pixel, piece_edge, piece_span, piece_row, piece_mark, amounts)
    longest = 2 * (height + breadth) + 8  # an edge crosses each border between rows and columns at most twice
    total = cut_outline(
        outline, projected, box, np.empty(CUT, np.float64),
        np.empty(longest, np.int64), np.empty(longest, np.int64), np.empty(longest, np.float64), pieces,
    )  # fmt: skip
    wind_outline(total, pieces, breadth, winding, marks, first, last, seen, mask)
    room = height * breadth + 1  # again one that is not kept
    pixels, coverage = np.empty(room, np.int32), np.empty(room, np.float64)
    codes = np.empty(room if seen.shape[0] > 0 else 0, np.int32)
    place, unsure = np.empty(room, np.int32), np.empty(room, np.int32)
    n, n_unsure = collect(winding, marks, first, last, box, width, seen, mask, pixels, codes, coverage, place, unsure)
    piece_pixel, unsure = piece_pixel[:total], unsure[:n_unsure]
    weights = _resolve_overlaps(
        outline, projected, width, place, unsure, pixels, coverage, piece_pixel, piece_edge, piece_span
    )
    owner, edge, shares = np.empty(total, np.int32), np.empty(total, np.int32), np.empty((total, 2), np.float64)
    moving = weigh_pieces(piece_pixel, piece_edge, piece_span, place, unsure, coverage, weights, owner, edge, shares)
    return (
        pixels[:n].copy(), codes[:n].copy(), coverage[:n].copy(),
        owner[:moving].copy(), edge[:moving].copy(), shares[:moving].copy(),
    )  # fmt: skip


@entry
def survey(vertices, lens, faces, edge_faces, coloured):
    """What of up to LANES bodies (n, V, 3) is found at once: projected vertices, boxes, and for each body the faces
    that may be seen, their number, its outline's sides, their number (see `kernels_screen`).

    coloured: the faces are wanted.
    """
    count = vertices.shape[0]
    boxes, projected = np.empty((count, 4), np.int64), np.empty((count, vertices.shape[1], 4), np.float64)
    for s in range(count):
        project(vertices[s], lens, 0.0, projected[s], boxes[s])
    front, candidates, n_candidates = look_at_faces(projected, faces, boxes, coloured)
    sides, n_sides = np.empty((count, edge_faces.shape[0] + 1), np.uint32), np.zeros(count, np.int64)
    find_outline(front, edge_faces, sides, n_sides)
    return projected, boxes, candidates, n_candidates, sides, n_sides


@njit(**JIT)
def _outline(sides, box, edge_vertices, edge_faces):
    outline = np.empty((sides.shape[0] if box[0] < box[2] else 0, 3), np.uint32)
    trace_outline(sides[: outline.shape[0]], edge_vertices, edge_faces, outline)
    return outline


@entry
def cover_body(projected, box, sides, edge_vertices, edge_faces, width):
    """Silhouette of one body: its trace but for the projected vertices."""
    outline = _outline(sides, box, edge_vertices, edge_faces)
    pixels, _, coverage, owner, edge, shares = _trace(outline, projected, box, width, np.empty((0, 0), np.int64), 0)
    return outline, pixels, coverage, owner, edge, shares


@entry
def draw_body(projected, box, candidates, sides, faces, uv, edge_vertices, edge_faces, width, texture):
    """One body: its trace but for the projected vertices, then the pixels' codes and premultiplied colours. The
    texture's 4th channel is 1."""
    mask = mask_for(faces, edge_faces)
    seen = see_faces(projected, faces, candidates, box, mask)
    outline = _outline(sides, box, edge_vertices, edge_faces)
    pixels, codes, coverage, owner, edge, shares = _trace(outline, projected, box, width, seen, mask)
    colours = np.empty((pixels.shape[0], 4), texture.dtype)
    near, table = np.empty(GATHERED, texture.dtype), np.empty(FOUND, texture.dtype)
    places, rim = np.empty(PLACES, np.int32), np.empty(pixels.shape[0] + 1, np.int32)
    shade(pixels, codes, coverage, width, outline, projected, faces, uv, texture, near, table, places, rim, colours)
    return outline, pixels, coverage, owner, edge, shares, codes, colours


@loop_entry
def widen(texture, texels):
    """Copy a texture (A, A, 3) and set the fourth channel to one."""
    for r in range(texture.shape[0]):
        for c in range(texture.shape[1]):
            texels[r, c, 0], texels[r, c, 1], texels[r, c, 2] = texture[r, c, 0], texture[r, c, 1], texture[r, c, 2]
            texels[r, c, 3] = 1.0


@loop_entry
def move_texels(sums, total):
    """Add the first three channels of `sums` (A, A, 4) to `total`, and set `sums` to zero."""
    for r in range(total.shape[0]):
        for c in range(total.shape[1]):
            for q in range(3):
                total[r, c, q] += sums[r, c, q]
            sums[r, c, 0], sums[r, c, 1], sums[r, c, 2], sums[r, c, 3] = 0.0, 0.0, 0.0, 0.0


@loop_entry
def add_picture(pixels, colours, scale, picture):
    """Add `scale` times a body's pixels to a picture (H W, 4)."""
    for m in range(pixels.shape[0]):
        add_scaled(picture, 4 * np.int64(pixels[m]), colours, 4 * m, scale)


@loop_entry
def add_silhouette(pixels, coverage, scale, picture):
    """Add `scale` times a body's coverage to a picture (H W, 1)."""
    for m in range(pixels.shape[0]):
        picture[np.uint32(pixels[m]), 0] += min(coverage[m], 1.0) * scale


@njit(**LOOP)
def take(pixels, picture_gradient, scale, of_coverage):
    """Gradient of each listed pixel's coverage from that of the silhouette's picture (H W, 1)."""
    for m in range(pixels.shape[0]):
        of_coverage[m] = picture_gradient[np.uint32(pixels[m]), 0] * scale


@entry
def cover_body_gradient(vertices, lens, trace, picture_gradient, scale, gradient):
    """Fill `gradient` (V, 3) with scale times the gradient of a silhouette whose picture's is given (H W, 1)."""
    projected, outline, pixels, _, owner, edge, shares = trace
    on_screen, of_coverage = np.zeros((vertices.shape[0], 3), np.float64), np.empty(pixels.shape[0], np.float64)
    take(pixels, picture_gradient, scale, of_coverage)
    pull_outline(outline, projected, owner, edge, shares, of_coverage, on_screen)
    to_metres(projected, vertices, lens, on_screen, gradient)


@entry
def draw_body_gradient(
    vertices, lens, faces, uv, texture, trace, codes, picture_gradient, scale, gradient, texture_gradient
):
    """Fill `gradient` (V, 3), add to `texture_gradient`, from that of the picture (H W, 4), times scale.

    An empty `gradient` or `texture_gradient` leaves that one out.
    """
    projected, outline, pixels, coverage, owner, edge, shares = trace
    on_screen, of_coverage = np.zeros((gradient.shape[0], 4), np.float64), np.empty(pixels.shape[0], np.float64)
    near, table = np.empty(GATHERED, texture.dtype), np.empty(FOUND, texture.dtype)
    places, rim = np.empty(PLACES, np.int32), np.empty(pixels.shape[0] + 1, np.int32)
    shade_gradient(
        np.int64(lens[5]), faces, uv, texture, projected, outline, pixels, coverage, codes,
        picture_gradient, scale, near, table, places, rim, of_coverage, on_screen, texture_gradient,
    )  # fmt: skip
    if gradient.shape[0] > 0:
        pull_outline(outline, projected, owner, edge, shares, of_coverage, on_screen)
        to_metres(projected, vertices, lens, on_screen, gradient)
