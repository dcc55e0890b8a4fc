"""Compiled entry points: images of a block of bodies as lists of pixels, and gradients by the vertices.

Bodies are independent: each has the bits that it has alone. Every function uses its own or its caller's memory,
releases Python's lock and adds in a fixed order: blocks may be drawn by any number of threads with the same bits as the
result.

A block's *trace* holds the values that the backward pass needs: projected vertices (n, V, 4), outline edges, pixels,
coverage, owners, edges, shares, the last three for every piece of outline that can change a pixel's coverage, the
pixels' codes (of coloured bodies), and `ends` (n + 1, 3), up to which outline edges, pixels and pieces are each body's.
A piece's owner and edge are numbers among its body's pixels and outline edges.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import JIT, LOOP, entry, loop_entry
from hfb.kernels.rendering.render_outline import (
    CUT,
    collect,
    count_pieces,
    cut_outline,
    outline_backward,
    weigh_pieces,
    wind_outline,
)
from hfb.kernels.rendering.render_overlap import chain_pieces, resolve
from hfb.kernels.rendering.render_screen import (
    find_outline,
    look_at_faces,
    mask_for,
    see_faces,
    to_metres,
    trace_outline,
)
from hfb.kernels.rendering.render_shading import FOUND, GATHERED, PLACES, shade, shade_gradient
from hfb.kernels.rendering.render_vector import add_scaled
from hfb.kernels.simd import LANES


@njit(**JIT)
def _resolve_overlaps(outline, projected, width, place, unsure, pixels, windings, piece_pixel, edge, span):
    """Turn the unsure pixels' mean winding into coverage; returns the shares of their pieces."""
    newest, older = np.empty(unsure.shape[0], np.int64), np.empty(piece_pixel.shape[0], np.int64)
    counts = np.zeros(unsure.shape[0], np.int64)
    chain_pieces(piece_pixel, place, newest, older, counts)
    longest = 0
    for slot in range(unsure.shape[0]):
        longest = max(longest, counts[slot])
    weights = np.zeros((piece_pixel.shape[0], 2), np.float64)
    most = 3 + 2 * longest + longest * longest // 2 + LANES  # heights: borders, ends and crossings
    resolve(
        unsure,
        newest,
        counts,
        pixels,
        windings,
        width,
        outline,
        projected,
        older,
        edge,
        span,
        weights,
        np.empty(longest, np.int64),
        np.empty((longest, 6), np.float64),
        np.empty(most, np.float64),
        np.empty(most, np.float64),
        np.empty(longest, np.int64),
        np.empty(2 * LANES * longest, np.float64),
    )
    return weights


@njit(**JIT)
def _trace(outline, projected, box, width, seen, mask, pixels, codes, coverage, owner, edge, shares):
    """List the pixels of one body (indices, codes, coverage) and the pieces that move them (owners, edges, shares).

    Returns:
        the numbers of both.
    """
    height, breadth = box[3] - box[1], box[2] - box[0]
    winding, marks = np.zeros((height, breadth + 1), np.float64), np.zeros((height, breadth), np.uint8)
    first, last = np.full(height, breadth, np.int64), np.full(height, -1, np.int64)
    most = owner.shape[0]
    piece_pixel, piece_edge, piece_row = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    piece_span, piece_mark, amounts = np.empty((most, 2), np.float64), np.empty(most, np.uint8), np.empty((most, 3))
    pieces = (piece_pixel, piece_edge, piece_span, piece_row, piece_mark, amounts)
    longest = 2 * (height + breadth) + 8  # an edge crosses each border between rows and columns at most twice
    total = cut_outline(
        outline,
        projected,
        box,
        np.empty(CUT, np.float64),
        np.empty(longest, np.int64),
        np.empty(longest, np.int64),
        np.empty(longest, np.float64),
        pieces,
    )
    wind_outline(total, pieces, breadth, winding, marks, first, last, seen, mask)
    place, unsure = np.empty(pixels.shape[0], np.int32), np.empty(pixels.shape[0], np.int32)
    n, n_unsure = collect(winding, marks, first, last, box, width, seen, mask, pixels, codes, coverage, place, unsure)
    piece_pixel, unsure = piece_pixel[:total], unsure[:n_unsure]
    weights = _resolve_overlaps(
        outline, projected, width, place, unsure, pixels, coverage, piece_pixel, piece_edge, piece_span
    )
    moving = weigh_pieces(piece_pixel, piece_edge, piece_span, place, unsure, coverage, weights, owner, edge, shares)
    return n, moving


