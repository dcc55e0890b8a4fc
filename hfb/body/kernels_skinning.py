"""Compiled parts of the body: joints along their chains, and linear blend skinning, with their ways back.

Skinning works on all instants at once: the 12 entries of a joint's transform lie side by side for every instant
("lanes", (column, row, instant)), so that a vertex costs a few long vector operations per joint that holds it, and the
joints that hold it are a list: two to four of 24. The compiler makes such operations of flat loops of a length that it
knows; nested ones it leaves slow.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.body.kernels_vector import BLOCK, FEATURES, add_block
from hfb.compilation import LOOP, SUM_INLINE, entry, loop_entry, sum_entry

LANES = 8  # instants at once: a number that the compiler knows, so that loops over them become single operations


@loop_entry
def place(rotations, translations, rest, parents, transforms, joints):
    """Fill `transforms` (N, 24, 3, 4), rest body to world, and `joints` (N, 24, 3): SMPL's eq. 4 along every chain."""
    for n in range(rotations.shape[0]):
        for j in range(rest.shape[0]):
            p = parents[j]
            if p < 0:
                for r in range(3):
                    for c in range(3):
                        transforms[n, j, r, c] = rotations[n, j, r, c]
                    joints[n, j, r] = rest[j, r] + translations[n, r]
            else:
                for r in range(3):
                    a, b, c = transforms[n, p, r, 0], transforms[n, p, r, 1], transforms[n, p, r, 2]
                    for q in range(3):
                        transforms[n, j, r, q] = (
                            a * rotations[n, j, 0, q] + b * rotations[n, j, 1, q] + c * rotations[n, j, 2, q]
                        )
                    along = a * (rest[j, 0] - rest[p, 0]) + b * (rest[j, 1] - rest[p, 1])
                    joints[n, j, r] = along + c * (rest[j, 2] - rest[p, 2]) + joints[n, p, r]
            # Rest vertices are given about the origin, not about the joint: subtract the rotated rest joint.
            for r in range(3):
                turned = transforms[n, j, r, 0] * rest[j, 0] + transforms[n, j, r, 1] * rest[j, 1]
                transforms[n, j, r, 3] = joints[n, j, r] - (turned + transforms[n, j, r, 2] * rest[j, 2])


@entry
def place_gradient(
    rotations, rest, parents, transforms, of_transforms, of_joints, of_rotations, of_translations, of_rest
):
    """Fill the first two gradients and add to the third, from those of what `place` filled."""
    count = rest.shape[0]
    turn, at = np.empty((count, 3, 3), rest.dtype), np.empty((count, 3), rest.dtype)
    for n in range(rotations.shape[0]):
        for j in range(count):
            for r in range(3):
                pull = of_transforms[n, j, r, 3]
                at[j, r] = pull + of_joints[n, j, r]
                for c in range(3):
                    turn[j, r, c] = of_transforms[n, j, r, c] - pull * rest[j, c]
                    of_rest[j, c] -= transforms[n, j, r, c] * pull
        for j in range(count - 1, 0, -1):
            p = parents[j]
            for c in range(3):
                bone = rest[j, c] - rest[p, c]
                for q in range(3):
                    of_rotations[n, j, c, q] = (
                        transforms[n, p, 0, c] * turn[j, 0, q]
                        + transforms[n, p, 1, c] * turn[j, 1, q]
                        + transforms[n, p, 2, c] * turn[j, 2, q]
                    )
                for r in range(3):
                    turn[p, r, c] += at[j, r] * bone + (
                        turn[j, r, 0] * rotations[n, j, c, 0]
                        + turn[j, r, 1] * rotations[n, j, c, 1]
                        + turn[j, r, 2] * rotations[n, j, c, 2]
                    )
                of_bone = (
                    transforms[n, p, 0, c] * at[j, 0]
                    + transforms[n, p, 1, c] * at[j, 1]
                    + transforms[n, p, 2, c] * at[j, 2]
                )
                of_rest[j, c] += of_bone
                of_rest[p, c] -= of_bone
            for r in range(3):
                at[p, r] += at[j, r]
        for r in range(3):
            of_translations[n, r] = at[0, r]
            of_rest[0, r] += at[0, r]
            for c in range(3):
                of_rotations[n, 0, r, c] = turn[0, r, c]


@njit(**LOOP)
def _spread(transforms, first, n, table):
    """Write n instants' transforms into `table` (24, 4 columns x 3 rows x LANES), zeros into the lanes beyond."""
    for j in range(transforms.shape[1]):
        for c in range(4):
            for r in range(3):
                for s in range(LANES):
                    table[j, (3 * c + r) * LANES + s] = transforms[first + s, j, r, c] if s < n else 0.0


