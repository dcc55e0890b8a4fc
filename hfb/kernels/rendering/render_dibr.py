"""Compiled entry points for DIB-R's soft silhouette (`reference_dibr` has the formulas and their source).

A body's trace has the same parts as in `render_block`, with other contents: the outline is the nearest side of a
face (from, to, face) for each pixel of the halo, which gives the halo its colour; the overlaps are the halo's
pixels paired with the faces that reach them: owner, side (3 face + corner), and the derivative of R_S by the
squared distance.

`soft` is (1 / delta [1/px^2], reach [px], number of faces that count).
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, JIT, LOOP, entry
from hfb.kernels.rendering.render_block import take
from hfb.kernels.rendering.render_outline import closest_parameter
from hfb.kernels.rendering.render_screen import code_of, mask_for, see_body, to_metres
from hfb.kernels.rendering.render_shading import FOUND, GATHERED, PLACES, shade, shade_gradient

TIE = 1e-9


@njit(**INLINE)
def _squared(px, py, x0, y0, dx, dy, scale):
    """Return squared distance of a point from a side that starts at (x0, y0); scale is 1 / squared length."""
    rx, ry = px - x0, py - y0
    t = min(max((rx * dx + ry * dy) * scale, 0.0), 1.0)
    rx, ry = rx - t * dx, ry - t * dy
    return rx * rx + ry * ry


@njit(**INLINE)
def _scale(dx, dy):
    squared_length = dx * dx + dy * dy
    return 1.0 / squared_length if squared_length > 0.0 else 0.0


@njit(**INLINE)
def _sift(distance, side, slot, k, value, which):
    """Put (value, which) at place k of a full heap or below it; the largest distance stays on top."""
    size = distance.shape[1]
    while True:
        child = 2 * k + 1
        if child >= size:
            break
        if child + 1 < size:
            child += distance[slot, child + 1] > distance[slot, child]
        if distance[slot, child] <= value:
            break
        distance[slot, k], side[slot, k] = distance[slot, child], side[slot, child]
        k = child
    distance[slot, k], side[slot, k] = value, which


@njit(**INLINE)
def _keep(distance, side, filled, slot, value, which):
    """Store a face if it is among the nearest: a list until that is full, from then on a heap."""
    n = filled[slot]
    if n < distance.shape[1]:
        distance[slot, n], side[slot, n] = value, which
        filled[slot] = n + 1
        if n + 1 == distance.shape[1]:
            for k in range(n // 2, -1, -1):
                _sift(distance, side, slot, k, distance[slot, k], side[slot, k])
    elif value < distance[slot, 0]:
        _sift(distance, side, slot, 0, value, which)


@njit(**LOOP)
def _count_open(seen, open_before):
    """Count, along each row, the pixels that show no body; return their number."""
    total = 0
    for r in range(seen.shape[0]):
        open_before[r, 0] = 0
        for c in range(seen.shape[1]):
            open_before[r, c + 1] = open_before[r, c] + (seen[r, c] <= 0)
        total += open_before[r, seen.shape[1]]
    return total


@njit(**LOOP)
def _reach_out(projected, faces, reach, box, seen, open_before, slots, distance, side, filled):
    """Keep for each pixel of the halo the squared distances and sides of its nearest faces; returns their number."""
    found = 0
    left, top, right, bottom = box[0], box[1], box[2], box[3]
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if projected[i, 2] <= 0.0 or projected[j, 2] <= 0.0 or projected[k, 2] <= 0.0:
            continue
        x0, y0, x1, y1 = projected[i, 0], projected[i, 1], projected[j, 0], projected[j, 1]
        x2, y2 = projected[k, 0], projected[k, 1]
        x_low, x_high, y_low, y_high = min(x0, x1, x2), max(x0, x1, x2), min(y0, y1, y2), max(y0, y1, y2)
        c_from = int(np.ceil(max(x_low - reach - 0.5, left)))
        c_to = int(np.floor(min(x_high + reach - 0.5, right - 1.0)))
        r_from = int(np.ceil(max(y_low - reach - 0.5, top)))
        r_to = int(np.floor(min(y_high + reach - 0.5, bottom - 1.0)))
        if c_from > c_to:
            continue
        ax, ay, bx, by, cx, cy = x1 - x0, y1 - y0, x2 - x1, y2 - y1, x0 - x2, y0 - y2
        a_scale, b_scale, c_scale = _scale(ax, ay), _scale(bx, by), _scale(cx, cy)
        for r in range(r_from - top, r_to - top + 1):
            if open_before[r, c_to + 1 - left] == open_before[r, c_from - left]:
                continue
            py = r + top + 0.5
            dy = max(y_low - py, py - y_high, 0.0)
            for c in range(c_from - left, c_to - left + 1):
                if seen[r, c] > 0:
                    continue
                slot = slots[r, c] - 1
                if slot < 0:
                    slot = found
                    found += 1
                    slots[r, c] = found
                    filled[slot] = 0
                px = c + left + 0.5
                dx = max(x_low - px, px - x_high, 0.0)
                if filled[slot] == distance.shape[1] and dx * dx + dy * dy >= distance[slot, 0]:
                    continue  # not even the face's bounding box is near enough
                a = _squared(px, py, x0, y0, ax, ay, a_scale)
                b = _squared(px, py, x1, y1, bx, by, b_scale)
                squared = min(a, b, _squared(px, py, x2, y2, cx, cy, c_scale))
                which = 0 if a <= squared + TIE else (1 if b <= squared + TIE else 2)  # of equals the first
                _keep(distance, side, filled, slot, squared, 3 * f + which)
    return found


@njit(**LOOP)
def _nearest_face(distance, side, slot, n):
    """Place of the nearest face (of equals the first face) in a pixel's heap."""
    best = 0
    for q in range(1, n):
        apart = distance[slot, q] - distance[slot, best]
        if apart < -TIE or (apart < TIE and side[slot, q] < side[slot, best]):
            best = q
    return best


