"""The left half of the skin without mouth and eye sockets, its holes closed, and its mirror image sewn back on.

Working on one half makes the result exactly symmetric and halves the work. MakeHuman's mesh is symmetric: the mirror
image of each vertex and of each texture coordinate is in the mesh.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hfb.training.schedule import tell

MIDDLE_M = 1e-6


@dataclass(frozen=True)
class Half:
    """Faces with x >= 0. Vertex and texture indices are those of the whole skin."""

    faces: np.ndarray  # (F, 3)
    uv_faces: np.ndarray  # (F, 3)
    on_middle: np.ndarray  # (V,) bool, vertices of the plane x = 0


def mirror_of(rest: np.ndarray) -> np.ndarray:
    """Return the index of every vertex's mirror image, (V,).

    Args:
        rest: (V, 3) vertices of a mesh symmetric about x = 0 [m].
    """
    distance, index = cKDTree(rest).query(rest * [-1, 1, 1])
    assert distance.max() < MIDDLE_M, "the mesh is not symmetric"
    assert (index[index] == np.arange(len(rest))).all(), "the mesh is not symmetric"
    return index


def outer_skin(rest: np.ndarray, faces: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Return a mask of the faces (F,) in the largest connected part without ``inner``: no eyeballs, no tongue.

    Args:
        rest: (V, 3) vertices [m].
        faces: (F, 3) vertex indices.
        inner: (F,) bool, eye sockets and mouth.
    """
    links = coo_matrix((np.ones(faces.size), (faces.ravel(), np.roll(faces, 1, 1).ravel())), shape=(len(rest),) * 2)
    part = connected_components(links, directed=False)[1][faces[:, 0]]
    return (part == np.bincount(part).argmax()) & ~inner


def left_half(rest: np.ndarray, faces: np.ndarray, uv_faces: np.ndarray, keep: np.ndarray) -> Half:
    """Return the kept faces at x >= 0; holes left by ``keep`` are closed with existing vertices.

    Args:
        rest: (V, 3) vertices [m].
        faces: (F, 3) vertex indices.
        uv_faces: (F, 3) texture coordinate indices.
        keep: (F,) bool, the faces to keep.
    """
    left = keep & (rest[faces, 0].max(1) > MIDDLE_M)
    assert rest[faces[left], 0].min() > -MIDDLE_M, "faces cross the middle plane"
    on_middle = np.abs(rest[:, 0]) < MIDDLE_M
    faces, uv_faces = faces[left], uv_faces[left]
    new_faces, new_uv_faces = [faces], [uv_faces]
    for loop, uv_loop in _holes(faces, uv_faces, on_middle):
        corners = np.array(_triangulate(rest[loop]))
        new_faces.append(np.array(loop)[corners])
        new_uv_faces.append(np.array(uv_loop)[corners])
        tell(f"closed a hole of {len(loop)} vertices at {rest[loop].mean(0).round(3)}")
    return Half(np.concatenate(new_faces), np.concatenate(new_uv_faces), on_middle)


def _holes(faces: np.ndarray, uv_faces: np.ndarray, on_middle: np.ndarray) -> list[tuple[list[int], list[int]]]:
    """Return boundary chains off the middle plane as closing polygons: (vertices, texture coordinates)."""
    directed = {}
    for face, uv_face in zip(faces.tolist(), uv_faces.tolist(), strict=True):
        for k in range(3):
            directed[face[k - 1], face[k]] = uv_face[k - 1], uv_face[k]
    # The polygon runs against the skin's own edges.
    follow = {
        b: (a, uv_b, uv_a)
        for (a, b), (uv_a, uv_b) in directed.items()
        if (b, a) not in directed and not (on_middle[a] and on_middle[b])
    }
    starts = set(follow) - {a for a, _, _ in follow.values()}  # open chains begin at the middle plane
    holes = []
    while follow:
        start = at = starts.pop() if starts else next(iter(follow))
        loop, uv_loop = [], []
        while at in follow:
            following, uv, following_uv = follow.pop(at)
            loop.append(at)
            uv_loop.append(uv)
            at = following
        if at != start:  # an open chain: its last vertex lies on the middle plane, where the mirror image goes on
            loop.append(at)
            uv_loop.append(following_uv)
        holes.append((loop, uv_loop))
    return holes


def _triangulate(polygon: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangulate a closed polygon in space with least total area (dynamic programme over its chords)."""
    n = len(polygon)
    cost = np.zeros((n, n))
    split = np.zeros((n, n), dtype=int)
    for span in range(2, n):
        for i in range(n - span):
            k = i + span
            middle = np.arange(i + 1, k)
            area = np.linalg.norm(np.cross(polygon[middle] - polygon[i], polygon[k] - polygon[i]), axis=1)
            total = cost[i, middle] + cost[middle, k] + area
            cost[i, k], split[i, k] = total.min(), middle[total.argmin()]
    triangles, stack = [], [(0, n - 1)]
    while stack:
        i, k = stack.pop()
        if k - i >= 2:
            j = split[i, k]
            triangles.append((i, j, k))
            stack += [(i, j), (j, k)]
    return triangles


def mirror_uv(
    faces: np.ndarray, uv_faces: np.ndarray, mirror: np.ndarray, wanted: np.ndarray, wanted_uv: np.ndarray
) -> np.ndarray:
    """Return the texture coordinate on the right side for each (vertex, coordinate) of the left side.

    Found through the edges of the whole mesh: the corner at ``a`` of the face left of edge (a, b) mirrors the
    corner at ``a'`` of the face left of edge (b', a').

    Args:
        faces: (F, 3) vertex indices of the whole mesh.
        uv_faces: (F, 3) texture coordinate indices of the whole mesh.
        mirror: (V,) index of every vertex's mirror image.
        wanted: vertex indices of the left side, of any shape.
        wanted_uv: their texture coordinate indices, of the same shape.
    """
    after, before = {}, {}  # texture coordinate at an edge's end and at its start
    for face, uv_face in zip(faces.tolist(), uv_faces.tolist(), strict=True):
        for k in range(3):
            after[face[k - 1], face[k]] = uv_face[k]
            before[face[k - 1], face[k]] = uv_face[k - 1]
    image = {}
    for (a, b), uv_b in after.items():
        # Diagonals of split quads need not have a mirror image, but every corner touches a quad's side.
        mirrored = mirror[b], mirror[a]
        if mirrored in before:
            image[b, uv_b] = before[mirrored]
            image[a, before[a, b]] = after[mirrored]
    pairs = zip(wanted.ravel().tolist(), wanted_uv.ravel().tolist(), strict=True)
    return np.array([image[pair] for pair in pairs]).reshape(wanted.shape)