@njit(**JIT)
def _survey(vertices, lens, faces, edge_faces, coloured):
    """Return, for up to LANES bodies (n, V, 3), projected vertices and boxes, and per body candidate faces and sides.

    The lists of the faces that may be seen and of the outline's sides have their lengths beside them (see
    `render_screen`). With `coloured` false the faces are left out.
    """
    count = vertices.shape[0]
    projected, boxes, front, candidates, n_candidates = look_at_faces(vertices, lens, 0.0, faces, coloured)
    sides, n_sides = np.empty((count, edge_faces.shape[0] + 1), np.uint32), np.zeros(count, np.int64)
    find_outline(front, edge_faces, sides, n_sides)
    for s in range(count):
        n_sides[s] = n_sides[s] if boxes[s, 0] < boxes[s, 2] else 0
    return projected, boxes, candidates, n_candidates, sides, n_sides


@njit(**JIT)
def _make_room(projected, boxes, outline, ends):
    """Return the largest possible number of pixels and pieces of each body (n, 2), plus one that is only written to."""
    room = np.empty((projected.shape[0], 2), np.int64)
    for s in range(projected.shape[0]):
        box = boxes[s]
        room[s, 0] = (box[3] - box[1]) * (box[2] - box[0]) + 1
        room[s, 1] = count_pieces(outline[ends[s, 0] : ends[s + 1, 0]], projected[s], box) + 1
    return room


@entry
def draw_block(vertices, lens, faces, uv, edge_vertices, edge_faces, texture):
    """Draw up to LANES bodies.

    Args:
        vertices: (n, V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        edge_vertices: (E, 2), vertex numbers.
        edge_faces: (E, 2), faces on both sides.
        texture: (A, A, 4), the 4th channel 1; an empty one leaves codes and colours out.

    Returns:
        their trace, the premultiplied colours of their pixels, and the box around all of these (left, top, right,
        bottom).
    """
    count, width, coloured = vertices.shape[0], np.int64(lens[5]), texture.shape[0] > 0
    projected, boxes, candidates, n_candidates, sides, n_sides = _survey(vertices, lens, faces, edge_faces, coloured)
    outline, ends = np.empty((n_sides.sum(), 3), np.uint32), np.zeros((count + 1, 3), np.int64)
    for s in range(count):
        ends[s + 1, 0] = ends[s, 0] + n_sides[s]
        mine = outline[ends[s, 0] : ends[s + 1, 0]]
        trace_outline(sides[s, : n_sides[s]], edge_vertices, edge_faces, mine)
    room = _make_room(projected, boxes, outline, ends)
    n_pixels, n_pieces = room[:, 0].sum(), room[:, 1].sum()
    pixels, coverage = np.empty(n_pixels, np.int32), np.empty(n_pixels, np.float64)
    owner, edge, shares = (
        np.empty(n_pieces, np.int32),
        np.empty(n_pieces, np.int32),
        np.empty((n_pieces, 2), np.float64),
    )
    shown = n_pixels if coloured else 0
    codes, colours = np.empty(shown, np.int32), np.empty((shown, 4), texture.dtype)
    near, table = np.empty(GATHERED, texture.dtype), np.empty(FOUND, texture.dtype)
    places, rim = np.empty(PLACES, np.int32), np.empty(room[:, 0].max(), np.int32)
    mask, seen = np.int64(0), np.empty((0, 0), np.int64)
    around = np.array([width, np.int64(lens[6]), 0, 0])
    for s in range(count):
        mine, box = outline[ends[s, 0] : ends[s + 1, 0]], boxes[s]
        p, m = ends[s, 1], ends[s, 2]
        if coloured:
            mask = mask_for(faces, edge_faces)
            seen = see_faces(projected[s], faces, candidates[s, : n_candidates[s]], box, mask)
        n, moving = _trace(
            mine,
            projected[s],
            box,
            width,
            seen,
            mask,
            pixels[p : p + room[s, 0]],
            codes[p:],
            coverage[p:],
            owner[m : m + room[s, 1]],
            edge[m:],
            shares[m:],
        )
        if coloured:
            shade(
                pixels[p : p + n],
                codes[p : p + n],
                coverage[p : p + n],
                width,
                mine,
                projected[s],
                faces,
                uv,
                texture,
                near,
                table,
                places,
                rim,
                colours[p : p + n],
            )
        ends[s + 1, 1], ends[s + 1, 2] = p + n, m + moving
        if n > 0:
            around[0], around[1] = min(around[0], box[0]), min(around[1], box[1])
            around[2], around[3] = max(around[2], box[2]), max(around[3], box[3])
    n, moving = ends[count, 1], ends[count, 2]
    return (
        projected,
        outline,
        pixels[:n],
        coverage[:n],
        owner[:moving],
        edge[:moving],
        shares[:moving],
        codes[:n] if coloured else codes,
        ends,
        colours[:n] if coloured else colours,
        around,
    )