@njit(**LOOP)
def _load(rest, offsets, v, first, n, points):
    """The rest vertex with its pose offsets: `points` (3 coordinates x 3 rows x LANES), the same in every row."""
    x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
    for q in range(3 * LANES):
        points[q], points[3 * LANES + q], points[6 * LANES + q] = x, y, z
    if offsets.shape[0] > 0:
        for s in range(n):
            points[s] += offsets[first + s, v, 0]
            points[3 * LANES + s] += offsets[first + s, v, 1]
            points[6 * LANES + s] += offsets[first + s, v, 2]
        for s in range(LANES):
            x, y, z = points[s], points[3 * LANES + s], points[6 * LANES + s]
            points[LANES + s], points[4 * LANES + s], points[7 * LANES + s] = x, y, z
            points[2 * LANES + s], points[5 * LANES + s], points[8 * LANES + s] = x, y, z


@njit(**LOOP)
def _skin_block(table, rest, offsets, starts, joints, weights, first, n, points, moved, vertices):
    for v in range(rest.shape[0]):
        for q in range(3 * LANES):
            moved[q] = 0.0
        if offsets.shape[0] == 0:
            x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
            for k in range(starts[v], starts[v + 1]):
                j, weight = np.uint32(joints[k]), weights[k]
                wx, wy, wz = weight * x, weight * y, weight * z
                for q in range(3 * LANES):
                    moved[q] += (
                        wx * table[j, q] + wy * table[j, 3 * LANES + q]
                        + (wz * table[j, 6 * LANES + q] + weight * table[j, 9 * LANES + q])
                    )  # fmt: skip
        else:
            _load(rest, offsets, v, first, n, points)
            for k in range(starts[v], starts[v + 1]):
                j, weight = np.uint32(joints[k]), weights[k]
                for q in range(3 * LANES):
                    moved[q] += weight * (
                        points[q] * table[j, q] + points[3 * LANES + q] * table[j, 3 * LANES + q]
                        + (points[6 * LANES + q] * table[j, 6 * LANES + q] + table[j, 9 * LANES + q])
                    )  # fmt: skip
        for s in range(n):
            for r in range(3):
                vertices[first + s, v, r] = moved[r * LANES + s]


