"""Compiled parts of the body: joints along their chains, and linear blend skinning, with their ways back.

Skinning works on all instants at once: the 12 entries of a joint's transform lie side by side for every instant
("lanes", (column, row, instant)), so that a vertex costs a few long vector operations per joint that holds it, and the
joints that hold it are a list: two or three of 24.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.compilation import LOOP, entry, loop_entry, sum_entry

BLOCK = 16  # instants at once: what is worked on fits into the processor's first cache


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
    """Write n instants' transforms into `table` (24, 4 columns x 3 rows x n instants)."""
    for j in range(transforms.shape[1]):
        for c in range(4):
            for r in range(3):
                for s in range(n):
                    table[j, (3 * c + r) * n + s] = transforms[first + s, j, r, c]


@njit(**LOOP)
def _blend(table, starts, joints, weights, v, blended):
    """The weighted sum of the transforms that hold vertex v, for all instants."""
    for q in range(blended.shape[0]):
        blended[q] = 0.0
    for k in range(starts[v], starts[v + 1]):
        j, weight = np.uint32(joints[k]), weights[k]
        for q in range(blended.shape[0]):
            blended[q] += weight * table[j, q]


@njit(**LOOP)
def _load(rest, offsets, v, first, n, points):
    """The rest vertex with its pose offsets: `points` (3, n instants)."""
    for c in range(3):
        for s in range(n):
            points[c, s] = rest[v, c]
        if offsets.shape[0] > 0:
            for s in range(n):
                points[c, s] += offsets[first + s, v, c]


@njit(**LOOP)
def _skin_block(table, rest, offsets, starts, joints, weights, first, n, blended, points, moved, vertices):
    for v in range(rest.shape[0]):
        _blend(table, starts, joints, weights, v, blended)
        if offsets.shape[0] == 0:
            x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
            for q in range(3 * n):
                moved[q] = blended[q] * x + blended[3 * n + q] * y + (blended[6 * n + q] * z + blended[9 * n + q])
        else:
            _load(rest, offsets, v, first, n, points)
            for r in range(3):
                for s in range(n):
                    q = r * n + s
                    moved[q] = (
                        blended[q] * points[0, s] + blended[3 * n + q] * points[1, s]
                        + (blended[6 * n + q] * points[2, s] + blended[9 * n + q])
                    )  # fmt: skip
        for s in range(n):
            for r in range(3):
                vertices[first + s, v, r] = moved[r * n + s]


@entry
def skin(transforms, rest, offsets, starts, joints, weights, vertices):
    """Fill `vertices` (S, V, 3) by linear blend skinning (SMPL's eq. 2) of rest vertices (V, 3) plus pose offsets
    (S, V, 3), which may be empty. starts (V + 1): where each vertex's joints and weights begin in their lists."""
    for first in range(0, transforms.shape[0], BLOCK):
        n = min(BLOCK, transforms.shape[0] - first)
        table = np.empty((transforms.shape[1], 12 * n), rest.dtype)
        _spread(transforms, first, n, table)
        _skin_block(
            table, rest, offsets, starts, joints, weights, first, n,
            np.empty(12 * n, rest.dtype), np.empty((3, n), rest.dtype), np.empty(3 * n, rest.dtype), vertices,
        )  # fmt: skip


@njit(**LOOP)
def _pull(starts, joints, weights, v, asked, points, n, spread, pulls):
    """Add what vertex v asks of the transforms that hold it: outer products of `asked` (3 rows, n) and the point."""
    for c in range(3):
        for r in range(3):
            for s in range(n):
                spread[(3 * c + r) * n + s] = points[c, s] * asked[r * n + s]
    for q in range(3 * n):
        spread[9 * n + q] = asked[q]
    for k in range(starts[v], starts[v + 1]):
        j, weight = np.uint32(joints[k]), weights[k]
        for q in range(12 * n):
            pulls[j, q] += weight * spread[q]


@njit(**LOOP)
def _point_gradient(blended, asked, n, spread):
    """What is asked of the point: the first (3, n) of `spread` receive blended^T asked."""
    for c in range(3):
        for s in range(n):
            spread[c * n + s] = (
                blended[3 * c * n + s] * asked[s]
                + blended[(3 * c + 1) * n + s] * asked[n + s]
                + blended[(3 * c + 2) * n + s] * asked[2 * n + s]
            )


