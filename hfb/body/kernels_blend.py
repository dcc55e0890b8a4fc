"""Compiled parts of bodies with pose blend shapes: every vertex is displaced by its pose and skinned in one go.

Its directions, 3 x 207 numbers, are read from memory once there and once back: they are too many for the processor's
cache, and are half as many bytes in 16 bits (`hfb.body.skinning.rounded`). Displaced vertices stay where they are for
the way back, all instants of one side by side.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.body.kernels_skinning import add_lanes, ask, ask_point, gather, pull, spread
from hfb.body.kernels_vector import BLOCK, FEATURES, add_block
from hfb.compilation import LOOP, SUM_INLINE, entry
from hfb.vector_code import LANES, prefetch, wide_registers

AHEAD = 4  # vertices whose directions are asked for before they are needed
_LINE = 32  # 16-bit numbers that memory hands over at once


@njit(**LOOP)
def _read_ahead(directions, v):
    """Have a vertex's directions read; beyond the last one nothing happens."""
    for k in range(0, 3 * FEATURES, _LINE):
        prefetch(directions, 3 * v * FEATURES + k)


@njit(**LOOP)
def _list_features(rotations, first, n, feature):
    """Fill `feature` (LANES, FEATURES): what n poses differ in from the rest pose; zeros in the lanes beyond."""
    for s in range(n):
        for j in range(1, rotations.shape[1]):
            for r in range(3):
                for c in range(3):
                    feature[s, 9 * (j - 1) + 3 * r + c] = rotations[first + s, j, r, c] - (1.0 if r == c else 0.0)
    for s in range(n, LANES):
        for k in range(FEATURES):
            feature[s, k] = 0.0


@njit(**SUM_INLINE)
def _displace(feature, rest, directions, steps, v, points):
    """Fill `points` (V, 3 x LANES) at v: the rest vertex and its pose blend shapes (SMPL's eq. 9).

    Three directions times four poses at once are twelve sums that do not wait for each other, and load little for it.
    """
    wide_registers()
    kind = feature.dtype.type
    for s in range(0, LANES, 4):
        x0, x1, x2, x3 = kind(0), kind(0), kind(0), kind(0)
        y0, y1, y2, y3 = kind(0), kind(0), kind(0), kind(0)
        z0, z1, z2, z3 = kind(0), kind(0), kind(0), kind(0)
        for k in range(FEATURES):
            x, y, z = kind(directions[v, 0, k]), kind(directions[v, 1, k]), kind(directions[v, 2, k])
            first, second, third, fourth = feature[s, k], feature[s + 1, k], feature[s + 2, k], feature[s + 3, k]
            x0, x1, x2, x3 = x0 + x * first, x1 + x * second, x2 + x * third, x3 + x * fourth
            y0, y1, y2, y3 = y0 + y * first, y1 + y * second, y2 + y * third, y3 + y * fourth
            z0, z1, z2, z3 = z0 + z * first, z1 + z * second, z2 + z * third, z3 + z * fourth
        at, step = rest[v, 0], steps[v, 0]
        points[v, s], points[v, s + 1] = at + step * x0, at + step * x1
        points[v, s + 2], points[v, s + 3] = at + step * x2, at + step * x3
        at, step, s = rest[v, 1], steps[v, 1], s + LANES
        points[v, s], points[v, s + 1] = at + step * y0, at + step * y1
        points[v, s + 2], points[v, s + 3] = at + step * y2, at + step * y3
        at, step, s = rest[v, 2], steps[v, 2], s + LANES
        points[v, s], points[v, s + 1] = at + step * z0, at + step * z1
        points[v, s + 2], points[v, s + 3] = at + step * z2, at + step * z3


@njit(**LOOP)
def _repeat(points, v, rows):
    """Every coordinate's lanes of vertex v three times, for each row of a transform: `rows` (3 x 3 x LANES)."""
    for q in range(LANES):
        x, y, z = points[v, q], points[v, LANES + q], points[v, 2 * LANES + q]
        rows[q], rows[LANES + q], rows[2 * LANES + q] = x, x, x
        rows[3 * LANES + q], rows[4 * LANES + q], rows[5 * LANES + q] = y, y, y
        rows[6 * LANES + q], rows[7 * LANES + q], rows[8 * LANES + q] = z, z, z