@entry
def skin(transforms, rest, offsets, starts, joints, weights, vertices):
    """Fill `vertices` (S, V, 3) by linear blend skinning (SMPL's eq. 2) of rest vertices (V, 3) plus pose offsets
    (S, V, 3), which may be empty. starts (V + 1): where each vertex's joints and weights begin in their lists."""
    table = np.empty((transforms.shape[1], 12 * LANES), rest.dtype)
    points, moved = np.empty(9 * LANES, rest.dtype), np.empty(3 * LANES, rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n = min(LANES, transforms.shape[0] - first)
        _spread(transforms, first, n, table)
        _skin_block(table, rest, offsets, starts, joints, weights, first, n, points, moved, vertices)


@njit(**LOOP)
def _ask(given, v, first, n, asked):
    """Load one vertex's gradient, (3 rows x LANES); returns whether any is not zero: what the camera does not see asks
    for nothing."""
    some = False
    for s in range(n):
        for r in range(3):
            value = given[first + s, v, r]
            asked[r * LANES + s] = value
            some |= value != 0.0
    return some


@njit(**LOOP)
def _pull(starts, joints, weights, v, asked, points, pulls):
    """Add what vertex v asks of the transforms that hold it: outer products of `asked` and the point."""
    for k in range(starts[v], starts[v + 1]):
        j, weight = np.uint32(joints[k]), weights[k]
        for q in range(3 * LANES):
            value = weight * asked[q]
            pulls[j, q] += points[q] * value
            pulls[j, 3 * LANES + q] += points[3 * LANES + q] * value
            pulls[j, 6 * LANES + q] += points[6 * LANES + q] * value
            pulls[j, 9 * LANES + q] += value


@njit(**LOOP)
def _ask_point(table, starts, joints, weights, v, asked, turned, of_point):
    """What is asked of the point: `of_point` (3 x LANES) receives the blended rotation's transpose times `asked`."""
    for q in range(9 * LANES):
        turned[q] = 0.0
    for k in range(starts[v], starts[v + 1]):
        j, weight = np.uint32(joints[k]), weights[k]
        for q in range(9 * LANES):
            turned[q] += weight * table[j, q]
    for s in range(LANES):
        x, y, z = asked[s], asked[LANES + s], asked[2 * LANES + s]
        of_point[s] = turned[s] * x + turned[LANES + s] * y + turned[2 * LANES + s] * z
        of_point[LANES + s] = turned[3 * LANES + s] * x + turned[4 * LANES + s] * y + turned[5 * LANES + s] * z
        of_point[2 * LANES + s] = turned[6 * LANES + s] * x + turned[7 * LANES + s] * y + turned[8 * LANES + s] * z


@njit(**SUM_INLINE)
def _add_lanes(of_point, of_rest, v):
    """Add what all instants ask of the rest vertex."""
    x, y, z = of_rest[v, 0], of_rest[v, 1], of_rest[v, 2]
    for s in range(LANES):
        x += of_point[s]
        y += of_point[LANES + s]
        z += of_point[2 * LANES + s]
    of_rest[v, 0], of_rest[v, 1], of_rest[v, 2] = x, y, z


@njit(**LOOP)
def _skin_gradient_block(
    table, rest, offsets, starts, joints, weights, given, first, n, points, asked, turned, of_point, pulls,
    of_rest, of_offsets,
):  # fmt: skip
    for v in range(rest.shape[0]):
        if not _ask(given, v, first, n, asked):
            continue
        _load(rest, offsets, v, first, n, points)
        _pull(starts, joints, weights, v, asked, points, pulls)
        if of_rest.shape[0] > 0 or of_offsets.shape[0] > 0:
            _ask_point(table, starts, joints, weights, v, asked, turned, of_point)
        if of_rest.shape[0] > 0:
            _add_lanes(of_point, of_rest, v)
        if of_offsets.shape[0] > 0:
            for s in range(n):
                for c in range(3):
                    of_offsets[first + s, v, c] = of_point[c * LANES + s]


@entry
def skin_gradient(transforms, rest, offsets, starts, joints, weights, given, of_transforms, of_rest, of_offsets):
    """Fill `of_transforms`, add to `of_rest` and fill what is not zero of `of_offsets`; empty ones are left out."""
    table = np.empty((transforms.shape[1], 12 * LANES), rest.dtype)
    points, turned = np.empty(9 * LANES, rest.dtype), np.empty(9 * LANES, rest.dtype)
    of_point = np.empty(3 * LANES, rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n = min(LANES, transforms.shape[0] - first)
        pulls, asked = np.zeros((24, 12 * LANES), rest.dtype), np.zeros(3 * LANES, rest.dtype)
        _spread(transforms, first, n, table)
        _skin_gradient_block(
            table, rest, offsets, starts, joints, weights, given, first, n, points, asked, turned, of_point, pulls,
            of_rest, of_offsets,
        )  # fmt: skip
        for j in range(transforms.shape[1]):
            for c in range(4):
                for r in range(3):
                    for s in range(n):
                        of_transforms[first + s, j, r, c] = pulls[j, (3 * c + r) * LANES + s]


@sum_entry
def blend(feature, directions, offsets):
    """Fill `offsets` (S, V, 3) with pose blend shapes (SMPL's eq. 9) of the features (S, 208) of S poses, S of 4s.

    directions: (V, 3, 208), which are read from memory once: they are too many for the processor's cache. Three
    directions times four poses at once are twelve sums that do not wait for each other, and load little for it.
    """
    for v in range(directions.shape[0]):
        for s in range(0, feature.shape[0], 4):
            zero = directions.dtype.type(0)
            x0, x1, x2, x3 = zero, zero, zero, zero
            y0, y1, y2, y3 = zero, zero, zero, zero
            z0, z1, z2, z3 = zero, zero, zero, zero
            for k in range(FEATURES):
                x, y, z = directions[v, 0, k], directions[v, 1, k], directions[v, 2, k]
                first, second, third, fourth = feature[s, k], feature[s + 1, k], feature[s + 2, k], feature[s + 3, k]
                x0, x1, x2, x3 = x0 + x * first, x1 + x * second, x2 + x * third, x3 + x * fourth
                y0, y1, y2, y3 = y0 + y * first, y1 + y * second, y2 + y * third, y3 + y * fourth
                z0, z1, z2, z3 = z0 + z * first, z1 + z * second, z2 + z * third, z3 + z * fourth
            offsets[s, v, 0], offsets[s, v, 1], offsets[s, v, 2] = x0, y0, z0
            offsets[s + 1, v, 0], offsets[s + 1, v, 1], offsets[s + 1, v, 2] = x1, y1, z1
            offsets[s + 2, v, 0], offsets[s + 2, v, 1], offsets[s + 2, v, 2] = x2, y2, z2
            offsets[s + 3, v, 0], offsets[s + 3, v, 1], offsets[s + 3, v, 2] = x3, y3, z3


@loop_entry
def blend_gradient(given, directions, of_feature):
    """Add to `of_feature` (S, 208), the features of S poses, what the offsets' gradient (S, V, 3) asks of them.

    directions: (V, 3, 208). What the camera does not see asks for nothing and is passed over, half of the work.
    """
    for v in range(directions.shape[0]):
        for s in range(given.shape[0]):
            x, y, z = given[s, v, 0], given[s, v, 1], given[s, v, 2]
            if (x != 0.0) | (y != 0.0) | (z != 0.0):
                for k in range(0, FEATURES, BLOCK):
                    add_block(of_feature, s * FEATURES + k, directions, 3 * v * FEATURES + k, x, y, z)
