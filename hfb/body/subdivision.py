"""A denser body: every triangle becomes four, on a smoother surface, with the same skeleton and the same texture.

Synthetic truth is rendered from it, so that a fit does not use the very polyhedron that made the image.
"""

import numpy as np
import torch
from scipy import sparse

from hfb.body.mesh import Mesh, make_mesh
from hfb.body.model import Body
from hfb.typing import Array, Int, Tensor

_WING = 1 / 16
"""The butterfly scheme's weight: of its limit surface, smooth where six triangles meet."""

_STEEPEST = 0.2
"""A new vertex leaves its edge by at most this share of the edge's length: slivers must not fold over."""


def subdivide(body: Body) -> Body:
    """Return the body with a new vertex in the middle of every edge; old vertices and all joints stay where they are.

    New vertices follow the butterfly scheme (Dyn, Levin & Gregory, A butterfly subdivision scheme for surface
    interpolation with tension control, 1990): 1/2 of both ends, 1/8 of the two vertices across, -1/16 of the four
    beyond; where the surface has a border they are midpoints. The same linear rule makes their shape and pose
    directions; skinning weights and texture coordinates are those of midpoints, so weights stay within [0, 1] and
    texture seams stay seams.

    Args:
        body: body to subdivide.
    """
    faces = body.mesh.faces.numpy()
    edge_of_side = _edges_of_sides(body.mesh)
    ends = body.mesh.edge_vertices.numpy()
    count = len(body.template)
    middle = _sparse(ends, np.full(ends.shape, 0.5), count)
    bulge = _butterfly(faces, edge_of_side, len(ends), count)
    template = body.template.double().numpy()
    length = np.linalg.norm(template[ends[:, 0]] - template[ends[:, 1]], axis=1)
    height = np.linalg.norm(bulge @ template, axis=1)
    smooth = middle + sparse.diags_array(np.minimum(1, _STEEPEST * length / np.maximum(height, 1e-12))) @ bulge
    uv, uv_faces = _subdivide_uv(body.mesh)
    return Body(
        name=f"{body.name}, subdivided",
        betas_space=body.betas_space,
        licence=body.licence,
        source=body.source,
        template=_extend(smooth, body.template),
        shape_directions=_extend(smooth, body.shape_directions),
        pose_directions=None if body.pose_directions is None else _extend(smooth, body.pose_directions),
        joint_regressor=torch.nn.functional.pad(body.joint_regressor, (0, len(ends))),
        joint_template=body.joint_template,
        joint_shape_directions=body.joint_shape_directions,
        skinning_weights=_extend(middle, body.skinning_weights),
        mesh=make_mesh(_four_faces(faces, edge_of_side + count), uv, uv_faces, body.mesh.uv.dtype),
    )


def _edges_of_sides(mesh: Mesh) -> Int[Array, "F 3"]:
    """Return the edge of side k of each face, from its corner k to the next."""
    faces, ends, owners = (table.numpy() for table in (mesh.faces, mesh.edge_vertices, mesh.edge_faces))
    edge_of_side = np.full(faces.shape, -1, np.int64)
    for owner in owners.T:
        edge = np.flatnonzero(owner >= 0)
        corners = faces[owner[edge]]
        same = (corners == ends[edge, :1]) & (np.roll(corners, -1, 1) == ends[edge, 1:])
        opposite = (corners == ends[edge, 1:]) & (np.roll(corners, -1, 1) == ends[edge, :1])
        edge_of_side[owner[edge], np.logical_or(same, opposite).argmax(1)] = edge
    return edge_of_side


def _four_faces(faces: Int[Array, "F 3"], middles: Int[Array, "F 3"]) -> Int[Array, "F4 3"]:
    """Return the corner triangles and the one between them, turned like the old face."""
    (a, b, c), (ab, bc, ca) = faces.T, middles.T
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(part, -1) for part in parts], 1).reshape(-1, 3)


def _butterfly(
    faces: Int[Array, "F 3"], edge_of_side: Int[Array, "F 3"], edges: int, vertices: int
) -> sparse.csr_array:
    """Return the butterfly scheme's correction of each edge's midpoint; zero near a border."""
    # Both uses of every edge as sides (face * 3 + side); -1 where there is no second face.
    flat = edge_of_side.reshape(-1)
    order = np.argsort(flat, kind="stable")
    sides = np.full((edges, 2), -1, np.int64)
    first = np.searchsorted(flat[order], np.arange(edges))
    sides[:, 0] = order[first]
    following = np.minimum(first + 1, len(order) - 1)
    paired = (following > first) & (flat[order[following]] == np.arange(edges))
    sides[paired, 1] = order[following[paired]]

    def across(side: Int[Array, "n"]) -> Int[Array, "n"]:
        """The corner opposite to a side; -1 for no side."""
        return np.where(side >= 0, faces[side // 3, (side % 3 + 2) % 3], -1)

    def other_use(side: Int[Array, "n"]) -> Int[Array, "n"]:
        pair = sides[flat[side]]
        return np.where(pair[:, 0] == side, pair[:, 1], pair[:, 0])

    near = [across(sides[:, 0]), across(sides[:, 1])]
    wings = [
        np.where(side >= 0, across(other_use(side // 3 * 3 + (side + turn) % 3)), -1)
        for side in sides.T
        for turn in (1, 2)
    ]
    corners = np.stack(near + wings, 1)
    # The six weights add up to zero: 2 / 8 - 4 / 16; the ends keep their halves.
    weights = np.array([2 * _WING] * 2 + [-_WING] * 4) * np.all(corners >= 0, axis=1, keepdims=True)
    return _sparse(np.maximum(corners, 0), weights, vertices)


def _sparse(columns: Int[Array, "E n"], weights: Array, vertices: int) -> sparse.csr_array:
    rows = np.repeat(np.arange(len(columns)), columns.shape[1])
    return sparse.csr_array((weights.reshape(-1), (rows, columns.reshape(-1))), shape=(len(columns), vertices))


def _extend(rule: sparse.csr_array, values: Tensor) -> Tensor:
    """Append the new vertices' values by a rule to those of the old ones."""
    new = rule @ values.flatten(1).double().numpy()
    return torch.cat([values, torch.from_numpy(new).to(values.dtype).unflatten(1, values.shape[1:])])


def _subdivide_uv(mesh: Mesh) -> tuple[Array, Array]:
    """Return (uv, uv_faces) with a new coordinate in the middle of every side, shared by all faces of a chart."""
    uv, faces = mesh.uv.double().numpy(), mesh.uv_faces.numpy()
    starts, stops = faces.reshape(-1), np.roll(faces, -1, 1).reshape(-1)
    key = np.minimum(starts, stops) * len(uv) + np.maximum(starts, stops)
    unique, of_side = np.unique(key, return_inverse=True)
    middles = (uv[unique // len(uv)] + uv[unique % len(uv)]) / 2
    return np.concatenate([uv, middles]), _four_faces(faces, of_side.reshape(-1, 3) + len(uv))
