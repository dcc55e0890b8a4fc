"""Compiled body: joints along their chains, linear blend skinning, and their gradients.

Skinning processes all instants at once: the 12 entries of a joint's transform are side by side for every instant
("lanes", (column, row, instant)), so that a vertex costs a few long vector operations per joint of its skinning
weights, which are a list: two to four of 24. The compiler vectorises flat loops of constant length; nested ones stay
slow.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, JIT, LOOP, entry, loop_entry
from hfb.kernels.simd import (  # instants at once, a constant for the compiler
    LANES,
    lanes,
    load_apart,
    load_lanes,
    multiply_add,
    some_lane,
    store_apart,
    store_lanes,
    sum_lanes,
)


@loop_entry
def add_shape(betas, template, rows, shaped):
    """Fill `shaped` with the template plus every beta times its row: SMPL's eq. 8.

    Args:
        betas: (K).
        template: (n).
        rows: (K, n).
        shaped: (n), filled.
    """
    whole = template.shape[0] - template.shape[0] % LANES
    for n in range(0, whole, LANES):
        total = load_lanes(template, n)
        for k in range(betas.shape[0]):
            total = multiply_add(load_lanes(rows, k * template.shape[0] + n), betas[k], total)
        store_lanes(shaped, n, total)
    for n in range(whole, template.shape[0]):
        shaped[n] = template[n]
        for k in range(betas.shape[0]):
            shaped[n] += betas[k] * rows[k, n]


@njit(**INLINE)
def _inner_product(rows, k, vector):
    """Return the inner product of a row with as many numbers."""
    zero, count = lanes(vector.dtype.type(0.0)), vector.shape[0]
    one, two, three, four = zero, zero, zero, zero
    whole, at = count - count % (4 * LANES), k * count
    for n in range(0, whole, 4 * LANES):
        one = one + load_lanes(rows, at + n) * load_lanes(vector, n)
        two = two + load_lanes(rows, at + n + LANES) * load_lanes(vector, n + LANES)
        three = three + load_lanes(rows, at + n + 2 * LANES) * load_lanes(vector, n + 2 * LANES)
        four = four + load_lanes(rows, at + n + 3 * LANES) * load_lanes(vector, n + 3 * LANES)
    total = sum_lanes((one + two) + (three + four))
    for n in range(whole, count):
        total += rows[k, n] * vector[n]
    return total


@loop_entry
def add_shape_gradient(rows, joint_rows, of_vertices, of_joints, of_betas):
    """Compute the gradient of `add_shape` by the betas.

    Args:
        rows: (K, 3 V), of the vertices.
        joint_rows: (K, 72), of the joints.
        of_vertices: (3 V), gradient by the vertices.
        of_joints: (72), gradient by the joints.
        of_betas: (K), filled.
    """
    for k in range(of_betas.shape[0]):
        of_betas[k] = _inner_product(rows, k, of_vertices) + _inner_product(joint_rows, k, of_joints)


@loop_entry
def place(rotations, translations, rest, parents, transforms, joints):
    """Fill transforms and joints: SMPL's eq. 4 along every chain.

    Args:
        rotations: (S, 24, 3, 3), of each joint in its parent's frame.
        translations: (S, 3) [m].
        rest: (24, 3), rest joints [m].
        parents: (24), -1 for the root.
        transforms: (N, 24, 3, 4), rest body to world, filled.
        joints: (N, 24, 3), filled.
    """
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
    """Compute the gradients of `place`.

    Args:
        rotations: (S, 24, 3, 3), of each joint in its parent's frame.
        rest: (24, 3), rest joints [m].
        parents: (24), -1 for the root.
        transforms: (S, 24, 3, 4), rest body to world.
        of_transforms: gradient by the transforms.
        of_joints: gradient by the joints.
        of_rotations: gradient, filled.
        of_translations: gradient, filled.
        of_rest: (24, 3), gradient, added to.
    """
    count = rest.shape[0]
    turn, at = np.empty((count, 3, 3), rest.dtype), np.empty((count, 3), rest.dtype)
    for n in range(rotations.shape[0]):
        for j in range(count):
            for r in range(3):
                of_place = of_transforms[n, j, r, 3]
                at[j, r] = of_place + of_joints[n, j, r]
                for c in range(3):
                    turn[j, r, c] = of_transforms[n, j, r, c] - of_place * rest[j, c]
                    of_rest[j, c] -= transforms[n, j, r, c] * of_place
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
    """Write n instants' transforms side by side into `table`, zeros into the lanes beyond.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        first: number of the first body.
        n: number of bodies, up to LANES.
        table: (24, 4 columns x 3 rows x LANES), filled.
    """
    for j in range(transforms.shape[1]):
        for c in range(4):
            for r in range(3):
                for s in range(LANES):
                    table[j, (3 * c + r) * LANES + s] = transforms[first + s, j, r, c] if s < n else 0.0


@njit(**INLINE)
def move_point(x, y, z, table, starts, joints, weights, v, to, stride, vertices):
    """Transform a point of every instant and store it.

    Args:
        x: x of the point, LANES numbers.
        y: y of the point, LANES numbers.
        z: z of the point, LANES numbers.
        table: (24, 12 x LANES), transforms by `spread`.
        starts: (V + 1), where each vertex's joints and weights begin in their lists.
        joints: joint of each skinning weight.
        weights: skinning weights.
        v: number of the vertex.
        to: position of the first body's point in `vertices`.
        stride: numbers from one body to the next.
        vertices: written to.
    """
    zero = lanes(table.dtype.type(0.0))
    moved_x, moved_y, moved_z = zero, zero, zero
    for k in range(starts[v], starts[v + 1]):
        at, weight = 12 * LANES * np.int64(joints[k]), weights[k]
        x_here, y_here, z_here = x * weight, y * weight, z * weight
        moved_x = _row_of(table, at, x_here, y_here, z_here, weight, moved_x)
        moved_y = _row_of(table, at + LANES, x_here, y_here, z_here, weight, moved_y)
        moved_z = _row_of(table, at + 2 * LANES, x_here, y_here, z_here, weight, moved_z)
    store_apart(vertices, to, stride, moved_x)
    store_apart(vertices, to + 1, stride, moved_y)
    store_apart(vertices, to + 2, stride, moved_z)


@njit(**INLINE)
def _row_of(table, at, x, y, z, weight, added):
    """Return a row of a joint's transforms times a weighted point."""
    added = multiply_add(load_lanes(table, at + 9 * LANES), weight, added)
    added = multiply_add(load_lanes(table, at), x, added)
    added = multiply_add(load_lanes(table, at + 3 * LANES), y, added)
    return multiply_add(load_lanes(table, at + 6 * LANES), z, added)


