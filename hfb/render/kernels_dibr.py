"""Compiled entry points for DIB-R's soft silhouette (`reference_dibr` has the formulas and their source).

A body's trace has the same parts as in `kernels`, with other contents: the outline is the nearest side of a
face (from, to, face) for each pixel of the halo, which gives the halo its colour; the overlaps are the halo's
pixels paired with the faces that reach them: owner, side (3 face + corner), and the weights (derivative of
R_S by the squared distance, unused).

`soft` is (1 / delta [1/px^2], reach [px], number of faces that count).
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.render.kernels import take
from hfb.render.kernels_compile import INLINE, JIT, LOOP, entry
from hfb.render.kernels_outline import closest_parameter, code_of, mask_for
from hfb.render.kernels_screen import project, to_metres
from hfb.render.kernels_surface import see_faces, shade, shade_gradient

TIE = 1e-9


@njit(**INLINE)
def _nearest_side(px, py, x0, y0, x1, y1, x2, y2):
    """Squared distance of a point from a face's nearest side (of equals the first), and which side."""
    best, which = np.inf, 0
    for side in range(3):
        t = closest_parameter(px, py, x0, y0, x1 - x0, y1 - y0)
        rx, ry = px - x0 - t * (x1 - x0), py - y0 - t * (y1 - y0)
        squared = rx * rx + ry * ry
        if squared < best - TIE:
            best, which = squared, side
        x0, y0, x1, y1, x2, y2 = x1, y1, x2, y2, x0, y0
    return best, which


@njit(**INLINE)
def _sift(distance, side, slot, k, value, which):
    """Put (value, which) at place k of a heap or below it; the largest distance stays on top."""
    size = distance.shape[1]
    while True:
        child = 2 * k + 1
        if child >= size:
            break
        if child + 1 < size and distance[slot, child + 1] > distance[slot, child]:
            child += 1
        if distance[slot, child] <= value:
            break
        distance[slot, k], side[slot, k] = distance[slot, child], side[slot, child]
        k = child
    distance[slot, k], side[slot, k] = value, which


@njit(**LOOP)
def _count_open(seen, open_before):
    """Running count, along each row, of the pixels that show no body; returns their number."""
    total = 0
    for r in range(seen.shape[0]):
        open_before[r, 0] = 0
        for c in range(seen.shape[1]):
            open_before[r, c + 1] = open_before[r, c] + (seen[r, c] <= 0)
        total += open_before[r, seen.shape[1]]
    return total


@njit(**LOOP)
def _reach_out(projected, faces, reach, box, seen, open_before, slots, distance, side):
    """Keep for each pixel of the halo the squared distances and sides of its nearest faces; returns their number."""
    found = 0
    left, top, right, bottom = box[0], box[1], box[2], box[3]
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if projected[i, 2] <= 0.0 or projected[j, 2] <= 0.0 or projected[k, 2] <= 0.0:
            continue
        x0, y0, x1, y1 = projected[i, 0], projected[i, 1], projected[j, 0], projected[j, 1]
        x2, y2 = projected[k, 0], projected[k, 1]
        c_from = int(np.ceil(max(min(x0, x1, x2) - reach - 0.5, left)))
        c_to = int(np.floor(min(max(x0, x1, x2) + reach - 0.5, right - 1.0)))
        r_from = int(np.ceil(max(min(y0, y1, y2) - reach - 0.5, top)))
        r_to = int(np.floor(min(max(y0, y1, y2) + reach - 0.5, bottom - 1.0)))
        if c_from > c_to:
            continue
        for r in range(r_from - top, r_to - top + 1):
            if open_before[r, c_to + 1 - left] == open_before[r, c_from - left]:
                continue
            for c in range(c_from - left, c_to - left + 1):
                if seen[r, c] > 0:
                    continue
                slot = slots[r, c] - 1
                if slot < 0:
                    slot = found
                    found += 1
                    slots[r, c] = found
                    for q in range(distance.shape[1]):
                        distance[slot, q] = np.inf
                squared, which = _nearest_side(c + left + 0.5, r + top + 0.5, x0, y0, x1, y1, x2, y2)
                if squared < distance[slot, 0]:
                    _sift(distance, side, slot, 0, squared, 3 * f + which)
    return found


