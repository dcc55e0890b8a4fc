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

from hfb.compilation import LOOP, SUM_INLINE, entry, loop_entry
from hfb.vector_code import LANES  # instants at once: a number that the compiler knows


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
def spread(transforms, first, n, table):
    """Write n instants' transforms into `table` (24, 4 columns x 3 rows x LANES), zeros into the lanes beyond."""
    for j in range(transforms.shape[1]):
        for c in range(4):
            for r in range(3):
                for s in range(LANES):
                    table[j, (3 * c + r) * LANES + s] = transforms[first + s, j, r, c] if s < n else 0.0


@njit(**LOOP)
def _skin_block(table, rest, starts, joints, weights, first, n, moved, vertices):
    for v in range(rest.shape[0]):
        for q in range(3 * LANES):
            moved[q] = 0.0
        x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
        for k in range(starts[v], starts[v + 1]):
            j, weight = np.uint32(joints[k]), weights[k]
            wx, wy, wz = weight * x, weight * y, weight * z
            for q in range(3 * LANES):
                moved[q] += (
                    wx * table[j, q] + wy * table[j, 3 * LANES + q]
                    + (wz * table[j, 6 * LANES + q] + weight * table[j, 9 * LANES + q])
                )  # fmt: skip
        for s in range(n):
            for r in range(3):
                vertices[first + s, v, r] = moved[r * LANES + s]


@entry
def skin(transforms, rest, starts, joints, weights, vertices):
    """Fill `vertices` (S, V, 3) by linear blend skinning (SMPL's eq. 2) of rest vertices (V, 3).

    starts: (V + 1), where each vertex's joints and weights begin in their lists.
    """
    table, moved = np.empty((transforms.shape[1], 12 * LANES), rest.dtype), np.empty(3 * LANES, rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n = min(LANES, transforms.shape[0] - first)
        spread(transforms, first, n, table)
        _skin_block(table, rest, starts, joints, weights, first, n, moved, vertices)


@njit(**LOOP)
def ask(given, v, first, n, asked):
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
def pull(starts, joints, weights, v, asked, points, pulls):
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
def ask_point(table, starts, joints, weights, v, asked, turned, of_point):
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
def add_lanes(of_point, of_rest, v):
    """Add what all instants ask of the rest vertex."""
    x, y, z = of_rest[v, 0], of_rest[v, 1], of_rest[v, 2]
    for s in range(LANES):
        x += of_point[s]
        y += of_point[LANES + s]
        z += of_point[2 * LANES + s]
    of_rest[v, 0], of_rest[v, 1], of_rest[v, 2] = x, y, z


@njit(**LOOP)
def gather(pulls, first, n, of_transforms):
    """What n instants' transforms are asked for, out of lanes: the way back of `spread`."""
    for j in range(of_transforms.shape[1]):
        for c in range(4):
            for r in range(3):
                for s in range(n):
                    of_transforms[first + s, j, r, c] = pulls[j, (3 * c + r) * LANES + s]


@njit(**LOOP)
def _skin_gradient_block(
    table, rest, starts, joints, weights, given, first, n, points, asked, turned, of_point, pulls, of_rest
):
    for v in range(rest.shape[0]):
        if not ask(given, v, first, n, asked):
            continue
        x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
        for q in range(3 * LANES):
            points[q], points[3 * LANES + q], points[6 * LANES + q] = x, y, z
        pull(starts, joints, weights, v, asked, points, pulls)
        if of_rest.shape[0] > 0:
            ask_point(table, starts, joints, weights, v, asked, turned, of_point)
            add_lanes(of_point, of_rest, v)


@entry
def skin_gradient(transforms, rest, starts, joints, weights, given, of_transforms, of_rest):
    """Fill `of_transforms` and add to `of_rest`, which is left out where it is empty."""
    table = np.empty((transforms.shape[1], 12 * LANES), rest.dtype)
    points, turned = np.empty(9 * LANES, rest.dtype), np.empty(9 * LANES, rest.dtype)
    of_point = np.empty(3 * LANES, rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n = min(LANES, transforms.shape[0] - first)
        pulls, asked = np.zeros(table.shape, rest.dtype), np.zeros(3 * LANES, rest.dtype)
        spread(transforms, first, n, table)
        _skin_gradient_block(
            table, rest, starts, joints, weights, given, first, n, points, asked, turned, of_point, pulls, of_rest
        )
        gather(pulls, first, n, of_transforms)
