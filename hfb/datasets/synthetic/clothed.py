"""Clothing as a displacement of the skin: smooth, outward, none on hands, feet and face."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from scipy import sparse

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES
from hfb.typing import Array, Float, Tensor

_THINNEST_M, _THICKEST_M = 0.005, 0.04
_ROUNDS = 80
"""Rounds of averaging over neighbours: with triangles of 2 cm, the thickness varies over a decimetre or two."""

_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "left_hip", "right_hip", "left_shoulder", "right_shoulder")
_CLOSE = ("left_collar", "right_collar")
_SLEEVES, _LEGS = ("left_elbow", "right_elbow"), ("left_knee", "right_knee")


def draw_clothing(body: Body, rng: np.random.Generator) -> Float[Array, "V 3"]:
    """Draw a random outfit: 5 to 40 mm off the skin of torso, upper arms and thighs, less below.

    Sleeves and legs may be bare. Displacements are along the rest surface's normals, so never inward [m].

    Args:
        body: the undressed body.
        rng: draws the outfit.
    """
    loose = dict.fromkeys(_TRUNK, 1.0) | dict.fromkeys(_CLOSE, 0.8)
    for part in (_SLEEVES, _LEGS):
        loose |= dict.fromkeys(part, float(rng.choice([0.0, 0.6, 0.75])))
    worn = body.skinning_weights.double().numpy() @ np.array([loose.get(name, 0.0) for name in JOINT_NAMES])
    average = _average_of_neighbours(body)
    # A hem is a step in the weights: pull it in to where the limb is clothed on both sides, then let it fade.
    worn = np.clip((worn - 0.3) / 0.7, 0, 1)
    bare = _bare(body)
    thickness = rng.normal(size=len(worn))
    for _ in range(_ROUNDS):
        thickness = average @ thickness
    for _ in range(3):
        worn = np.where(bare, 0, average @ worn)
    spread = thickness[worn > 0.5]
    even = np.clip(0.5 + (thickness - spread.mean()) / (4 * spread.std()), 0, 1)
    metres = worn * (_THINNEST_M + (_THICKEST_M - _THINNEST_M) * even)
    return metres[:, None] * vertex_normals(body)


def dress(body: Body, clothing: Float[Array, "V 3"]) -> Body:
    """Return the body with its clothed surface as template; shape, skinning and joints stay the undressed body's.

    Args:
        body: the undressed body.
        clothing: displacement of each vertex in the rest pose [m].
    """
    return replace(body, template=body.template + torch.from_numpy(clothing).to(body.template.dtype))


def on_subdivided(body: Body, clothing: Float[Array, "V 3"]) -> Float[Array, "W 3"]:
    """Extend a body's displacement to its `hfb.body.subdivision.subdivide`; midpoints keep it outward.

    Args:
        body: the undressed body.
        clothing: displacement of each vertex in the rest pose [m].
    """
    ends = body.mesh.edge_vertices.numpy()
    return np.concatenate([clothing, (clothing[ends[:, 0]] + clothing[ends[:, 1]]) / 2])


def vertex_normals(body: Body) -> Float[Array, "V 3"]:
    """Return unit normals of the mean rest surface, pointing outward: means of the faces', weighted by area.

    Args:
        body: the undressed body.
    """
    vertices, faces = body.template.double().numpy(), body.mesh.faces.numpy()
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(total, corner, area)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def _bare(body: Body) -> Array:
    """Return the vertices that belong to hands, feet, neck or head more than to any clothed part."""
    clothed = {*_TRUNK, *_CLOSE, *_SLEEVES, *_LEGS}
    skin: Tensor = body.skinning_weights[:, [name not in clothed for name in JOINT_NAMES]]
    return (skin.sum(1) > 0.5).numpy()


@lru_cache(maxsize=2)
def _average_of_neighbours(body: Body) -> sparse.csr_array:
    """Return mean of each vertex and its neighbours along edges."""
    ends, count = body.mesh.edge_vertices.numpy(), len(body.template)
    rows, columns = np.concatenate([ends, ends[:, ::-1], np.arange(count)[:, None].repeat(2, 1)]).T
    links = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    return sparse.diags_array(1 / links.sum(1)) @ links
