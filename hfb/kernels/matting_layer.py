"""Compiled objective of moving layers, its gradients and its descent, in single precision."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, SUM_INLINE, sum_entry

INSTANTS = 8

_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_SHARE = np.float32(1 / INSTANTS)
_CORNER = np.float32(1e-4)  # rounds |x| to sqrt(x^2 + 1e-4)
_SLOW, _FAST, _LEAST = np.float32(0.9), np.float32(0.95), np.float32(1e-8)  # Adam's


@njit(**INLINE)
def _split(place, length):
    """Return the pixel before a position and the share of the next one; positions outside count as the border."""
    inside = min(max(place, _ZERO), np.float32(length - 1))
    before = min(int(inside), length - 2)
    return before, inside - np.float32(before)


@njit(**INLINE)
def _shares(right, low):
    """Return the bilinear weights of the pixels top left, top right, bottom left and bottom right."""
    across, both = right * (_ONE - low), right * low
    return _ONE - low - across, across, low - both, both


@njit(**INLINE)
def _add(to, share, a, b, c, d):
    to[0] += share * a
    to[1] += share * b
    to[2] += share * c
    to[3] += share * d


@njit(**SUM_INLINE)
def smear(layer, way, smeared):
    """Average a layer along its way: fill `smeared` with the mean over the instants s of the layer at x - s way(x).

    Bilinear; -1/2 < s < 1/2; H and W are 2 at least.

    Args:
        layer: (H, W, 4), alpha and premultiplied colours.
        way: (H, W, 2), path of the layer's pixels during the exposure [px].
        smeared: (H, W, 4), filled.
    """
    height, width, _ = layer.shape
    for y in range(height):
        for x in range(width):
            across, down = way[y, x, 0], way[y, x, 1]
            a = b = c = d = _ZERO
            for instant in range(INSTANTS):
                time = (np.float32(instant) + _HALF) * _SHARE - _HALF
                left, right = _split(np.float32(x) - time * across, width)
                top, low = _split(np.float32(y) - time * down, height)
                p, q, r, s = _shares(right, low)
                one, two = layer[top, left], layer[top, left + 1]
                three, four = layer[top + 1, left], layer[top + 1, left + 1]
                a += p * one[0] + q * two[0] + r * three[0] + s * four[0]
                b += p * one[1] + q * two[1] + r * three[1] + s * four[1]
                c += p * one[2] + q * two[2] + r * three[2] + s * four[2]
                d += p * one[3] + q * two[3] + r * three[3] + s * four[3]
            out = smeared[y, x]
            out[0], out[1], out[2], out[3] = a * _SHARE, b * _SHARE, c * _SHARE, d * _SHARE


@njit(**SUM_INLINE)
def smear_gradient(layer, way, grad_output, of_layer, of_way):
    """Compute the gradients of `smear`.

    Args:
        layer: (H, W, 4), alpha and premultiplied colours.
        way: (H, W, 2), path of the layer's pixels during the exposure [px].
        grad_output: (H, W, 4), gradient by the smeared layer.
        of_layer: (H, W, 4), gradient, filled.
        of_way: (H, W, 2), gradient, filled.
    """
    height, width, _ = layer.shape
    right_end, low_end = np.float32(width - 1), np.float32(height - 1)
    of_layer[:] = _ZERO
    for y in range(height):
        for x in range(width):
            across, down = way[y, x, 0], way[y, x, 1]
            come = grad_output[y, x]
            a, b, c, d = come[0] * _SHARE, come[1] * _SHARE, come[2] * _SHARE, come[3] * _SHARE
            of_across = of_down = _ZERO
            for instant in range(INSTANTS):
                time = (np.float32(instant) + _HALF) * _SHARE - _HALF
                column, row = np.float32(x) - time * across, np.float32(y) - time * down
                left, right = _split(column, width)
                top, low = _split(row, height)
                p, q, r, s = _shares(right, low)
                one, two = layer[top, left], layer[top, left + 1]
                three, four = layer[top + 1, left], layer[top + 1, left + 1]
                e = a * one[0] + b * one[1] + c * one[2] + d * one[3]
                f = a * two[0] + b * two[1] + c * two[2] + d * two[3]
                g = a * three[0] + b * three[1] + c * three[2] + d * three[3]
                h = a * four[0] + b * four[1] + c * four[2] + d * four[3]
                if _ZERO < column < right_end:
                    of_across -= time * ((_ONE - low) * (f - e) + low * (h - g))
                if _ZERO < row < low_end:
                    of_down -= time * ((_ONE - right) * (g - e) + right * (h - f))
                _add(of_layer[top, left], p, a, b, c, d)
                _add(of_layer[top, left + 1], q, a, b, c, d)
                _add(of_layer[top + 1, left], r, a, b, c, d)
                _add(of_layer[top + 1, left + 1], s, a, b, c, d)
            of_way[y, x, 0], of_way[y, x, 1] = of_across, of_down


@njit(**INLINE)
def _cell(place, length, cells):
    """Return the cell and share of a grid whose first and last points are at the ends."""
    return _split(np.float32(place) * np.float32(cells - 1) / np.float32(length - 1), cells)


@njit(**SUM_INLINE)
def spread(base, bend, way):
    """Add a coarse grid to the way, bilinearly.

    Args:
        base: (H, W, 2), way before the grid is added [px].
        bend: (2, h, w), grid of what is added to the way [px].
        way: (H, W, 2), filled.
    """
    height, width, _ = base.shape
    _, rows, columns = bend.shape
    for y in range(height):
        top, low = _cell(y, height, rows)
        for x in range(width):
            left, right = _cell(x, width, columns)
            p, q, r, s = _shares(right, low)
            for axis in range(2):
                part = bend[axis]
                bent = p * part[top, left] + q * part[top, left + 1] + r * part[top + 1, left]
                way[y, x, axis] = base[y, x, axis] + bent + s * part[top + 1, left + 1]


@njit(**SUM_INLINE)
def spread_gradient(of_way, of_bend):
    """Compute the gradient of `spread` by the grid.

    Args:
        of_way: (H, W, 2), gradient by the way.
        of_bend: (2, h, w), gradient, filled.
    """
    height, width, _ = of_way.shape
    _, rows, columns = of_bend.shape
    of_bend[:] = _ZERO
    for y in range(height):
        top, low = _cell(y, height, rows)
        for x in range(width):
            left, right = _cell(x, width, columns)
            p, q, r, s = _shares(right, low)
            for axis in range(2):
                part, come = of_bend[axis], of_way[y, x, axis]
                part[top, left] += p * come
                part[top, left + 1] += q * come
                part[top + 1, left] += r * come
                part[top + 1, left + 1] += s * come


@njit(**SUM_INLINE)
def colour(outline, roots, layer):
    """Fill the layer with its outline and its premultiplied colours.

    Args:
        outline: (H, W), alpha of the layer in [0, 1].
        roots: (H, W, 3), square roots of its linear colours.
        layer: (H, W, 4), filled.
    """
    height, width = outline.shape
    for y in range(height):
        for x in range(width):
            layer[y, x, 0] = outline[y, x]
            for c in range(3):
                layer[y, x, c + 1] = outline[y, x] * roots[y, x, c] * roots[y, x, c]


@njit(**SUM_INLINE)
def unexplained(scene, weights, smeared, of_smeared):
    """Return how badly a smeared layer (a, c) explains the frame and the network's matte; fill the gradient.

    sum of R (sqrt(1 + |apart|^2 / R^2) - 1) + trust |a - alpha|, apart = (frame - c - (1 - a) plate) / noise.

    Args:
        scene: frame, plate, 1 / noise (H, W, 3 each), alpha and trust, in (H, W, 11).
        weights: see `objective`.
        smeared: (H, W, 4).
        of_smeared: (H, W, 4), gradient by the smeared layer, filled.
    """
    height, width, _ = scene.shape
    robust = weights[0]
    loss = 0.0
    for y in range(height):
        for x in range(width):
            here, seen, pull = smeared[y, x], scene[y, x], of_smeared[y, x]
            square = _ZERO
            for c in range(3):
                apart = seen[6 + c] * (seen[c] - here[c + 1] - (_ONE - here[0]) * seen[3 + c]) / robust
                pull[c + 1] = apart
                square += apart * apart
            root = np.sqrt(_ONE + square)
            error = here[0] - seen[9]
            length = np.sqrt(error * error + _CORNER)
            of_alpha = seen[10] * error / length
            for c in range(3):
                pull[c + 1] *= -seen[6 + c] / root
                of_alpha -= pull[c + 1] * seen[3 + c]
            pull[0] = of_alpha
            loss += robust * (root - _ONE) + seen[10] * length
    return loss


@njit(**SUM_INLINE)
def oddness(outline, roots, weights, of_outline, of_roots):
    """Return how implausible an outline m and colours are; add the gradients.

    It is the sum of S m (1 - m) + C |difference of roots| + O |difference of m|, over neighbours.

    Args:
        outline: (H, W), alpha of the layer in [0, 1].
        roots: (H, W, 3), square roots of its linear colours.
        weights: R, S, C and O of `unexplained` and `oddness`, and that of `bending`.
        of_outline: gradient, added to.
        of_roots: gradient, added to.
    """
    height, width = outline.shape
    _, soft, changes, edges, _ = weights
    loss = 0.0
    for y in range(height):
        for x in range(width):
            mine = outline[y, x]
            loss += soft * mine * (_ONE - mine)
            of_outline[y, x] += soft * (_ONE - _TWO * mine)
            for axis in range(2):
                v, u = y + axis, x + 1 - axis
                if v == height or u == width:
                    continue
                step = outline[v, u] - mine
                length = np.sqrt(step * step + _CORNER)
                loss += edges * length
                of_outline[v, u] += edges * step / length
                of_outline[y, x] -= edges * step / length
                square = _CORNER
                for c in range(3):
                    square += (roots[v, u, c] - roots[y, x, c]) ** 2
                length = np.sqrt(square)
                loss += changes * length
                for c in range(3):
                    pull = changes * (roots[v, u, c] - roots[y, x, c]) / length
                    of_roots[v, u, c] += pull
                    of_roots[y, x, c] -= pull
    return loss


@njit(**SUM_INLINE)
def bending(bend, weights, of_bend):
    """Return the weighted squares of a grid's differences; add the gradient.

    Args:
        bend: (2, h, w), grid of what is added to the way [px].
        weights: R, S, C and O of `unexplained` and `oddness`, and that of `bending`.
        of_bend: gradient, added to.
    """
    _, rows, columns = bend.shape
    weight = weights[4]
    loss = 0.0
    for axis in range(2):
        for y in range(rows):
            for x in range(columns):
                for v, u in ((y + 1, x), (y, x + 1)):
                    if v < rows and u < columns:
                        step = bend[axis, v, u] - bend[axis, y, x]
                        loss += weight * step * step
                        of_bend[axis, v, u] += _TWO * weight * step
                        of_bend[axis, y, x] -= _TWO * weight * step
    return loss


@njit(**SUM_INLINE)
def objective(scene, weights, base, outline, roots, bend, way, layers, of_outline, of_roots, of_way, of_bend):
    """Return how badly a layer explains the frame, and how implausible it is; fill the gradients and the way.

    Args:
        scene: see `unexplained`.
        weights: R, S, C and O of `unexplained` and `oddness`, and that of `bending`.
        base: (H, W, 2), to which the grid `bend` (2, h, w) adds.
        outline: (H, W), alpha of the layer in [0, 1].
        roots: (H, W, 3), square roots of its linear colours.
        bend: (2, h, w), grid of what is added to the way [px].
        way: (H, W, 2), filled.
        layers: (4, H, W, 4), filled with the layer, its mean along the way, and their gradients.
        of_outline: gradient, filled.
        of_roots: gradient, filled.
        of_way: (H, W, 2), gradient, filled.
        of_bend: gradient, filled.
    """
    spread(base, bend, way)
    colour(outline, roots, layers[0])
    smear(layers[0], way, layers[1])
    loss = unexplained(scene, weights, layers[1], layers[3])
    smear_gradient(layers[0], way, layers[3], layers[2], of_way)
    spread_gradient(of_way, of_bend)
    height, width = outline.shape
    for y in range(height):
        for x in range(width):
            of_layer = layers[2, y, x]
            total = of_layer[0]
            for c in range(3):
                total += of_layer[c + 1] * roots[y, x, c] * roots[y, x, c]
                of_roots[y, x, c] = of_layer[c + 1] * _TWO * roots[y, x, c] * outline[y, x]
            of_outline[y, x] = total
    return loss + oddness(outline, roots, weights, of_outline, of_roots) + bending(bend, weights, of_bend)


@njit(**INLINE)
def _adam(variables, gradient, rate, step, moments):
    """Run one step; moments (2, n) are the running means of gradient and square."""
    first, second = moments
    scale = rate / (_ONE - _SLOW**step)
    unbiased = _ONE / (_ONE - _FAST**step)
    for k in range(len(variables)):
        first[k] += (_ONE - _SLOW) * (gradient[k] - first[k])
        second[k] += (_ONE - _FAST) * (gradient[k] * gradient[k] - second[k])
        variables[k] -= scale * first[k] / (np.sqrt(second[k] * unbiased) + _LEAST)


@sum_entry
def descend(scene, weights, base, rates, steps, logits, roots, bend, way, layers, planes, colours, ways, bends):
    """Run Adam, in place, from zero moments; return the last step's loss, before that step.

    Args:
        scene: see `unexplained`.
        weights: R, S, C and O of `unexplained` and `oddness`, and that of `bending`.
        base: (H, W, 2), way before the grid is added [px].
        rates: learning rates of the outline's logits, of the roots and of the grid; 0 keeps one fixed.
        steps: number of steps.
        logits: (H, W), of the outline, updated.
        roots: (H, W, 3), square roots of its linear colours, updated.
        bend: (2, h, w), grid of what is added to the way [px], updated.
        way: as in `objective`.
        layers: as in `objective`.
        planes: (4, H, W), work space.
        colours: (3, H, W, 3), work space.
        ways: (H, W, 2), work space.
        bends: (3, 2, h, w), work space.
    """
    outline, of_outline = planes[0], planes[1]
    planes[2:] = _ZERO
    colours[1:] = _ZERO
    bends[1:] = _ZERO
    height, width = logits.shape
    loss = 0.0
    for step in range(1, steps + 1):
        for y in range(height):
            for x in range(width):
                outline[y, x] = _ONE / (_ONE + np.exp(-logits[y, x]))
        loss = objective(
            scene, weights, base, outline, roots, bend, way, layers, of_outline, colours[0], ways, bends[0]
        )
        for y in range(height):
            for x in range(width):
                of_outline[y, x] *= outline[y, x] * (_ONE - outline[y, x])
        now = np.float32(step)
        _adam(logits.reshape(-1), of_outline.reshape(-1), rates[0], now, planes[2:].reshape(2, -1))
        _adam(roots.reshape(-1), colours[0].reshape(-1), rates[1], now, colours[1:].reshape(2, -1))
        if rates[2] > _ZERO:
            _adam(bend.reshape(-1), bends[0].reshape(-1), rates[2], now, bends[1:].reshape(2, -1))
    return loss
