"""A texture atlas for bodies that come without one (SMPL's files have no texture coordinates).

Faces are sorted into charts that look the same way (+x, -x, ... -z, in the T-pose) and belong to the same limb;
each connected chart is laid flat along its axis, so no chart is stretched more than about two times, and
all are packed at one scale into the unit square. Deterministic; not SMPL's own published layout.
"""

import numpy as np

from hfb.body.mesh import edges_of
from hfb.typing import Array, Float, Int

# SMPL's joints by limb: trunk and head, left and right leg, left and right arm.
_LIMB = np.array([0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 0, 0, 0, 3, 4, 3, 4, 3, 4, 3, 4])
_SMOOTHING = 6  # rounds in which each face's normal is averaged with its neighbours'
_SMALLEST = 40  # faces; smaller charts join a neighbour
_STILL_VISIBLE = 0.15  # cosine to the chart's axis that a joining face must keep
_PADDING = 1.5 / 128  # between charts: more than a texel of the default texture
_PLANE = {0: (2, 1), 1: (0, 2), 2: (0, 1)}  # coordinates left when looking along an axis


def make_atlas(
    vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"], weights: Float[Array, "V 24"]
) -> tuple[Float[Array, "U 2"], Int[Array, "F 3"]]:
    """Return (uv, uv_faces) in [0, 1], v = 0 at the top row.

    Args:
        vertices: T-pose [m].
        faces: vertex numbers of each triangle.
        weights: skinning weights, which tell the limb of each vertex.
    """
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    edge_faces = edges_of(faces)[1]
    pairs = edge_faces[edge_faces[:, 1] >= 0]
    axis = _looking_along(normals, pairs)
    limb = _LIMB[weights[faces].sum(1).argmax(1)]
    chart = _connected(axis + 6 * limb, pairs)
    axis = _absorb_small(chart, axis, normals, pairs)
    chart = _connected(chart, pairs)
    corner_chart = np.repeat(chart, 3)
    key = corner_chart * len(vertices) + faces.reshape(-1)
    unique, uv_faces = np.unique(key, return_inverse=True)
    uv_chart, uv_vertex = unique // len(vertices), unique % len(vertices)
    chart_axis = np.zeros(chart.max() + 1, dtype=np.int64)
    chart_axis[chart] = axis
    flat = _flatten(vertices[uv_vertex], chart_axis[uv_chart])
    return _pack(flat, uv_chart), uv_faces.reshape(-1, 3)


def _looking_along(normals: Float[Array, "F 3"], pairs: Int[Array, "P 2"]) -> Int[Array, "F"]:
    """Return 0..5 for +x, -x, +y, -y, +z, -z, the axis nearest to the smoothed normal."""
    smooth = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    for _ in range(_SMOOTHING):
        total = smooth.copy()
        np.add.at(total, pairs[:, 0], smooth[pairs[:, 1]])
        np.add.at(total, pairs[:, 1], smooth[pairs[:, 0]])
        smooth = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return np.stack([smooth, -smooth], 2).reshape(-1, 6).argmax(1)


def _connected(label: Int[Array, "F"], pairs: Int[Array, "P 2"]) -> Int[Array, "F"]:
    """Number the connected sets of equally labelled faces: each takes the smallest face index in reach."""
    same = pairs[label[pairs[:, 0]] == label[pairs[:, 1]]]
    root = np.arange(len(label))
    while True:
        low = np.minimum(root[same[:, 0]], root[same[:, 1]])
        before = root.copy()
        np.minimum.at(root, root[same[:, 0]], low)
        np.minimum.at(root, root[same[:, 1]], low)
        root = root[root]
        if (root == before).all():
            return np.unique(root, return_inverse=True)[1].astype(np.int64)


def _absorb_small(
    chart: Int[Array, "F"], axis: Int[Array, "F"], normals: Float[Array, "F 3"], pairs: Int[Array, "P 2"]
) -> Int[Array, "F"]:
    """Let faces of small charts join a larger neighbour that sees them; changes `chart`, returns the axes."""
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    toward = np.stack([unit, -unit], 2).reshape(-1, 6)
    both_ways = np.concatenate([pairs, pairs[:, ::-1]])
    axis = axis.copy()
    for _ in range(64):
        size = np.bincount(chart)
        own, other = both_ways.T
        wants = (size[chart[own]] < _SMALLEST) & (size[chart[other]] > size[chart[own]])
        wants &= toward[own, axis[other]] > _STILL_VISIBLE
        if not wants.any():
            break
        own, other = own[wants], other[wants]
        order = np.argsort(size[chart[other]], kind="stable")  # the largest neighbour is written last
        own, other = own[order], other[order]
        joined, joined_axis = chart[other], axis[other]
        chart[own], axis[own] = joined, joined_axis
    return axis


def _flatten(points: Float[Array, "U 3"], axis: Int[Array, "U"]) -> Float[Array, "U 2"]:
    flat = np.zeros((len(points), 2))
    for direction, (across, up) in _PLANE.items():
        mine = axis // 2 == direction
        flat[mine] = points[mine][:, [across, up]]
    return flat


def _pack(flat: Float[Array, "U 2"], chart: Int[Array, "U"]) -> Float[Array, "U 2"]:
    """Move every chart to a place of its own in the unit square, at the largest common scale that fits."""
    count = chart.max() + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, flat)
    np.maximum.at(high, chart, flat)
    size = high - low
    upright = size[:, 1] >= size[:, 0]  # lay long charts on their side: shelves are flat
    size = np.where(upright[:, None], size[:, ::-1], size)
    local = flat - low[chart]
    local = np.where(upright[chart][:, None], local[:, ::-1], local)
    too_small, too_large = 0.0, 1.0 / float(size.max())
    for _ in range(30):
        scale = (too_small + too_large) / 2
        if _shelves(size * scale + _PADDING) is None:
            too_large = scale
        else:
            too_small = scale
    corner = _shelves(size * too_small + _PADDING)
    assert corner is not None
    uv = corner[chart] + _PADDING / 2 + local * too_small
    uv[:, 1] = 1 - uv[:, 1]  # up in the body is up in the texture, whose first row is v = 0
    return np.clip(uv, 0.0, 1.0)


def _shelves(size: Float[Array, "N 2"]) -> Float[Array, "N 2"] | None:
    """Pack boxes on shelves, highest first, each on the first shelf with room; None where they do not fit."""
    corner = np.zeros_like(size)
    shelves: list[list[float]] = []  # [height at which it hangs, width taken]
    top = 0.0
    for box in np.lexsort((-size[:, 0], -size[:, 1])):
        width, height = size[box].tolist()
        shelf = next((shelf for shelf in shelves if shelf[1] + width <= 1), None)
        if shelf is None:
            shelf = [top, 0.0]
            shelves.append(shelf)
            top += height
            if top > 1 or width > 1:
                return None
        corner[box] = shelf[1], shelf[0]
        shelf[1] += width
    return corner
