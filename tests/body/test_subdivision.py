"""The denser body is the same person: joints, outline and texture stay, the polyhedron does not."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_body, load_default_body
from hfb.body.model import Body
from hfb.body.subdivision import subdivide
from hfb.geometry.rotations import axis_angle_to_matrix
from tests.body.smpl_files import ellipsoid, save_npz, smpl_arrays


@pytest.fixture(scope="module", params=["default", "smpl"])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Body, Body]:
    if request.param == "default":
        body = load_default_body(torch.float64)
    else:
        body = load_body(save_npz(tmp_path_factory.mktemp("body") / "smpl.npz", smpl_arrays()), torch.float64)
    return body, subdivide(body)


def volume_and_area(body: Body) -> tuple[float, float]:
    a, b, c = body.template[body.mesh.faces].unbind(1)
    return (
        float((torch.linalg.cross(a, b) * c).sum() / 6),
        float(torch.linalg.cross(b - a, c - a).norm(dim=1).sum() / 2),
    )


def test_four_triangles_for_one_and_closed(pair: tuple[Body, Body]) -> None:
    body, dense = pair
    assert len(dense.mesh.faces) == 4 * len(body.mesh.faces)
    assert len(dense.template) == len(body.template) + len(body.mesh.edge_vertices)
    assert int(dense.mesh.edge_faces.min()) >= 0
    assert len(np.unique(dense.mesh.faces.numpy())) == len(dense.template)
    # Every edge is traversed once in each direction: closed and of one orientation.
    sides = torch.cat([dense.mesh.faces[:, [0, 1]], dense.mesh.faces[:, [1, 2]], dense.mesh.faces[:, [2, 0]]])
    directed = {tuple(side) for side in sides.tolist()}
    assert len(directed) == len(sides)
    assert {(b, a) for a, b in directed} == directed


def test_old_vertices_and_joints_stay_to_the_bit(pair: tuple[Body, Body]) -> None:
    body, dense = pair
    count = len(body.template)
    assert torch.equal(dense.template[:count], body.template)
    assert torch.equal(dense.joint_template, body.joint_template)
    assert torch.equal(dense.joint_shape_directions, body.joint_shape_directions)
    torch.testing.assert_close(dense.joint_regressor @ dense.template, body.joint_regressor @ body.template)
    generator = torch.Generator().manual_seed(0)
    betas = torch.randn(10, generator=generator, dtype=torch.float64)
    rotations = axis_angle_to_matrix(0.5 * torch.randn(3, 24, 3, generator=generator, dtype=torch.float64))
    translations = torch.randn(3, 3, generator=generator, dtype=torch.float64)
    coarse, fine = (one.shape(betas).pose(rotations, translations) for one in (body, dense))
    assert torch.equal(coarse.joints, fine.joints)
    torch.testing.assert_close(fine.vertices[:, :count], coarse.vertices)


def test_new_vertices_follow_their_edges_in_every_pose(pair: tuple[Body, Body]) -> None:
    """Shape and pose directions were extended by the rule of the template: a posed new vertex stays at its edge."""
    body, dense = pair
    generator = torch.Generator().manual_seed(1)
    betas = torch.randn(10, generator=generator, dtype=torch.float64)
    rotations = axis_angle_to_matrix(0.3 * torch.randn(2, 24, 3, generator=generator, dtype=torch.float64))
    posed = dense.shape(betas).pose(rotations, torch.zeros(2, 3, dtype=torch.float64)).vertices
    ends, count = body.mesh.edge_vertices, len(body.template)
    a, b, new = posed[:, ends[:, 0]], posed[:, ends[:, 1]], posed[:, count:]
    beyond = (new - (a + b) / 2).norm(dim=-1) / (a - b).norm(dim=-1).clamp_min(1e-3)
    assert float(beyond.median()) < 0.15
    assert float(beyond.quantile(0.99)) < 0.5


def test_nearly_the_same_solid_but_not_the_same_polyhedron() -> None:
    body = load_default_body(torch.float64)
    (volume, area), (denser_volume, denser_area) = volume_and_area(body), volume_and_area(subdivide(body))
    assert 1.001 < denser_volume / volume < 1.02  # chords become arcs: a little fuller
    assert 1 < denser_area / area < 1.01


def test_a_polyhedron_inscribed_in_an_ellipsoid_comes_nearer_to_it(tmp_path: Path) -> None:
    body = load_body(save_npz(tmp_path / "smpl.npz", smpl_arrays()), torch.float64)
    true_volume = 4 / 3 * np.pi * 0.4 * 0.9 * 0.2
    volume, denser_volume = volume_and_area(body)[0], volume_and_area(subdivide(body))[0]
    assert len(body.template) == len(ellipsoid()[0])
    assert abs(denser_volume - true_volume) < 0.6 * abs(volume - true_volume)


def test_weights_and_texture_coordinates_are_those_of_midpoints(pair: tuple[Body, Body]) -> None:
    body, dense = pair
    weights = dense.skinning_weights
    assert float(weights.min()) >= 0
    torch.testing.assert_close(weights.sum(1), torch.ones(len(weights), dtype=torch.float64))
    assert float(dense.mesh.uv.min()) >= 0
    assert float(dense.mesh.uv.max()) <= 1
    # Each new triangle covers a quarter of the old one's chart, turned the same way: no seam was crossed.
    old, new = (
        torch.linalg.det(torch.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], 1))
        for uv in (mesh.uv[mesh.uv_faces] for mesh in (body.mesh, dense.mesh))
    )
    torch.testing.assert_close(new.reshape(-1, 4), old[:, None].expand(-1, 4) / 4, atol=1e-12, rtol=1e-6)
    # Charts stay whole: as many new coordinates as there are different sides in the texture.
    sides = {
        frozenset(side) for face in body.mesh.uv_faces.tolist() for side in zip(face, face[1:] + face[:1], strict=True)
    }
    assert len(dense.mesh.uv) == len(body.mesh.uv) + len(sides)
