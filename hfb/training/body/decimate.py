"""Mesh decimation by half-edge collapses: a vertex moves onto a neighbour, so the result is a subset of the mesh.

Each remaining vertex keeps its position in every shape sample, its weights and its texture coordinates exactly.
Order by Garland & Heckbert's quadric error (Surface Simplification Using Quadric Error Metrics, 1997).
"""

import heapq

import numpy as np

FLAT_TURN = 0.3  # cosine between a face's normal before and after a collapse
THIN = 0.12  # 4 sqrt(3) area / sum of squared sides: 1 for an equilateral triangle
LENGTH_SHARE = 2e-3  # weight of squared edge length in the cost: even triangles where the surface is flat


class Decimator:
    """A triangle mesh under edge collapse; vertices of ``on_middle`` stay on their plane, texture seams stay seams."""

    def __init__(self, points: np.ndarray, faces: np.ndarray, uv_faces: np.ndarray, on_middle: np.ndarray):
        """Take a mesh.

        Args:
            points: (V, 3) vertices [m].
            faces: (F, 3) vertex indices.
            uv_faces: (F, 3) texture coordinate indices.
            on_middle: (V,) bool, vertices of the plane x = 0.
        """
        self.points = points
        self.on_middle = on_middle
        self.faces = {i: list(face) for i, face in enumerate(faces.tolist())}
        self.uv_faces = {i: list(face) for i, face in enumerate(uv_faces.tolist())}
        self.at: dict[int, set[int]] = {int(v): set() for v in np.unique(faces)}  # faces around a vertex
        for i, face in self.faces.items():
            for v in face:
                self.at[v].add(i)
        self.quadrics = self._quadrics()
        self.version = dict.fromkeys(self.at, 0)

    def run(self, vertices_left: int) -> None:
        """Collapse the cheapest edges until the mesh is small enough.

        Args:
            vertices_left: target number of vertices.
        """
        heap = [entry for v in self.at for entry in self._candidates(v)]
        heapq.heapify(heap)
        alive = len(self.at)
        while alive > vertices_left and heap:
            _, u, v, stamp_u, stamp_v = heapq.heappop(heap)
            if u not in self.at or v not in self.at or (stamp_u, stamp_v) != (self.version[u], self.version[v]):
                continue
            uv_of = self._collapsible(u, v)
            if uv_of is None:
                continue
            touched = self._collapse(u, v, uv_of)
            alive -= 1
            for w in touched:
                self.version[w] += 1
            for w in touched:
                for entry in self._candidates(w):
                    heapq.heappush(heap, entry)
                for x in self._neighbours(w) - touched:
                    heapq.heappush(heap, self._entry(x, w))

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (faces, uv_faces) of the decimated mesh, with the indices of the original one."""
        return np.array(list(self.faces.values())), np.array(list(self.uv_faces.values()))

    def _normal(self, corners: list[int]) -> np.ndarray:
        a, b, c = self.points[corners]
        return np.cross(b - a, c - a)

    def _quadrics(self) -> dict[int, np.ndarray]:
        quadrics = {v: np.zeros((4, 4)) for v in self.at}
        for face in self.faces.values():
            normal = self._normal(face)
            area = float(np.linalg.norm(normal)) / 2
            if area > 0:
                self._add_plane(quadrics, face, normal / (2 * area), area)
            for k in range(3):
                a, b = face[k], face[(k + 1) % 3]
                if self.on_middle[a] and self.on_middle[b]:  # keep the outline of the cut: a wall along the edge
                    edge = self.points[b] - self.points[a]
                    wall = np.cross(edge, normal)
                    length = np.linalg.norm(wall)
                    if length > 0:
                        self._add_plane(quadrics, [a, b], wall / length, edge @ edge)
        return quadrics

    def _add_plane(self, quadrics: dict[int, np.ndarray], vertices: list[int], unit: np.ndarray, weight: float) -> None:
        plane = np.append(unit, -unit @ self.points[vertices[0]])
        for v in vertices:
            quadrics[v] += weight * np.outer(plane, plane)

    def _neighbours(self, v: int) -> set[int]:
        return {w for i in self.at[v] for w in self.faces[i]} - {v}

    def _entry(self, u: int, v: int) -> tuple[float, int, int, int, int]:
        x = np.append(self.points[v], 1.0)
        edge = self.points[v] - self.points[u]
        squared = edge @ edge
        cost = x @ (self.quadrics[u] + self.quadrics[v]) @ x + LENGTH_SHARE * squared * squared
        return cost, u, v, self.version[u], self.version[v]

    def _candidates(self, u: int) -> list[tuple[float, int, int, int, int]]:
        return [self._entry(u, v) for v in self._neighbours(u)]

    def _wedges(self, v: int) -> set[int]:
        return {self.uv_faces[i][self.faces[i].index(v)] for i in self.at[v]}

    def _collapsible(self, u: int, v: int) -> dict[int, int] | None:
        """Return {texture coordinate at u: its replacement at v}, or None where u must not move onto v."""
        shared = self.at[u] & self.at[v]
        if self.on_middle[u] and (not self.on_middle[v] or len(shared) != 1):
            return None
        opposite = {w for i in shared for w in self.faces[i]} - {u, v}
        near_u, near_v = self._neighbours(u), self._neighbours(v)
        if near_u & near_v != opposite or len(opposite) != len(shared):
            return None  # the collapse would pinch the surface
        if self.on_middle[v] and any(self.on_middle[w] for w in near_u - near_v - {v}) and not self.on_middle[u]:
            return None  # a new edge inside the middle plane would be shared with the mirror image
        uv_of: dict[int, int] = {}
        for i in shared:
            uv_u, uv_v = (self.uv_faces[i][self.faces[i].index(w)] for w in (u, v))
            if uv_of.setdefault(uv_u, uv_v) != uv_v:
                return None
        if set(uv_of) != self._wedges(u) or len(set(uv_of.values())) != len(uv_of):
            return None  # a seam may only shrink along itself
        return uv_of if self._shape_survives(u, v, shared) else None

    def _shape_survives(self, u: int, v: int, shared: set[int]) -> bool:
        for i in self.at[u] - shared:
            face = self.faces[i]
            moved = [v if w == u else w for w in face]
            if all(self.on_middle[w] for w in moved):
                return False
            before, after = self._normal(face), self._normal(moved)
            lengths = np.linalg.norm(before), np.linalg.norm(after)
            if lengths[1] == 0 or before @ after < FLAT_TURN * lengths[0] * lengths[1]:
                return False
            sides = self.points[moved] - self.points[np.roll(moved, 1)]
            if 2 * np.sqrt(3) * lengths[1] < THIN * (sides * sides).sum():
                return False
        return True

    def _collapse(self, u: int, v: int, uv_of: dict[int, int]) -> set[int]:
        touched = self._neighbours(u)
        for i in list(self.at[u]):
            face, uv_face = self.faces[i], self.uv_faces[i]
            if v in face:
                for w in face:
                    self.at[w].discard(i)
                del self.faces[i], self.uv_faces[i]
                continue
            k = face.index(u)
            face[k], uv_face[k] = v, uv_of[uv_face[k]]
            self.at[v].add(i)
        del self.at[u]
        self.quadrics[v] = self.quadrics[v] + self.quadrics.pop(u)
        return touched
