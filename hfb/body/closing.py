"""Close the holes of a triangle mesh with fans of existing vertices, so that its silhouette is that of a solid.

trimesh's `fill_holes` is not used: it searches cycles by networkx, which takes minutes for hostile files of many edges,
and it has no texture coordinates.
"""

import numpy as np

from hfb.body.mesh import edges_of
from hfb.typing import Array, Int


def boundary_loops(faces: Int[Array, "F 3"]) -> list[list[int]]:
    """Return closed chains of vertices around the holes, in the order of the faces that fill them.

    Args:
        faces: vertex numbers of each triangle.
    """
    edge_vertices, edge_faces = edges_of(faces)
    follow: dict[int, list[int]] = {}
    # The mesh runs along its boundary as (a, b); what closes it runs from b to a.
    for a, b in edge_vertices[edge_faces[:, 1] < 0].tolist():
        follow.setdefault(b, []).append(a)
    loops = []
    while follow:
        start = min(follow)
        loop, place = [start], {start: 0}
        while True:
            onward = follow.get(loop[-1])
            if not onward:
                break  # faces of mixed orientation: no loop through here
            at = onward.pop()
            if not onward:
                del follow[loop[-1]]
            if at in place:  # a closed loop ends here; where loops touch in a vertex, the rest goes on
                first = place[at]
                loops.append(loop[first:])
                for vertex in loop[first + 1 :]:
                    del place[vertex]
                del loop[first + 1 :]
                continue
            place[at] = len(loop)
            loop.append(at)
    return [loop for loop in loops if len(loop) >= 3]


def fans(loops: list[list[int]]) -> Int[Array, "N 3"]:
    """Return triangles that fill the loops, each fanned out from its first vertex.

    Args:
        loops: by `boundary_loops`.
    """
    triangles = [(loop[0], loop[k], loop[k + 1]) for loop in loops for k in range(1, len(loop) - 1)]
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)


def fan_corners(filling: Int[Array, "N 3"], faces: Int[Array, "F 3"], uv_faces: Int[Array, "F 3"]) -> Int[Array, "N 3"]:
    """Return texture coordinates for the corners of new faces: those of their vertices on an old face.

    Args:
        filling: new faces.
        faces: old faces.
        uv_faces: texture coordinates of the old faces' corners.
    """
    of_vertex = np.full(int(faces.max()) + 1, -1, dtype=np.int64)
    of_vertex[faces.reshape(-1)] = uv_faces.reshape(-1)
    return of_vertex[filling]