@njit(**LOOP)
def _skin_block(table, rest, starts, joints, weights, to, vertices):
    """Fill LANES bodies of `vertices`, from number `to` on."""
    stride = 3 * rest.shape[0]
    for v in range(rest.shape[0]):
        x, y, z = lanes(rest[v, 0]), lanes(rest[v, 1]), lanes(rest[v, 2])
        move_point(x, y, z, table, starts, joints, weights, v, to + 3 * v, stride, vertices)


@entry
def skin(transforms, rest, starts, joints, weights, vertices):
    """Fill `vertices` by linear blend skinning (SMPL's eq. 2).

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        rest: (V, 3), rest vertices [m].
        starts: (V + 1), where each vertex's joints and weights begin in their lists.
        joints: joint of each skinning weight.
        weights: skinning weights.
        vertices: (S, V, 3), filled.
    """
    table = np.empty((transforms.shape[1], 12 * LANES), rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n = min(LANES, transforms.shape[0] - first)
        spread(transforms, first, n, table)
        if n == LANES:
            _skin_block(table, rest, starts, joints, weights, first * rest.size, vertices)
        else:
            block = np.empty((LANES, rest.shape[0], 3), rest.dtype)
            _skin_block(table, rest, starts, joints, weights, 0, block)
            vertices[first:] = block[:n]


@njit(**JIT)
def whole_block(grad_output, first):
    """Return LANES bodies' gradients, zeros where there are fewer: an array, and their position in it.

    Args:
        grad_output: (S, V, 3), gradient by the vertices.
        first: number of the first body.
    """
    if grad_output.shape[0] - first >= LANES:
        return grad_output, first * grad_output.shape[1] * 3
    block = np.zeros((LANES, grad_output.shape[1], 3), grad_output.dtype)
    block[: grad_output.shape[0] - first] = grad_output[first:]
    return block, 0


@njit(**INLINE)
def load_gradient(grad_output, at, stride):
    """Load a vertex's gradients (x, y, z) at every instant, and whether any is not zero.

    Vertices that the camera does not see have zeros.

    Args:
        grad_output: (S, V, 3), gradient by the vertices.
        at: position of the vertex in the first body.
        stride: numbers from one body to the next.
    """
    x, y = load_apart(grad_output, at, stride), load_apart(grad_output, at + 1, stride)
    z = load_apart(grad_output, at + 2, stride)
    return x, y, z, some_lane(x) | some_lane(y) | some_lane(z)


@njit(**INLINE)
def table_backward(starts, joints, weights, v, grad_vertex, point, of_table):
    """Add a vertex's gradients to those of its transforms: outer products of the gradients and the point.

    Args:
        starts: (V + 1), where each vertex's joints and weights begin in their lists.
        joints: joint of each skinning weight.
        weights: skinning weights.
        v: number of the vertex.
        grad_vertex: x, y and z of the vertex's gradient, LANES numbers each.
        point: x, y and z of the vertex before skinning, LANES numbers each.
        of_table: (24, 12 x LANES), gradient by `table`, added to.
    """
    for k in range(starts[v], starts[v + 1]):
        at, weight = 12 * LANES * np.int64(joints[k]), weights[k]
        x, y, z = grad_vertex[0] * weight, grad_vertex[1] * weight, grad_vertex[2] * weight
        _column_backward(of_table, at, x, y, z, point[0])
        _column_backward(of_table, at + 3 * LANES, x, y, z, point[1])
        _column_backward(of_table, at + 6 * LANES, x, y, z, point[2])
        at += 9 * LANES
        store_lanes(of_table, at, load_lanes(of_table, at) + x)
        store_lanes(of_table, at + LANES, load_lanes(of_table, at + LANES) + y)
        store_lanes(of_table, at + 2 * LANES, load_lanes(of_table, at + 2 * LANES) + z)


@njit(**INLINE)
def _column_backward(of_table, at, x, y, z, coordinate):
    store_lanes(of_table, at, multiply_add(x, coordinate, load_lanes(of_table, at)))
    store_lanes(of_table, at + LANES, multiply_add(y, coordinate, load_lanes(of_table, at + LANES)))
    store_lanes(of_table, at + 2 * LANES, multiply_add(z, coordinate, load_lanes(of_table, at + 2 * LANES)))


@njit(**INLINE)
def point_backward(table, starts, joints, weights, v, grad_vertex, of_rest):
    """Return the gradient by the point before skinning: the blended rotation's transpose times the vertex's gradient.

    Its sum over the lanes is added to the rest vertex's gradient.

    Args:
        table: (24, 12 x LANES), transforms by `spread`.
        starts: (V + 1), where each vertex's joints and weights begin in their lists.
        joints: joint of each skinning weight.
        weights: skinning weights.
        v: number of the vertex.
        grad_vertex: x, y and z of the vertex's gradient, LANES numbers each.
        of_rest: (V, 3), gradient, added to.
    """
    zero = lanes(table.dtype.type(0.0))
    x, y, z = zero, zero, zero
    for k in range(starts[v], starts[v + 1]):
        at, weight = 12 * LANES * np.int64(joints[k]), weights[k]
        along_x, along_y, along_z = grad_vertex[0] * weight, grad_vertex[1] * weight, grad_vertex[2] * weight
        x = _column_of(table, at, along_x, along_y, along_z, x)
        y = _column_of(table, at + 3 * LANES, along_x, along_y, along_z, y)
        z = _column_of(table, at + 6 * LANES, along_x, along_y, along_z, z)
    of_rest[v, 0] += sum_lanes(x)
    of_rest[v, 1] += sum_lanes(y)
    of_rest[v, 2] += sum_lanes(z)
    return x, y, z


@njit(**INLINE)
def _column_of(table, at, x, y, z, added):
    """Multiply a column of a joint's transforms by a gradient."""
    added = multiply_add(load_lanes(table, at), x, added)
    added = multiply_add(load_lanes(table, at + LANES), y, added)
    return multiply_add(load_lanes(table, at + 2 * LANES), z, added)


@njit(**LOOP)
def gather(of_table, first, n, of_transforms):
    """Reverse `spread` for gradients: write those of n instants' transforms.

    Args:
        of_table: (24, 12 x LANES), gradient by the table.
        first: number of the first body.
        n: number of bodies, up to LANES.
        of_transforms: (S, 24, 3, 4), gradient, filled.
    """
    for j in range(of_transforms.shape[1]):
        for c in range(4):
            for r in range(3):
                for s in range(n):
                    of_transforms[first + s, j, r, c] = of_table[j, (3 * c + r) * LANES + s]


@njit(**LOOP)
def _skin_gradient_block(table, rest, starts, joints, weights, grad_output, first, of_table, of_rest):
    stride = 3 * rest.shape[0]
    for v in range(rest.shape[0]):
        x, y, z, some = load_gradient(grad_output, first + 3 * v, stride)
        if not some:
            continue
        grad_vertex = x, y, z
        table_backward(starts, joints, weights, v, grad_vertex, (rest[v, 0], rest[v, 1], rest[v, 2]), of_table)
        if of_rest.shape[0] > 0:
            point_backward(table, starts, joints, weights, v, grad_vertex, of_rest)


@entry
def skin_gradient(transforms, rest, starts, joints, weights, grad_output, of_transforms, of_rest):
    """Compute the gradients of `skin`.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        rest: (V, 3), rest vertices [m].
        starts: (V + 1), where each vertex's joints and weights begin in their lists.
        joints: joint of each skinning weight.
        weights: skinning weights.
        grad_output: (S, V, 3), gradient by the vertices.
        of_transforms: (S, 24, 3, 4), gradient, filled.
        of_rest: (V, 3), gradient, added to; an empty one is skipped.
    """
    table = np.empty((transforms.shape[1], 12 * LANES), rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n, of_table = min(LANES, transforms.shape[0] - first), np.zeros(table.shape, rest.dtype)
        spread(transforms, first, n, table)
        block, at = whole_block(grad_output, first)
        _skin_gradient_block(table, rest, starts, joints, weights, block, at, of_table, of_rest)
        gather(of_table, first, n, of_transforms)
