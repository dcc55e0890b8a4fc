"""Does the embedded body look like a human? Bones, symmetry, a closed skin, joints that bend the right way."""

import numpy as np
import pytest
import torch

from hfb.body.assets import load_body, load_default_body
from hfb.body.model import Body, PosedBody
from hfb.body.skeleton import BONES, JOINT_NAMES, MIRROR
from hfb.geometry.rotations import axis_angle_to_matrix


@pytest.fixture(scope="module")
def body() -> Body:
    return load_default_body(torch.float64)


def pose(body: Body, **axis_angles: tuple[float, float, float]) -> PosedBody:
    """One instant with these joints turned [degrees], as SMPL names and turns them."""
    rotations = torch.zeros(1, 24, 3, dtype=torch.float64)
    for name, degrees in axis_angles.items():
        rotations[0, JOINT_NAMES.index(name)] = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    shaped = body.shape(torch.zeros(10, dtype=torch.float64))
    return shaped.pose(axis_angle_to_matrix(rotations), torch.zeros(1, 3, dtype=torch.float64))


def joint(posed: PosedBody, name: str) -> torch.Tensor:
    return posed.joints[0, JOINT_NAMES.index(name)]


def volume(vertices: torch.Tensor, faces: torch.Tensor) -> float:
    a, b, c = vertices[faces].unbind(1)
    return float((torch.linalg.cross(a, b) * c).sum() / 6)


def test_none_means_the_embedded_body() -> None:
    body = load_body(None)
    assert (body.betas_space, body.template.dtype, body.shape_count) == ("hfb", torch.float32, 10)
    assert body.pose_directions is None
    assert 5000 <= len(body.template) <= 8000


def test_skin_is_closed_and_turned_outward(body: Body) -> None:
    faces = body.mesh.faces
    directed = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = {tuple(edge) for edge in directed.tolist()}
    assert len(forward) == len(directed)
    assert forward == {(b, a) for a, b in forward}
    assert (body.mesh.edge_faces >= 0).all()
    assert len(body.mesh.edge_vertices) * 2 == len(faces) * 3
    assert len(body.template) - len(body.mesh.edge_vertices) + len(faces) == 2  # one sphere-like piece
    assert 0.055 < volume(body.template, faces) < 0.085  # m3, about a litre per kilogram
    areas = torch.linalg.cross(
        body.template[faces[:, 1]] - body.template[faces[:, 0]], body.template[faces[:, 2]] - body.template[faces[:, 0]]
    ).norm(dim=1)
    assert areas.min() > 1e-9


def test_skinning_weights_are_shares_of_few_joints(body: Body) -> None:
    weights = body.skinning_weights
    assert (weights >= 0).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(len(weights), dtype=torch.float64))
    assert (weights > 0).sum(1).max() <= 8
    assert (weights.sum(0) > 10).all()


def test_left_mirrors_right(body: Body) -> None:
    flip = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(body.joint_template[list(MIRROR)] * flip, body.joint_template, atol=1e-5, rtol=0)
    distance = torch.cdist(body.template * flip, body.template)
    nearest, twin = distance.min(1)
    assert nearest.max() < 1e-5
    torch.testing.assert_close(body.skinning_weights[twin][:, list(MIRROR)], body.skinning_weights, atol=1e-6, rtol=0)
    torch.testing.assert_close(body.shape_directions[twin] * flip[:, None], body.shape_directions, atol=5e-5, rtol=0)


def test_rest_pose_is_smpls_t_pose(body: Body) -> None:
    rest = pose(body)
    assert joint(rest, "pelvis").norm() < 0.01
    height = body.template[:, 1].max() - body.template[:, 1].min()
    assert 1.65 < height < 1.75
    for side, sign in (("left", 1), ("right", -1)):
        arm = joint(rest, f"{side}_wrist") - joint(rest, f"{side}_shoulder")
        assert sign * arm[0] / arm.norm() > 0.999
        leg = joint(rest, f"{side}_ankle") - joint(rest, f"{side}_hip")
        assert -leg[1] / leg.norm() > 0.995
        foot = joint(rest, f"{side}_foot") - joint(rest, f"{side}_ankle")
        assert foot[2] > 0.08
    head = body.template[body.template[:, 1] > joint(rest, "head")[1]]
    nose = head[head[:, 2].argmax()]
    assert nose[2] - joint(rest, "head")[2] > 0.06  # faces +z
    assert abs(nose[0]) < 0.01


