"""Clothing lies outside the skin, is smooth, and leaves hands, feet and face bare."""

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.body.subdivision import subdivide
from hfb.datasets.synthetic.clothed import draw_clothing, dress, on_subdivided, vertex_normals


def thickness_mm(seed: int) -> np.ndarray:
    body = load_default_body()
    clothing = draw_clothing(body, np.random.default_rng(seed))
    normals = vertex_normals(body)
    along = (clothing * normals).sum(1)
    np.testing.assert_allclose(clothing, along[:, None] * normals, atol=1e-9)  # nothing but along the normal
    return 1000 * along


def of_joints(*names: str) -> np.ndarray:
    owner = load_default_body().skinning_weights.argmax(1).numpy()
    return np.isin(np.array(JOINT_NAMES)[owner], names)


def test_outward_and_where_clothes_are() -> None:
    for seed in range(4):
        mm = thickness_mm(seed)
        assert mm.min() >= 0
        assert mm.max() <= 40
        trunk = mm[of_joints("spine1", "spine2", "left_hip", "right_hip")]
        assert np.quantile(trunk, 0.05) > 4
        assert trunk.std() > 3
        bare = of_joints(
            "left_wrist",
            "right_wrist",
            "left_hand",
            "right_hand",
            "left_ankle",
            "right_ankle",
            "left_foot",
            "right_foot",
            "head",
        )
        assert mm[bare].max() == 0


def test_smooth_over_the_surface() -> None:
    body, mm = load_default_body(), thickness_mm(0)
    ends = body.mesh.edge_vertices.numpy()
    length_mm = 1000 * (body.template[ends[:, 0]] - body.template[ends[:, 1]]).norm(dim=1).numpy()
    step = np.abs(mm[ends[:, 0]] - mm[ends[:, 1]])
    assert np.quantile(step / length_mm, 0.95) < 0.5
    assert step.max() < 12


def test_outfits_differ_and_repeat() -> None:
    assert np.array_equal(thickness_mm(0), thickness_mm(0))
    assert np.abs(thickness_mm(0) - thickness_mm(1)).max() > 5


def test_the_person_inside_stays() -> None:
    body = load_default_body()
    clothing = draw_clothing(body, np.random.default_rng(0))
    dense = subdivide(body)
    dressed = dress(dense, on_subdivided(body, clothing))
    betas = torch.linspace(-1, 1, 10)
    assert torch.equal(dressed.shape(betas).joints, body.shape(betas).joints)
    moved = (dressed.template - dense.template).double().numpy()
    np.testing.assert_allclose(moved[: len(clothing)], clothing, atol=1e-6)
    assert ((moved * vertex_normals(dense)).sum(1) > -1e-4).all()
    # A clothed person is larger.
    a, b, c = (dressed.template[dense.mesh.faces] - dense.template.mean(0)).unbind(1)
    d, e, f = (dense.template[dense.mesh.faces] - dense.template.mean(0)).unbind(1)
    assert (torch.linalg.cross(a, b) * c).sum() > 1.03 * (torch.linalg.cross(d, e) * f).sum()