@njit(**LOOP)
def _combine(distance, slot, n, inverse_delta, missed, slopes):
    """Return R_S of one halo pixel; `slopes` gets its derivatives by the squared distances (products without one)."""
    before = 1.0
    for q in range(n):
        missed[q] = 1.0 - np.exp(-inverse_delta * distance[slot, q])
        slopes[q] = before
        before *= missed[q]
    after = 1.0
    for q in range(n - 1, -1, -1):
        slopes[q] *= -inverse_delta * (1.0 - missed[q]) * after
        after *= missed[q]
    return 1.0 - before


@njit(**LOOP)
def _list_pixels(
    box,
    width,
    seen,
    mask,
    slots,
    faces,
    inverse_delta,
    distance,
    side,
    filled,
    missed,
    slopes,
    pixels,
    codes,
    coverage,
    outline,
    owner,
    of_side,
    weights,
):
    """Fill the lists of the trace, pixels in reading order; returns the numbers of pixels, halo pixels and pairs."""
    n, halo, pairs = 0, 0, 0
    for r in range(seen.shape[0]):
        for c in range(seen.shape[1]):
            slot = slots[r, c] - 1
            if seen[r, c] > 0:
                codes[n], coverage[n] = code_of(seen[r, c], mask), 1.0
            elif slot >= 0:
                found = filled[slot]
                codes[n], coverage[n] = ~halo, _combine(distance, slot, found, inverse_delta, missed, slopes)
                best = side[slot, _nearest_face(distance, side, slot, found)]
                f, corner = best // 3, best % 3
                outline[halo, 0], outline[halo, 1], outline[halo, 2] = faces[f, corner], faces[f, (corner + 1) % 3], f
                halo += 1
                for q in range(found):
                    owner[pairs], of_side[pairs], weights[pairs] = n, side[slot, q], slopes[q]
                    pairs += 1
            else:
                continue
            pixels[n] = (r + box[1]) * width + c + box[0]
            n += 1
    return n, halo, pairs


@njit(**JIT)
def _trace(projected, faces, box, width, seen, mask, soft):
    """Return (outline, pixels, coverage, owners, sides, weights, codes) of one body's soft silhouette."""
    height, breadth = seen.shape
    open_before = np.empty((height, breadth + 1), np.int32)
    n_open = _count_open(seen, open_before)
    most = int(soft[2])
    slots = np.zeros((height, breadth), np.int32)
    distance, side = np.empty((n_open, most), np.float64), np.empty((n_open, most), np.int32)
    filled = np.empty(n_open, np.int32)
    n_halo = _reach_out(projected, faces, soft[1], box, seen, open_before, slots, distance, side, filled)
    room = height * breadth - n_open + n_halo
    pixels, codes, coverage = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.float64)
    outline, owner = np.empty((n_halo, 3), np.uint32), np.empty(n_halo * most, np.int32)
    of_side, weights = np.empty(n_halo * most, np.int32), np.empty(n_halo * most, np.float64)
    _, _, pairs = _list_pixels(
        box,
        width,
        seen,
        mask,
        slots,
        faces,
        soft[0],
        distance,
        side,
        filled,
        np.empty(most),
        np.empty(most),
        pixels,
        codes,
        coverage,
        outline,
        owner,
        of_side,
        weights,
    )
    return (outline, pixels, coverage, owner[:pairs], of_side[:pairs], weights[:pairs], codes)


@njit(**JIT)
def _soften(vertices, lens, soft, faces):
    """Project, draw the centres, reach out: (projected, then what `_trace` returns)."""
    mask = mask_for(faces, faces)
    projected, box, seen = see_body(vertices, lens, soft[1], faces, mask)
    return projected, _trace(projected, faces, box, np.int64(lens[5]), seen, mask, soft)


