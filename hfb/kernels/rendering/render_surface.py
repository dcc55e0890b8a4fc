"""Compiled texture coordinates of a point of a face."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE


@njit(**INLINE)
def corner_of(faces, f, vertex):
    """Return the corner (0, 1, 2) of face f that is a vertex.

    Args:
        faces: (F, 3), vertex numbers.
        f: number of the face.
        vertex: its number.
    """
    if faces[f, 0] == vertex:
        return 0
    return 1 if faces[f, 1] == vertex else 2


@njit(**INLINE)
def uv_of_face(px, py, projected, faces, uv, f):
    """Return the perspective-correct texture coordinates of face f at a pixel position.

    Args:
        px: position [px].
        py: position [px].
        projected: (V, 4), x, y [px], 1/z [1/m].
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        f: number of the face.
    """
    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
    x0, y0 = projected[i, 0], projected[i, 1]
    ax, ay = projected[j, 0] - x0, projected[j, 1] - y0
    bx, by = projected[k, 0] - x0, projected[k, 1] - y0
    inverse = 1.0 / (ax * by - bx * ay)
    b1 = ((px - x0) * by - (py - y0) * bx) * inverse
    b2 = ((py - y0) * ax - (px - x0) * ay) * inverse
    w0, w1, w2 = (1.0 - b1 - b2) * projected[i, 2], b1 * projected[j, 2], b2 * projected[k, 2]
    scale = 1.0 / (w0 + w1 + w2)
    return (
        (w0 * uv[f, 0, 0] + w1 * uv[f, 1, 0] + w2 * uv[f, 2, 0]) * scale,
        (w0 * uv[f, 0, 1] + w1 * uv[f, 1, 1] + w2 * uv[f, 2, 1]) * scale,
    )


@njit(**INLINE)
def first_texel(coordinate, size):
    """Return the first of the two texels, along one axis, from which a coordinate is interpolated.

    Args:
        coordinate: in [0, 1].
        size: texels along the axis.
    """
    position = min(max(coordinate * size - 0.5, 0.0), size - 1.0)
    return min(np.uint32(position), np.uint32(max(size, 2) - 2))
