"""Compiled: layers averaged on their way through an exposure, and the way back. In single precision throughout."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import INLINE, sum_entry

_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


@njit(**INLINE)
def _split(place, length):
    """The pixel before a place and the share of the one behind it; places outside count as the border."""
    inside = min(max(place, _ZERO), np.float32(length - 1))
    before = min(int(inside), length - 2)
    return before, inside - np.float32(before)


@njit(**INLINE)
def _shares(right, low):
    """Of the pixels top left, top right, bottom left and bottom right."""
    across, both = right * (_ONE - low), right * low
    return _ONE - low - across, across, low - both, both


@njit(**INLINE)
def _add(to, share, a, b, c, d):
    to[0] += share * a
    to[1] += share * b
    to[2] += share * c
    to[3] += share * d


@sum_entry
def smear(layers, way, instants, smeared):
    """Fills smeared (N, H, W, 4) with the mean over the instants s of layers (N, H, W, 4) at x - s way(x).

    Bilinear; -1/2 < s < 1/2; way (N, H, W, 2) [px]; H and W are 2 at least.
    """
    count, height, width, _ = layers.shape
    share = np.float32(1 / instants)
    for n in range(count):
        for y in range(height):
            for x in range(width):
                across, down = way[n, y, x, 0], way[n, y, x, 1]
                a = b = c = d = _ZERO
                for instant in range(instants):
                    time = (np.float32(instant) + _HALF) * share - _HALF
                    left, right = _split(np.float32(x) - time * across, width)
                    top, low = _split(np.float32(y) - time * down, height)
                    p, q, r, s = _shares(right, low)
                    one, two = layers[n, top, left], layers[n, top, left + 1]
                    three, four = layers[n, top + 1, left], layers[n, top + 1, left + 1]
                    a += p * one[0] + q * two[0] + r * three[0] + s * four[0]
                    b += p * one[1] + q * two[1] + r * three[1] + s * four[1]
                    c += p * one[2] + q * two[2] + r * three[2] + s * four[2]
                    d += p * one[3] + q * two[3] + r * three[3] + s * four[3]
                out = smeared[n, y, x]
                out[0], out[1], out[2], out[3] = a * share, b * share, c * share, d * share


@sum_entry
def smear_gradient(layers, way, instants, given, of_layers, of_way):
    """From the smeared layers' gradient: adds to of_layers (zeros), fills of_way."""
    count, height, width, _ = layers.shape
    share = np.float32(1 / instants)
    right_end, low_end = np.float32(width - 1), np.float32(height - 1)
    for n in range(count):
        for y in range(height):
            for x in range(width):
                across, down = way[n, y, x, 0], way[n, y, x, 1]
                come = given[n, y, x]
                a, b, c, d = come[0] * share, come[1] * share, come[2] * share, come[3] * share
                of_across = of_down = _ZERO
                for instant in range(instants):
                    time = (np.float32(instant) + _HALF) * share - _HALF
                    column, row = np.float32(x) - time * across, np.float32(y) - time * down
                    left, right = _split(column, width)
                    top, low = _split(row, height)
                    p, q, r, s = _shares(right, low)
                    one, two = layers[n, top, left], layers[n, top, left + 1]
                    three, four = layers[n, top + 1, left], layers[n, top + 1, left + 1]
                    e = a * one[0] + b * one[1] + c * one[2] + d * one[3]
                    f = a * two[0] + b * two[1] + c * two[2] + d * two[3]
                    g = a * three[0] + b * three[1] + c * three[2] + d * three[3]
                    h = a * four[0] + b * four[1] + c * four[2] + d * four[3]
                    if _ZERO < column < right_end:
                        of_across -= time * ((_ONE - low) * (f - e) + low * (h - g))
                    if _ZERO < row < low_end:
                        of_down -= time * ((_ONE - right) * (g - e) + right * (h - f))
                    _add(of_layers[n, top, left], p, a, b, c, d)
                    _add(of_layers[n, top, left + 1], q, a, b, c, d)
                    _add(of_layers[n, top + 1, left], r, a, b, c, d)
                    _add(of_layers[n, top + 1, left + 1], s, a, b, c, d)
                of_way[n, y, x, 0], of_way[n, y, x, 1] = of_across, of_down
