"""The prototype shape of SfB and MfB: a deformable sphere of triangles with a texture atlas."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.atlas import make_atlas
from hfb.body.mesh import Mesh, make_mesh
from hfb.typing import Array, Float, Int, Tensor

_GOLDEN = (1 + 5**0.5) / 2
_ICOSAHEDRON = np.array(
    [
        (-1, _GOLDEN, 0), (1, _GOLDEN, 0), (-1, -_GOLDEN, 0), (1, -_GOLDEN, 0), (0, -1, _GOLDEN), (0, 1, _GOLDEN),
        (0, -1, -_GOLDEN), (0, 1, -_GOLDEN), (_GOLDEN, 0, -1), (_GOLDEN, 0, 1), (-_GOLDEN, 0, -1), (-_GOLDEN, 0, 1),
    ]
)  # fmt: skip
_TRIANGLES = np.array(
    [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
        (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7),
        (9, 8, 1),
    ]
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sphere:
    """A unit sphere about the origin.

    Attributes:
        mesh: closed, with six texture charts, one per direction.
        smoothing: row v holds 1 / (number of neighbours) at v's neighbours: the mean of the ring around a vertex.
    """

    vertices: Float[Tensor, "V 3"]
    mesh: Mesh
    smoothing: Float[Tensor, "V V"]

    def laplacian(self, offsets: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Return each vertex's offset minus the mean of its neighbours'.

        Args:
            offsets: offsets of the vertices, in radii.
        """
        return offsets - torch.sparse.mm(self.smoothing, offsets)


def make_sphere(subdivisions: int = 3) -> Sphere:
    """Build a sphere from an icosahedron by splitting its faces into four: 10 * 4^n + 2 vertices (642 for n = 3).

    Args:
        subdivisions: n, how often the faces are split.
    """
    vertices, faces = _ICOSAHEDRON / np.linalg.norm(_ICOSAHEDRON[0]), _TRIANGLES
    for _ in range(subdivisions):
        vertices, faces = _split(vertices, faces)
    one_limb = np.eye(1, 24)[np.zeros(len(vertices), np.int64)]
    uv, uv_faces = make_atlas(vertices, faces, one_limb)
    mesh = make_mesh(faces, uv, uv_faces, torch.float32)
    return Sphere(torch.from_numpy(vertices).float(), mesh, _ring_means(mesh.edge_vertices, len(vertices)))


def _split(vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"]) -> tuple[Float[Array, "W 3"], Int[Array, "G 3"]]:
    """Split each face into four; each edge's middle, projected to the sphere, becomes a vertex."""
    corners = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1), -1)  # F, its three edges, their two ends
    edges, number = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    middles = vertices[edges].sum(1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    (a, b, c), (ab, bc, ca) = faces.T, number.reshape(-1, 3).T + len(vertices)
    parts = [np.stack(part, 1) for part in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.concatenate([vertices, middles]), np.concatenate(parts)


def _ring_means(edges: Int[Tensor, "E 2"], count: int) -> Float[Tensor, "V V"]:
    both_ways = torch.cat([edges, edges.flip(1)]).T
    share = 1 / torch.bincount(both_ways[0], minlength=count).float()
    return torch.sparse_coo_tensor(both_ways, share[both_ways[0]], (count, count), check_invariants=True).coalesce()
