"""The constant mesh of a body: triangles, texture coordinates and edges."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.typing import Array, Float, Int, Tensor


@dataclass(frozen=True, eq=False)
class Mesh:
    """The constant part of a triangle mesh.

    Attributes:
        faces: vertex indices, counter-clockwise seen from outside.
        uv: texture coordinates in [0, 1]; v = 0 is the TOP row of the texture.
        uv_faces: for each corner of `faces`, its row of `uv`.
        edge_vertices: every undirected edge once, its vertices in the order in which ``faces[edge_faces[:, 0]]``
            traverses them.
        edge_faces: the two faces of that edge; the second is -1 at a boundary. Where more than two faces meet,
            every further pair of faces is listed as an edge of its own.
    """

    faces: Int[Tensor, "F 3"]
    uv: Float[Tensor, "U 2"]
    uv_faces: Int[Tensor, "F 3"]
    edge_vertices: Int[Tensor, "E 2"]
    edge_faces: Int[Tensor, "E 2"]

    def to(self, dtype: torch.dtype) -> "Mesh":
        """Return the mesh with texture coordinates of another precision.

        Args:
            dtype: precision of the texture coordinates.
        """
        return Mesh(self.faces, self.uv.to(dtype), self.uv_faces, self.edge_vertices, self.edge_faces)


def edges_of(faces: Int[Array, "F 3"]) -> tuple[Int[Array, "E 2"], Int[Array, "E 2"]]:
    """Return (edge_vertices, edge_faces) of a triangle list; see `Mesh`.

    Args:
        faces: vertex numbers of each triangle.
    """
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    owner = np.tile(np.arange(len(faces), dtype=np.int64), 3)
    key = directed.min(1) * (int(faces.max(initial=0)) + 1) + directed.max(1)
    order = np.argsort(key, kind="stable")
    key, directed, owner = key[order], directed[order], owner[order]
    # Rank of each use among the uses of its edge: even ranks open an edge, odd ranks are its second face.
    first_use = np.searchsorted(key, key, side="left")
    rank = np.arange(len(key)) - first_use
    opens = np.flatnonzero(rank % 2 == 0)
    second = np.full(len(opens), -1, dtype=np.int64)
    following = opens + 1
    paired = (following < len(key)) & (key[np.minimum(following, len(key) - 1)] == key[opens])
    second[paired] = owner[following[paired]]
    return directed[opens], np.stack([owner[opens], second], 1)


def make_mesh(
    faces: Int[Array, "F 3"], uv: Float[Array, "U 2"], uv_faces: Int[Array, "F 3"], dtype: torch.dtype
) -> Mesh:
    """Build a `Mesh` and find its edges.

    Args:
        faces: vertex numbers of each triangle.
        uv: texture coordinates in [0, 1].
        uv_faces: texture coordinates of each triangle's corners.
        dtype: precision of the texture coordinates.
    """
    edge_vertices, edge_faces = edges_of(faces)
    return Mesh(
        faces=torch.from_numpy(faces.astype(np.int64)),
        uv=torch.from_numpy(uv.astype(np.float64)).to(dtype),
        uv_faces=torch.from_numpy(uv_faces.astype(np.int64)),
        edge_vertices=torch.from_numpy(edge_vertices),
        edge_faces=torch.from_numpy(edge_faces),
    )


def vertex_normals(vertices: Float[Tensor, "S V 3"], mesh: Mesh) -> Float[Tensor, "S V 3"]:
    """Return unit normals, each the mean of its faces' weighted by their areas.

    Args:
        vertices: vertices of each instant [m].
        mesh: their triangles.
    """
    corners = vertices[:, mesh.faces]
    normals = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    summed = torch.zeros_like(vertices)
    for corner in range(3):
        summed.index_add_(1, mesh.faces[:, corner], normals)
    return torch.nn.functional.normalize(summed, dim=-1)