@entry
def cover_body_softly(vertices, lens, soft, faces):
    """Draw the soft silhouette of one body; return its trace.

    Args:
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        soft: 1 / delta [1/px^2], reach [px], number of faces that count.
        faces: (F, 3), vertex numbers.
    """
    projected, (outline, pixels, coverage, owner, of_side, weights, _) = _soften(vertices, lens, soft, faces)
    return projected, outline, pixels, coverage, owner, of_side, weights


@entry
def draw_body_softly(vertices, lens, soft, faces, uv, texture):
    """Draw one body; return its trace, then the pixels' codes and premultiplied colours.

    Args:
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        soft: 1 / delta [1/px^2], reach [px], number of faces that count.
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        texture: (A, A, 4), the 4th channel 1.
    """
    projected, (outline, pixels, coverage, owner, of_side, weights, codes) = _soften(vertices, lens, soft, faces)
    colours = np.empty((pixels.shape[0], 4), texture.dtype)
    near, table = np.empty(GATHERED, texture.dtype), np.empty(FOUND, texture.dtype)
    places, rim = np.empty(PLACES, np.int32), np.empty(pixels.shape[0] + 1, np.int32)
    shade(
        pixels,
        codes,
        coverage,
        np.int64(lens[5]),
        outline,
        projected,
        faces,
        uv,
        texture,
        near,
        table,
        places,
        rim,
        colours,
    )
    return projected, outline, pixels, coverage, owner, of_side, weights, codes, colours


@njit(**LOOP)
def _faces_backward(width, faces, projected, pixels, owner, of_side, weights, of_coverage, on_screen):
    """Add the pull of every halo pixel's R_S on the sides that reach it: d(distance^2) = -2 (p - closest) . v."""
    before, px, py = -1, 0.0, 0.0
    for p in range(owner.shape[0]):
        n = owner[p]
        if n != before:
            before, row = n, pixels[n] // width
            px, py = pixels[n] - row * width + 0.5, row + 0.5
        f, corner = np.uint32(of_side[p] // 3), np.uint32(of_side[p] % 3)
        i, j = faces[f, corner], faces[f, corner + 1 if corner < 2 else 0]
        x0, y0 = projected[i, 0], projected[i, 1]
        dx, dy = projected[j, 0] - x0, projected[j, 1] - y0
        t = closest_parameter(px, py, x0, y0, dx, dy)
        pull = -2.0 * of_coverage[n] * weights[p]
        rx, ry = (px - x0 - t * dx) * pull, (py - y0 - t * dy) * pull
        on_screen[i, 0] += (1.0 - t) * rx
        on_screen[i, 1] += (1.0 - t) * ry
        on_screen[j, 0] += t * rx
        on_screen[j, 1] += t * ry


@entry
def cover_body_softly_gradient(vertices, lens, faces, trace, picture_gradient, scale, gradient):
    """Compute the gradient of a silhouette by the vertices.

    Args:
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        faces: (F, 3), vertex numbers.
        trace: trace of the body.
        picture_gradient: (H W, 1).
        scale: factor of the image.
        gradient: (V, 3), filled.
    """
    projected, _, pixels, _, owner, of_side, weights = trace
    on_screen, of_coverage = np.zeros((vertices.shape[0], 3), np.float64), np.empty(pixels.shape[0], np.float64)
    take(pixels, picture_gradient, scale, of_coverage)
    _faces_backward(np.int64(lens[5]), faces, projected, pixels, owner, of_side, weights, of_coverage, on_screen)
    to_metres(projected, vertices, lens, on_screen, gradient)


@entry
def draw_body_softly_gradient(
    vertices, lens, faces, uv, texture, trace, codes, picture_gradient, scale, gradient, texture_gradient
):
    """Compute the gradients of `draw_body_softly`.

    An empty `gradient` or `texture_gradient` is skipped.

    Args:
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        texture: (A, A, 4), the 4th channel 1.
        trace: trace of the body.
        codes: codes of the pixels.
        picture_gradient: (H W, 4).
        scale: factor of the image.
        gradient: (V, 3), filled.
        texture_gradient: (A, A, 4), added to.
    """
    projected, outline, pixels, coverage, owner, of_side, weights = trace
    width = np.int64(lens[5])
    on_screen, of_coverage = np.zeros((gradient.shape[0], 4), np.float64), np.empty(pixels.shape[0], np.float64)
    near, table = np.empty(GATHERED, texture.dtype), np.empty(FOUND, texture.dtype)
    places, rim = np.empty(PLACES, np.int32), np.empty(pixels.shape[0] + 1, np.int32)
    shade_gradient(
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
    )
    if gradient.shape[0] > 0:
        _faces_backward(width, faces, projected, pixels, owner, of_side, weights, of_coverage, on_screen)
        to_metres(projected, vertices, lens, on_screen, gradient)