@njit(**LOOP)
def _move(table, rows, starts, joints, weights, v, moved):
    """Fill `moved` (3 x LANES): a point of every instant, turned by the transforms that hold vertex v."""
    for q in range(3 * LANES):
        moved[q] = 0.0
    for k in range(starts[v], starts[v + 1]):
        j, weight = np.uint32(joints[k]), weights[k]
        for q in range(3 * LANES):
            moved[q] += weight * (
                rows[q] * table[j, q] + rows[3 * LANES + q] * table[j, 3 * LANES + q]
                + (rows[6 * LANES + q] * table[j, 6 * LANES + q] + table[j, 9 * LANES + q])
            )  # fmt: skip


@entry
def blend_and_skin(transforms, rotations, rest, directions, steps, starts, joints, weights, points, vertices):
    """Fill `vertices` (S, V, 3) by skinning (SMPL's eq. 2) of the rest vertices (V, 3) plus pose blend shapes, and
    `points` (S / LANES, V, 3 x LANES), these vertices before they were skinned.

    directions: (V, 3, FEATURES) in `steps` (V, 3). starts: (V + 1), where each vertex's joints and weights begin.
    """
    wide_registers()
    table, feature = np.empty((transforms.shape[1], 12 * LANES), rest.dtype), np.zeros((LANES, FEATURES), rest.dtype)
    rows, moved = np.empty(9 * LANES, rest.dtype), np.empty(3 * LANES, rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n, block = min(LANES, transforms.shape[0] - first), points[first // LANES]
        spread(transforms, first, n, table)
        _list_features(rotations, first, n, feature)
        for v in range(rest.shape[0]):
            _read_ahead(directions, v + AHEAD)
            _displace(feature, rest, directions, steps, v, block)
            _repeat(block, v, rows)
            _move(table, rows, starts, joints, weights, v, moved)
            for s in range(n):
                for r in range(3):
                    vertices[first + s, v, r] = moved[r * LANES + s]


@njit(**LOOP)
def _list_asking(given, first, n, asking):
    """Fill `asking` with the vertices of which any of n gradients is not zero; returns how many."""
    count = 0
    for v in range(given.shape[1]):
        some = False
        for s in range(first, first + n):
            some |= (given[s, v, 0] != 0.0) | (given[s, v, 1] != 0.0) | (given[s, v, 2] != 0.0)
        asking[count] = v
        count += some
    return count


@njit(**LOOP)
def _gradient_block(
    table, directions, steps, starts, joints, weights, points, given, first, n, asking, count, rows, asked, turned,
    of_point, pulls, of_rest, of_feature,
):  # fmt: skip
    wide_registers()
    for number in range(count):
        v = asking[number]
        _read_ahead(directions, asking[min(number + AHEAD, count - 1)])
        ask(given, v, first, n, asked)
        _repeat(points, v, rows)
        pull(starts, joints, weights, v, asked, rows, pulls)
        ask_point(table, starts, joints, weights, v, asked, turned, of_point)
        add_lanes(of_point, of_rest, v)
        for q in range(LANES):
            of_point[q] *= steps[v, 0]
            of_point[LANES + q] *= steps[v, 1]
            of_point[2 * LANES + q] *= steps[v, 2]
        for k in range(0, FEATURES, BLOCK):
            add_block(of_feature, k, directions, 3 * v * FEATURES + k, of_point)


@entry
def blend_and_skin_gradient(
    transforms, directions, steps, starts, joints, weights, points, given, of_transforms, of_rotations, of_rest
):
    """Fill `of_transforms` and, but for the root, `of_rotations`; add to `of_rest`. What the camera does not see asks
    for nothing and is passed over, half of the work."""
    wide_registers()
    kind = transforms.dtype
    table, of_feature = np.empty((transforms.shape[1], 12 * LANES), kind), np.empty((LANES, FEATURES), kind)
    rows, turned, of_point = np.empty(9 * LANES, kind), np.empty(9 * LANES, kind), np.empty(3 * LANES, kind)
    asking = np.empty(given.shape[1], np.int64)
    for first in range(0, transforms.shape[0], LANES):
        n, block = min(LANES, transforms.shape[0] - first), points[first // LANES]
        pulls, asked = np.zeros(table.shape, kind), np.zeros(3 * LANES, kind)
        of_feature[:] = 0.0
        spread(transforms, first, n, table)
        count = _list_asking(given, first, n, asking)
        _gradient_block(
            table, directions, steps, starts, joints, weights, block, given, first, n, asking, count, rows, asked,
            turned, of_point, pulls, of_rest, of_feature,
        )  # fmt: skip
        gather(pulls, first, n, of_transforms)
        for s in range(n):
            for j in range(1, of_rotations.shape[1]):
                for r in range(3):
                    for c in range(3):
                        of_rotations[first + s, j, r, c] = of_feature[s, 9 * (j - 1) + 3 * r + c]