def test_bones_have_human_lengths(body: Body) -> None:
    lengths = {
        JOINT_NAMES[child]: float((body.joint_template[child] - body.joint_template[parent]).norm())
        for parent, child in BONES
    }
    for side in ("left", "right"):
        assert 0.38 < lengths[f"{side}_knee"] < 0.48  # thigh
        assert 0.38 < lengths[f"{side}_ankle"] < 0.48  # shank
        assert 0.23 < lengths[f"{side}_elbow"] < 0.33  # upper arm
        assert 0.20 < lengths[f"{side}_wrist"] < 0.29  # forearm
        assert 0.07 < lengths[f"{side}_hand"] < 0.13
    shoulders = body.joint_template[JOINT_NAMES.index("left_shoulder"), 0] * 2
    assert 0.30 < shoulders < 0.42
    spine = sum(lengths[name] for name in ("spine1", "spine2", "spine3", "neck"))
    assert 0.45 < spine < 0.65


def test_joints_bend_the_way_smpls_do(body: Body) -> None:
    rest = pose(body)
    knee = pose(body, left_knee=(90, 0, 0))
    assert joint(knee, "left_ankle")[2] < joint(rest, "left_ankle")[2] - 0.3  # the foot goes back
    torch.testing.assert_close(joint(knee, "right_ankle"), joint(rest, "right_ankle"))
    hip = pose(body, right_hip=(-90, 0, 0))
    assert joint(hip, "right_knee")[2] > 0.3  # the thigh comes forward
    elbow = pose(body, left_elbow=(0, -90, 0), right_elbow=(0, 90, 0))
    for side in ("left", "right"):
        assert joint(elbow, f"{side}_wrist")[2] > joint(rest, f"{side}_wrist")[2] + 0.2  # hands come forward
    arms = pose(body, left_shoulder=(0, 0, -75), right_shoulder=(0, 0, 75))
    for side in ("left", "right"):
        assert joint(arms, f"{side}_wrist")[1] < joint(rest, f"{side}_wrist")[1] - 0.4  # arms hang down
    bow = pose(body, spine1=(40, 0, 0))
    assert joint(bow, "head")[2] > joint(rest, "head")[2] + 0.2  # bends forward


@pytest.mark.parametrize(
    "angles",
    [
        {"left_elbow": (0, -90, 0), "right_knee": (90, 0, 0)},
        {"left_hip": (-90, 0, 0), "right_hip": (-90, 0, 0), "left_knee": (90, 0, 0), "right_knee": (90, 0, 0)},
        {"left_shoulder": (0, 0, -75), "right_shoulder": (0, 0, 70)},
        {"spine1": (0, 20, 0), "spine2": (0, 20, 0), "left_wrist": (60, 0, 0), "head": (0, 40, 0)},
    ],
)
def test_bent_skin_does_not_tear(body: Body, angles: dict[str, tuple[float, float, float]]) -> None:
    """Edges stretch, but no shard stands out and the volume stays."""
    edges = body.mesh.edge_vertices
    posed = pose(body, **angles).vertices[0]
    before, after = ((v[edges[:, 0]] - v[edges[:, 1]]).norm(dim=1) for v in (body.template, posed))
    assert (after - before).max() < 0.06
    assert torch.quantile(after / before, 0.99) < 1.8
    change = volume(posed, body.mesh.faces) / volume(body.template, body.mesh.faces)
    assert 0.93 < change < 1.08


def test_betas_have_unit_variance_and_fall_in_size(body: Body) -> None:
    size = body.shape_directions.flatten(0, 1).norm(dim=0)
    assert (size[:-1] >= size[1:]).all()
    heights = []
    for beta in (-2.0, 0.0, 2.0):
        betas = torch.zeros(10, dtype=torch.float64)
        betas[0] = beta
        person = body.shape(betas)
        heights.append(float(person.vertices[:, 1].max() - person.vertices[:, 1].min()))
        assert person.joints[0].norm() < 0.01  # the pelvis stays at the origin, whoever it is
        assert volume(person.vertices, body.mesh.faces) > 0.03
    assert 1.40 < heights[0] < heights[1] < heights[2] < 2.05


def test_texture_charts_do_not_overlap(body: Body) -> None:
    """No two places of the skin share a texel of a fine texture, but along the borders of triangles."""
    assert body.mesh.uv.min() >= 0
    assert body.mesh.uv.max() <= 1
    assert overlap(body.mesh.uv.numpy(), body.mesh.uv_faces.numpy()) < 0.01


def overlap(uv: np.ndarray, uv_faces: np.ndarray, size: int = 512) -> float:
    """Share of the covered texel centres that lie inside more than one triangle."""
    count = np.zeros((size, size), dtype=int)
    for triangle in uv[uv_faces] * size:
        low, high = np.floor(triangle.min(0)).astype(int), np.ceil(triangle.max(0)).astype(int)
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        (ax, ay), (bx, by), (cx, cy) = triangle
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        one = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
        two = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
        inside = (one > 1e-6) & (two > 1e-6) & (one + two < 1 - 1e-6)
        count[low[1] : high[1], low[0] : high[0]] += inside
    return float((count > 1).sum() / max((count > 0).sum(), 1))
