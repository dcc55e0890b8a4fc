"""A person's surface for viewers and graphics cards: one index per corner, weights in sets of four."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.mesh import vertex_normals
from hfb.body.model import Body
from hfb.typing import Array, Float, Shaped, Tensor

_SET = 4


@dataclass(frozen=True)
class Skin:
    """The person in the rest pose; vertices on seams of the texture come once per texture coordinate.

    Attributes:
        vertices: [m].
        normals: normals of length one.
        uv: v = 0 is the top row of the texture.
        points: the body's vertex of each.
        joints: sets of four per vertex, the heaviest first; as many sets as the model needs.
        weights: sets of four per vertex, the heaviest first; as many sets as the model needs.
        corners: corners of the faces, three each.
    """

    vertices: Float[Array, "P 3"]
    normals: Float[Array, "P 3"]
    uv: Float[Array, "P 2"]
    points: Shaped[Array, "P"]
    joints: tuple[Shaped[Array, "P 4"], ...]
    weights: tuple[Float[Array, "P 4"], ...]
    corners: Shaped[Array, "C"]


def skin_of(body: Body, betas: Float[Tensor, "K"]) -> Skin:
    """Return the skin of a body model with some shape; pose correctives are no part of a skin.

    Args:
        body: the body model.
        betas: shape coefficients.
    """
    pairs = torch.stack([body.mesh.faces, body.mesh.uv_faces], -1).reshape(-1, 2).numpy()
    points, index = np.unique(pairs, axis=0, return_inverse=True)
    vertices = body.shape(betas).vertices
    normals = vertex_normals(vertices[None], body.mesh)[0]
    sets = _influences(body)
    return Skin(
        vertices=_float32(vertices)[points[:, 0]],
        normals=_float32(normals)[points[:, 0]],
        uv=_float32(body.mesh.uv)[points[:, 1]],
        points=points[:, 0],
        joints=tuple(joints[points[:, 0]] for joints, _ in sets),
        weights=tuple(weights[points[:, 0]] for _, weights in sets),
        corners=index.reshape(-1).astype(np.uint16 if len(points) < 2**16 - 1 else np.uint32),
    )


def _influences(body: Body) -> list[tuple[Shaped[Array, "V 4"], Float[Array, "V 4"]]]:
    """Return (joints, weights) of every vertex in sets of four, the heaviest first; as many sets as the model needs."""
    weights, joints = body.skinning_weights.double().sort(dim=1, descending=True, stable=True)
    sets = -(-int((weights > 0).sum(1).max()) // _SET)
    shares = weights[:, : _SET * sets] / weights[:, : _SET * sets].sum(1, keepdim=True)
    used = torch.where(shares > 0, joints[:, : _SET * sets], torch.zeros_like(joints[:, : _SET * sets]))
    return [
        (used[:, at : at + _SET].numpy().astype(np.uint8), _float32(shares[:, at : at + _SET]))
        for at in range(0, _SET * sets, _SET)
    ]


def _float32(values: Float[Tensor, "*n"]) -> Float[Array, "*n"]:
    return values.detach().float().numpy()