@njit(**LOOP)
def _nearest_face(distance, side, slot):
    """Place of the nearest face (of equals the first face) in a pixel's heap."""
    best = 0
    for q in range(1, distance.shape[1]):
        apart = distance[slot, q] - distance[slot, best]
        if apart < -TIE or (apart < TIE and side[slot, q] < side[slot, best]):
            best = q
    return best


@njit(**LOOP)
def _combine(distance, slot, inverse_delta, missed, slopes):
    """R_S of one halo pixel; `slopes` receives its derivatives by the squared distances (products without one)."""
    most = distance.shape[1]
    before = 1.0
    for q in range(most):
        missed[q] = 1.0 - np.exp(-inverse_delta * distance[slot, q])
        slopes[q] = before
        before *= missed[q]
    after = 1.0
    for q in range(most - 1, -1, -1):
        slopes[q] *= -inverse_delta * (1.0 - missed[q]) * after
        after *= missed[q]
    return 1.0 - before


@njit(**LOOP)
def _list_pixels(
    box, width, seen, mask, slots, faces, inverse_delta, distance, side, missed, slopes,
    pixels, codes, coverage, outline, owner, of_side, weights,
):  # fmt: skip
    """Fill the lists of the trace, pixels in reading order; returns the numbers of pixels, halo pixels and pairs."""
    n, halo, pairs = 0, 0, 0
    for r in range(seen.shape[0]):
        for c in range(seen.shape[1]):
            slot = slots[r, c] - 1
            if seen[r, c] > 0:
                codes[n], coverage[n] = code_of(seen[r, c], mask), 1.0
            elif slot >= 0:
                codes[n], coverage[n] = ~halo, _combine(distance, slot, inverse_delta, missed, slopes)
                best = side[slot, _nearest_face(distance, side, slot)]
                f, corner = best // 3, best % 3
                outline[halo, 0], outline[halo, 1], outline[halo, 2] = faces[f, corner], faces[f, (corner + 1) % 3], f
                halo += 1
                for q in range(distance.shape[1]):
                    if distance[slot, q] < np.inf:
                        owner[pairs], of_side[pairs], weights[pairs, 0] = n, side[slot, q], slopes[q]
                        pairs += 1
            else:
                continue
            pixels[n] = (r + box[1]) * width + c + box[0]
            n += 1
    return n, halo, pairs


@njit(**JIT)
def _trace(projected, faces, box, width, seen, mask, soft):
    """(outline, pixels, coverage, owners, sides, weights, codes) of one body's soft silhouette."""
    height, breadth = seen.shape
    open_before = np.empty((height, breadth + 1), np.int32)
    n_open = _count_open(seen, open_before)
    most = int(soft[2])
    slots = np.zeros((height, breadth), np.int32)
    distance, side = np.empty((n_open, most), np.float64), np.empty((n_open, most), np.int32)
    n_halo = _reach_out(projected, faces, soft[1], box, seen, open_before, slots, distance, side)
    room = height * breadth - n_open + n_halo
    pixels, codes, coverage = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.float64)
    outline, owner = np.empty((n_halo, 3), np.uint32), np.empty(n_halo * most, np.int32)
    of_side, weights = np.empty(n_halo * most, np.int32), np.empty((n_halo * most, 2), np.float64)
    _, _, pairs = _list_pixels(
        box, width, seen, mask, slots, faces, soft[0], distance, side, np.empty(most), np.empty(most),
        pixels, codes, coverage, outline, owner, of_side, weights,
    )  # fmt: skip
    return (outline, pixels, coverage, owner[:pairs], of_side[:pairs], weights[:pairs], codes)


