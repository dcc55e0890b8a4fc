"""Edges, closing of holes, and the texture atlas of bodies that bring none."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_body, load_default_body
from hfb.body.atlas import make_atlas
from hfb.body.closing import boundary_loops, fans
from hfb.body.mesh import edges_of
from tests.body.smpl_files import ellipsoid, save_npz, smpl_arrays
from tests.body.test_default_body import overlap


def directed_edges(faces: np.ndarray) -> list[tuple[int, int]]:
    return [(int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3)]


def test_every_edge_once_with_both_faces() -> None:
    faces = ellipsoid()[1]
    edge_vertices, edge_faces = edges_of(faces)
    undirected = {frozenset(edge) for edge in directed_edges(faces)}
    assert len(edge_vertices) == len(undirected)
    assert {frozenset(edge) for edge in edge_vertices.tolist()} == undirected
    for (a, b), (first, second) in zip(edge_vertices.tolist(), edge_faces.tolist(), strict=True):
        assert (a, b) in directed_edges(faces[first : first + 1])  # in the order of the first face
        assert (b, a) in directed_edges(faces[second : second + 1])


def test_boundaries_have_no_second_face() -> None:
    edge_vertices, edge_faces = edges_of(np.array([[0, 1, 2], [2, 1, 3]]))
    shared = {tuple(sorted(edge)) for edge, faces in zip(edge_vertices, edge_faces, strict=True) if faces[1] >= 0}
    assert shared == {(1, 2)}
    assert len(edge_vertices) == 5


def test_three_faces_at_one_edge_are_kept() -> None:
    edge_vertices, edge_faces = edges_of(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    at_shared = [faces.tolist() for edge, faces in zip(edge_vertices, edge_faces, strict=True) if set(edge) == {0, 1}]
    assert sorted(at_shared) == [[0, 1], [2, -1]]


@pytest.mark.parametrize("removed", [[0], [0, 1, 2, 3], [5, 40, 90], list(range(0, 60, 7))])
def test_holes_are_closed(removed: list[int]) -> None:
    faces = ellipsoid()[1]
    open_faces = np.delete(faces, removed, axis=0)
    filling = fans(boundary_loops(open_faces))
    closed = directed_edges(np.concatenate([open_faces, filling]))
    assert len(set(closed)) == len(closed)
    assert {(b, a) for a, b in closed} == set(closed)


def test_holes_that_touch_in_a_vertex_are_closed_apart() -> None:
    vertices, faces = ellipsoid()
    around_top = np.flatnonzero((faces == len(vertices) - 2).any(1))
    open_faces = np.delete(faces, around_top[[0, 6]], axis=0)
    loops = boundary_loops(open_faces)
    assert sorted(len(loop) for loop in loops) == [3, 3]


def test_a_closed_mesh_has_no_holes() -> None:
    assert boundary_loops(ellipsoid()[1]) == []
    assert fans([]).shape == (0, 3)


@pytest.mark.parametrize("textured", [False, True])
def test_open_files_load_closed(tmp_path: Path, textured: bool) -> None:
    arrays = smpl_arrays()
    arrays["f"] = arrays["f"][7:]
    if textured:
        arrays.update(vt=np.full((110, 2), 0.5), ft=arrays["f"])
    body = load_body(save_npz(tmp_path / "m.npz", arrays))
    mesh = body.mesh
    assert body.source.endswith(f"closed with {len(mesh.faces) - len(arrays['f'])} faces")
    assert len(mesh.faces) == len(mesh.uv_faces) > len(arrays["f"])
    assert (mesh.edge_faces >= 0).all()
    assert mesh.uv_faces.min() >= 0


def test_atlas_of_a_body() -> None:
    body = load_default_body(torch.float64)
    vertices, faces = body.template.numpy(), body.mesh.faces.numpy()
    uv, uv_faces = make_atlas(vertices, faces, body.skinning_weights.numpy())
    assert uv.min() >= 0
    assert uv.max() <= 1
    # Corners of one texture coordinate are corners of one vertex.
    vertex_of = np.full(len(uv), -1)
    vertex_of[uv_faces.reshape(-1)] = faces.reshape(-1)
    np.testing.assert_array_equal(vertex_of[uv_faces], faces)
    assert overlap(uv, uv_faces) < 0.03
    a, b, c = (uv[uv_faces[:, k]] for k in range(3))
    flat = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert flat.sum() > 0.3  # of the texture is used
    density = flat / solid
    median = np.median(density)
    assert solid[density < median / 4].sum() < 0.03 * solid.sum()  # hardly any skin is starved of texels
    again, _ = make_atlas(vertices, faces, body.skinning_weights.numpy())
    np.testing.assert_array_equal(again, uv)