@njit(**LOOP)
def _ask(given, v, first, n, asked):
    """Load one vertex's gradient, (3 rows, n); returns whether any is not zero (most of the body's far side is)."""
    some = False
    for s in range(n):
        for r in range(3):
            value = given[first + s, v, r]
            asked[r * n + s] = value
            some |= value != 0.0
    return some


@njit(**LOOP)
def _skin_gradient_block(
    table, rest, offsets, starts, joints, weights, given, first, n, blended, points, asked, spread, pulls,
    of_rest, of_offsets,
):  # fmt: skip
    for v in range(rest.shape[0]):
        if not _ask(given, v, first, n, asked):
            continue
        _load(rest, offsets, v, first, n, points)
        _pull(starts, joints, weights, v, asked, points, n, spread, pulls)
        if of_rest.shape[0] > 0 or of_offsets.shape[0] > 0:
            _blend(table, starts, joints, weights, v, blended)
            _point_gradient(blended, asked, n, spread)
        if of_rest.shape[0] > 0:
            for c in range(3):
                for s in range(n):
                    of_rest[v, c] += spread[c * n + s]
        if of_offsets.shape[0] > 0:
            for s in range(n):
                for c in range(3):
                    of_offsets[first + s, v, c] = spread[c * n + s]


@entry
def skin_gradient(transforms, rest, offsets, starts, joints, weights, given, of_transforms, of_rest, of_offsets):
    """Fill `of_transforms`, add to `of_rest` and fill what is not zero of `of_offsets`; empty ones are left out."""
    for first in range(0, transforms.shape[0], BLOCK):
        n = min(BLOCK, transforms.shape[0] - first)
        table, pulls = np.empty((transforms.shape[1], 12 * n), rest.dtype), np.zeros((24, 12 * n), rest.dtype)
        _spread(transforms, first, n, table)
        _skin_gradient_block(
            table, rest, offsets, starts, joints, weights, given, first, n,
            np.empty(12 * n, rest.dtype), np.empty((3, n), rest.dtype), np.empty(3 * n, rest.dtype),
            np.empty(12 * n, rest.dtype), pulls, of_rest, of_offsets,
        )  # fmt: skip
        for j in range(transforms.shape[1]):
            for c in range(4):
                for r in range(3):
                    for s in range(n):
                        of_transforms[first + s, j, r, c] = pulls[j, (3 * c + r) * n + s]


@sum_entry
def blend(feature, directions, offsets):
    """Fill `offsets` (S, V, 3) with pose blend shapes (SMPL's eq. 9) of S poses' features (S, n); S is a multiple of 4.

    directions: (V, 3, n), which are read from memory once: they are too many for the processor's cache.
    """
    for v in range(directions.shape[0]):
        for c in range(3):
            for s in range(0, feature.shape[0], 4):
                zero = directions.dtype.type(0)
                first, second, third, fourth = zero, zero, zero, zero
                for k in range(directions.shape[2]):
                    along = directions[v, c, k]
                    first += along * feature[s, k]
                    second += along * feature[s + 1, k]
                    third += along * feature[s + 2, k]
                    fourth += along * feature[s + 3, k]
                offsets[s, v, c], offsets[s + 1, v, c] = first, second
                offsets[s + 2, v, c], offsets[s + 3, v, c] = third, fourth


@loop_entry
def blend_gradient(given, directions, of_feature):
    """Add to `of_feature` (S, n), the features of S poses, what the offsets' gradient (S, V, 3) asks of them.

    directions: (V, 3, n). What the camera does not see asks for nothing and is passed over, half of the work.
    """
    for v in range(directions.shape[0]):
        for s in range(given.shape[0]):
            a, b, c = given[s, v, 0], given[s, v, 1], given[s, v, 2]
            if a != 0.0 or b != 0.0 or c != 0.0:
                for k in range(of_feature.shape[1]):
                    of_feature[s, k] += a * directions[v, 0, k] + b * directions[v, 1, k] + c * directions[v, 2, k]
