"""Compiled parts: vertices on the screen, and the outline of the faces that look at the camera.

Coordinates are pixels (x right, y down) in float64; `box` is (left, top, right, bottom) in whole pixels; `lens` is
(fx, fy, cx, cy, nearest depth used, width, height).
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.render.kernels_compile import LOOP

FAR_PX = 1e9  # a corner projected farther out than this is not used


@njit(**LOOP)
def project(vertices, lens, margin, projected, box):
    """Fill `projected` (V, 3) with x, y [px] and 1/z, 0 where the vertex cannot be used; `box` with their bounds,
    enlarged by a margin [px] and cut to the picture."""
    fx, fy, cx, cy, near, width, height = lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6]
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(vertices.shape[0]):
        projected[i, 2] = 0.0
        z = np.float64(vertices[i, 2])
        if z > near:  # false for NaN too
            inverse = 1.0 / z
            x = fx * np.float64(vertices[i, 0]) * inverse + cx
            y = fy * np.float64(vertices[i, 1]) * inverse + cy
            if abs(x) < FAR_PX and abs(y) < FAR_PX and inverse > 0.0:
                projected[i, 0], projected[i, 1], projected[i, 2] = x, y, inverse
                left, right = min(left, x), max(right, x)
                top, bottom = min(top, y), max(bottom, y)
    left, top, right, bottom = left - margin, top - margin, right + margin, bottom + margin
    if left > right:
        box[0], box[1], box[2], box[3] = 0, 0, 0, 0
        return
    box[0] = int(max(0.0, np.floor(min(left, width))))
    box[1] = int(max(0.0, np.floor(min(top, height))))
    box[2] = int(min(width, np.floor(max(right, 0.0)) + 1))
    box[3] = int(min(height, np.floor(max(bottom, 0.0)) + 1))
    if box[0] >= box[2] or box[1] >= box[3]:
        box[0], box[1], box[2], box[3] = 0, 0, 0, 0


@njit(**LOOP)
def to_metres(projected, vertices, lens, on_screen, gradient):
    """Chain rule through x = fx X / Z + cx, y = fy Y / Z + cy, q = 1 / Z."""
    fx, fy = lens[0], lens[1]
    for i in range(vertices.shape[0]):
        q = projected[i, 2]
        gx, gy = on_screen[i, 0] * fx, on_screen[i, 1] * fy
        gradient[i, 0] = gx * q
        gradient[i, 1] = gy * q
        by_inverse = on_screen[i, 2] + gx * np.float64(vertices[i, 0]) + gy * np.float64(vertices[i, 1])
        gradient[i, 2] = -q * q * by_inverse


@njit(**LOOP)
def find_front(projected, faces, front):
    """Mark the faces that look at the camera: negative signed area in (x right, y down)."""
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (projected[j, 0] - projected[i, 0]) * (projected[k, 1] - projected[i, 1]) - (
            projected[k, 0] - projected[i, 0]
        ) * (projected[j, 1] - projected[i, 1])
        usable = projected[i, 2] > 0.0 and projected[j, 2] > 0.0 and projected[k, 2] > 0.0
        front[f] = usable and area < 0.0


@njit(**LOOP)
def find_outline(front, edge_vertices, edge_faces, outline):
    """Fill rows (from, to, front face), directed as the front face traverses the edge; returns their number."""
    n = 0
    for e in range(edge_faces.shape[0]):
        first, second = edge_faces[e, 0], edge_faces[e, 1]
        is_first = front[first]
        is_second = front[second] if second >= 0 else False
        if is_first != is_second:
            if is_first:
                outline[n, 0], outline[n, 1], outline[n, 2] = edge_vertices[e, 0], edge_vertices[e, 1], first
            else:
                outline[n, 0], outline[n, 1], outline[n, 2] = edge_vertices[e, 1], edge_vertices[e, 0], second
            n += 1
    return n