@loop_entry
def widen(texture, texels):
    """Copy a texture and set the fourth channel to one.

    Args:
        texture: (A, A, 3).
        texels: (A, A, 4), filled.
    """
    for r in range(texture.shape[0]):
        for c in range(texture.shape[1]):
            texels[r, c, 0], texels[r, c, 1], texels[r, c, 2] = texture[r, c, 0], texture[r, c, 1], texture[r, c, 2]
            texels[r, c, 3] = 1.0


@njit(**LOOP)
def _move_texels(sums, total):
    """Add the first three channels of `sums` (A, A, 4) to `total`, and set `sums` to zero."""
    for r in range(total.shape[0]):
        for c in range(total.shape[1]):
            for q in range(3):
                total[r, c, q] += sums[r, c, q]
            sums[r, c, 0], sums[r, c, 1], sums[r, c, 2], sums[r, c, 3] = 0.0, 0.0, 0.0, 0.0


@loop_entry
def move_texels(sums, total):
    """Add the first three channels of `sums` to `total`, and set `sums` to zero.

    Args:
        sums: (A, A, 4).
        total: (A, A, 3), added to.
    """
    _move_texels(sums, total)


@entry
def add_block(pixels, coverage, ends, colours, scale, pictures):
    """Add `scale` times a block's pixels to its bodies' images, or to the one image of all.

    Args:
        pixels: index of each listed pixel.
        coverage: coverage of each listed pixel.
        ends: (n + 1, 3), see the module.
        colours: (pixels, 4), premultiplied; empty for silhouettes alone.
        scale: factor of the images.
        pictures: (n or 1, H W, 4), added to; (n or 1, H W, 1) for silhouettes alone.
    """
    for s in range(ends.shape[0] - 1):
        picture = pictures[s if pictures.shape[0] > 1 else 0]
        if colours.shape[0] > 0:
            for m in range(ends[s, 1], ends[s + 1, 1]):
                add_scaled(picture, 4 * np.int64(pixels[m]), colours, 4 * m, scale)
        else:
            for m in range(ends[s, 1], ends[s + 1, 1]):
                picture[np.uint32(pixels[m]), 0] += min(coverage[m], 1.0) * scale


@njit(**LOOP)
def take(pixels, picture_gradient, scale, of_coverage):
    """Fill the gradient by each listed pixel's coverage from that by the silhouette's image.

    Args:
        pixels: index of each listed pixel.
        picture_gradient: (H W, 1).
        scale: factor of the images.
        of_coverage: gradient, filled.
    """
    for m in range(pixels.shape[0]):
        of_coverage[m] = picture_gradient[np.uint32(pixels[m]), 0] * scale


@entry
def block_backward(
    vertices, lens, faces, uv, texture, trace, first, last, of_pictures, scale, gradient, sums, closes, total
):
    """Compute the gradients of some bodies of a block.

    An empty `gradient` or `sums` is skipped.

    Args:
        vertices: (n, V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        texture: (A, A, 4), the 4th channel 1; an empty one leaves codes and colours out.
        trace: trace of the block.
        first: number of the first body.
        last: number after the last body.
        of_pictures: (n or 1, H W, C), gradient by the images.
        scale: factor of the images.
        gradient: (n, V, 3), filled.
        sums: (A, A, 4), gradient by the texture, added to.
        closes: (n), bodies after which the sums are moved to `total`.
        total: (A, A, 3), gradient by the texture, added to.
    """
    projected, outline, pixels, coverage, owner, edge, shares, codes, ends = trace
    near, table = np.empty(GATHERED, texture.dtype), np.empty(FOUND, texture.dtype)
    longest = 0
    for s in range(first, last):
        longest = max(longest, ends[s + 1, 1] - ends[s, 1])
    places, rim = np.empty(PLACES, np.int32), np.empty(longest + 1, np.int32)
    of_coverage, on_screen = np.empty(longest, np.float64), np.empty((gradient.shape[1], 4), np.float64)
    for s in range(first, last):
        mine, p, q = outline[ends[s, 0] : ends[s + 1, 0]], ends[s, 1], ends[s + 1, 1]
        grad_output = of_pictures[s if of_pictures.shape[0] > 1 else 0]
        on_screen[:] = 0.0
        if texture.shape[0] > 0:
            shade_gradient(
                np.int64(lens[5]),
                faces,
                uv,
                texture,
                projected[s],
                mine,
                pixels[p:q],
                coverage[p:q],
                codes[p:q],
                grad_output,
                scale,
                near,
                table,
                places,
                rim,
                of_coverage,
                on_screen,
                sums,
            )
        else:
            take(pixels[p:q], grad_output, scale, of_coverage)
        if gradient.shape[1] > 0:
            of_body = slice(ends[s, 2], ends[s + 1, 2])
            outline_backward(mine, projected[s], owner[of_body], edge[of_body], shares[of_body], of_coverage, on_screen)
            to_metres(projected[s], vertices[s], lens, on_screen, gradient[s])
        if closes[s]:
            _move_texels(sums, total)