@njit(**JIT)
def _soften(vertices, lens, soft, faces):
    """Project, draw the centres, reach out: (projected, then what `_trace` returns)."""
    box = np.empty(4, np.int64)
    projected, mask = np.empty((vertices.shape[0], 3), np.float64), mask_for(faces, faces)
    project(vertices, lens, soft[1], projected, box)
    seen, _ = see_faces(projected, faces, box, mask)
    return projected, _trace(projected, faces, box, np.int64(lens[5]), seen, mask, soft)


@entry
def cover_body_softly(vertices, lens, soft, faces):
    """Soft silhouette of one body: its trace."""
    projected, (outline, pixels, coverage, owner, of_side, weights, _) = _soften(vertices, lens, soft, faces)
    return projected, outline, pixels, coverage, owner, of_side, weights


@entry
def draw_body_softly(vertices, lens, soft, faces, uv, texture):
    """One body: its trace, then the pixels' codes and premultiplied colours. The texture's 4th channel is 1."""
    projected, (outline, pixels, coverage, owner, of_side, weights, codes) = _soften(vertices, lens, soft, faces)
    colours = np.empty((pixels.shape[0], 4), texture.dtype)
    shade(pixels, codes, coverage, np.int64(lens[5]), outline, projected, faces, uv, texture, colours)
    return projected, outline, pixels, coverage, owner, of_side, weights, codes, colours


@njit(**LOOP)
def _pull_faces(width, faces, projected, pixels, owner, of_side, weights, of_coverage, on_screen):
    """Add the pull of every halo pixel's R_S on the sides that reach it: d(distance^2) = -2 (p - closest) . v."""
    for p in range(owner.shape[0]):
        n = owner[p]
        px, py = pixels[n] % width + 0.5, pixels[n] // width + 0.5
        f, corner = of_side[p] // 3, of_side[p] % 3
        i, j = faces[f, corner], faces[f, (corner + 1) % 3]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        t = closest_parameter(px, py, x0, y0, dx, dy)
        pull = -2.0 * of_coverage[n] * weights[p, 0]
        rx, ry = (px - x0 - t * dx) * pull, (py - y0 - t * dy) * pull
        on_screen[i, 0] += (1.0 - t) * rx
        on_screen[i, 1] += (1.0 - t) * ry
        on_screen[j, 0] += t * rx
        on_screen[j, 1] += t * ry


@entry
def cover_body_softly_gradient(vertices, lens, faces, trace, picture_gradient, scale, gradient):
    """Fill `gradient` (V, 3) with scale times the gradient of a silhouette whose picture's is given (H W, 1)."""
    projected, _, pixels, _, owner, of_side, weights = trace
    on_screen, of_coverage = np.zeros((vertices.shape[0], 3), np.float64), np.empty(pixels.shape[0], np.float64)
    take(pixels, picture_gradient, scale, of_coverage)
    _pull_faces(np.int64(lens[5]), faces, projected, pixels, owner, of_side, weights, of_coverage, on_screen)
    to_metres(projected, vertices, lens, on_screen, gradient)


@entry
def draw_body_softly_gradient(
    vertices, lens, faces, uv, texture, trace, codes, picture_gradient, scale, gradient, texture_gradient
):
    """Fill `gradient` (V, 3), add to `texture_gradient`, from that of the picture (H W, 4), times scale.

    An empty `gradient` or `texture_gradient` leaves that one out.
    """
    projected, outline, pixels, coverage, owner, of_side, weights = trace
    width = np.int64(lens[5])
    on_screen, of_coverage = np.zeros((gradient.shape[0], 3), np.float64), np.empty(pixels.shape[0], np.float64)
    shade_gradient(
        width, faces, uv, texture, projected, outline, pixels, coverage, codes,
        picture_gradient, scale, of_coverage, on_screen, texture_gradient,
    )  # fmt: skip
    if gradient.shape[0] > 0:
        _pull_faces(width, faces, projected, pixels, owner, of_side, weights, of_coverage, on_screen)
        to_metres(projected, vertices, lens, on_screen, gradient)
