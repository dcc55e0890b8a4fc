"""Compiled bodies with pose blend shapes: every vertex is displaced and skinned in one pass.

A vertex's directions, 3 x 207 numbers, are read from memory once in the forward and once in the backward pass: they
are too many for the CPU's cache, and take half as many bytes in 16 bits (`hfb.body.skinning.rounded`). Displaced
vertices are kept for the backward pass, all instants of one side by side.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.body.body_skinning import (
    gather,
    load_gradient,
    move_point,
    point_backward,
    spread,
    table_backward,
    whole_block,
)
from hfb.kernels.body.body_vector import FEATURES, add_features, displacements
from hfb.kernels.compile import LOOP, entry
from hfb.kernels.simd import LANES, lanes, load_lanes, multiply_add, prefetch, store_lanes

AHEAD = 4  # number of vertices whose directions are prefetched
_LINE = 32  # 16-bit numbers in a cache line


@njit(**LOOP)
def _read_ahead(directions, v):
    """Prefetch a vertex's directions; beyond the last one nothing happens."""
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


@njit(**LOOP)
def _blend_and_skin_block(table, feature, rest, directions, steps, starts, joints, weights, points, to, vertices):
    """Fill `points` (V, 3 x LANES) and LANES bodies of `vertices`, from number `to` on."""
    stride = 3 * rest.shape[0]
    for v in range(rest.shape[0]):
        _read_ahead(directions, v + AHEAD)
        x, y, z = displacements(feature, directions, 3 * v * FEATURES)
        x = multiply_add(x, steps[v, 0], lanes(rest[v, 0]))
        y = multiply_add(y, steps[v, 1], lanes(rest[v, 1]))
        z = multiply_add(z, steps[v, 2], lanes(rest[v, 2]))
        at = 3 * LANES * v
        store_lanes(points, at, x)
        store_lanes(points, at + LANES, y)
        store_lanes(points, at + 2 * LANES, z)
        move_point(x, y, z, table, starts, joints, weights, v, to + 3 * v, stride, vertices)


@entry
def blend_and_skin(transforms, rotations, rest, directions, steps, starts, joints, weights, points, vertices):
    """Fill `vertices` by skinning (SMPL's eq. 2) of the rest vertices plus pose blend shapes.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        rotations: (S, 24, 3, 3), of each joint in its parent's frame.
        rest: (V, 3), rest vertices [m].
        directions: (V, 3, FEATURES), pose blend shapes in units of `steps`.
        steps: (V, 3), unit of each row of `directions` [m].
        starts: (V + 1), where each vertex's joints and weights begin.
        joints: joint of each skinning weight.
        weights: skinning weights.
        points: (S / LANES, V, 3 x LANES), filled with the vertices before skinning.
        vertices: (S, V, 3), filled.
    """
    table, feature = np.empty((transforms.shape[1], 12 * LANES), rest.dtype), np.zeros((LANES, FEATURES), rest.dtype)
    for first in range(0, transforms.shape[0], LANES):
        n, block = min(LANES, transforms.shape[0] - first), points[first // LANES]
        spread(transforms, first, n, table)
        _list_features(rotations, first, n, feature)
        inputs = table, feature, rest, directions, steps, starts, joints, weights, block
        if n == LANES:
            _blend_and_skin_block(*inputs, first * rest.size, vertices)
        else:
            moved = np.empty((LANES, rest.shape[0], 3), rest.dtype)
            _blend_and_skin_block(*inputs, 0, moved)
            vertices[first:] = moved[:n]


@njit(**LOOP)
def _list_touched(grad_output, first, touched):
    """Fill `touched` with the vertices of which any of LANES gradients is not zero; returns how many."""
    count, vertices = 0, grad_output.shape[1]
    for v in range(vertices):
        _, _, _, some = load_gradient(grad_output, first + 3 * v, 3 * vertices)
        touched[count] = v
        count += some
    return count


@njit(**LOOP)
def _gradient_block(
    table,
    directions,
    steps,
    starts,
    joints,
    weights,
    points,
    grad_output,
    first,
    touched,
    count,
    of_table,
    of_rest,
    of_feature,
):
    stride = 3 * grad_output.shape[1]
    for number in range(count):
        v = touched[number]
        _read_ahead(directions, touched[min(number + AHEAD, count - 1)])
        x, y, z, _ = load_gradient(grad_output, first + 3 * v, stride)
        grad_vertex, at = (x, y, z), 3 * LANES * v
        point = load_lanes(points, at), load_lanes(points, at + LANES), load_lanes(points, at + 2 * LANES)
        table_backward(starts, joints, weights, v, grad_vertex, point, of_table)
        x, y, z = point_backward(table, starts, joints, weights, v, grad_vertex, of_rest)
        x, y, z = x * steps[v, 0], y * steps[v, 1], z * steps[v, 2]
        add_features(of_feature, directions, 3 * v * FEATURES, x, y, z)


@entry
def blend_and_skin_gradient(
    transforms, directions, steps, starts, joints, weights, points, grad_output, of_transforms, of_rotations, of_rest
):
    """Compute the gradients of `blend_and_skin`.

    Vertices that the camera does not see have no gradient and are skipped, half of the work.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        directions: (V, 3, FEATURES), pose blend shapes in units of `steps`.
        steps: (V, 3), unit of each row of `directions` [m].
        starts: (V + 1), where each vertex's joints and weights begin.
        joints: joint of each skinning weight.
        weights: skinning weights.
        points: (S / LANES, V, 3 x LANES), vertices before skinning.
        grad_output: (S, V, 3), gradient by the vertices.
        of_transforms: gradient, filled.
        of_rotations: gradient, filled but for the root.
        of_rest: gradient, added to.
    """
    kind = transforms.dtype
    table, of_feature = np.empty((transforms.shape[1], 12 * LANES), kind), np.empty((LANES, FEATURES), kind)
    touched = np.empty(grad_output.shape[1] + 1, np.int64)
    for first in range(0, transforms.shape[0], LANES):
        n, block = min(LANES, transforms.shape[0] - first), points[first // LANES]
        of_table = np.zeros(table.shape, kind)
        of_feature[:] = 0.0
        spread(transforms, first, n, table)
        whole, at = whole_block(grad_output, first)
        count = _list_touched(whole, at, touched)
        _gradient_block(
            table,
            directions,
            steps,
            starts,
            joints,
            weights,
            block,
            whole,
            at,
            touched,
            count,
            of_table,
            of_rest,
            of_feature,
        )
        gather(of_table, first, n, of_transforms)
        for s in range(n):
            for j in range(1, of_rotations.shape[1]):
                for r in range(3):
                    for c in range(3):
                        of_rotations[first + s, j, r, c] = of_feature[s, 9 * (j - 1) + 3 * r + c]
