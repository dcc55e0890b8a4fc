"""The texture smoothness, eq. (5), over texels that are neighbours on the body, not only in the UV map."""

from dataclasses import dataclass
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from hfb.body.mesh import Mesh
from hfb.typing import Bool, Float, Int, Tensor

# Of a texel's eight neighbours the four that follow it in reading order; the other four are these, seen from there.
_DIRECTIONS = ((0, 1), (1, -1), (1, 0), (1, 1))


@dataclass(frozen=True)
class TexelNeighbours:
    """Neighbours of every texel on the body, with the flatness of the body between them.

    Attributes:
        weights: c_kj cos(n_k, n_j) for the neighbours to the right, below left, below, and below right of each
            texel; zero where the neighbour lies outside the map.
    """

    weights: Float[Tensor, "4 A A"]


def texel_neighbours(mesh: Mesh, rest_vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "A A"]) -> TexelNeighbours:
    """Precompute c_kj max(cos angle(n_k, n_j), 0) of eq. (5).

    c_kj = 1 where the texels' faces are the same or adjacent, that is, share a corner: at the sizes in use a face
    covers about one texel, and the faces of diagonal neighbours often share no edge.

    Args:
        mesh: faces of the body.
        rest_vertices: the body at rest [m], whose face normals n are meant.
        faces: the face each texel belongs to, -1 in the void between the charts.
    """
    corners = rest_vertices[mesh.faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = torch.nn.functional.normalize(normals, dim=-1)
    weights = rest_vertices.new_zeros(len(_DIRECTIONS), *faces.shape)
    for weight, (down, right) in zip(weights, _DIRECTIONS, strict=True):
        here, there = _window(faces, down, right), _shifted(faces, down, right)
        first, second = mesh.faces[here.clamp_min(0)], mesh.faces[there.clamp_min(0)]
        touching = (first[..., :, None] == second[..., None, :]).any(-1).any(-1) & (here >= 0) & (there >= 0)
        cosine = (normals[here.clamp_min(0)] * normals[there.clamp_min(0)]).sum(-1).clamp_min(0)
        _window(weight, down, right).copy_(cosine * touching)
    return TexelNeighbours(weights)


def texture_smoothness(
    texture: Float[Tensor, "A A 3"], neighbours: TexelNeighbours, visible: Bool[Tensor, "A A"] | None = None
) -> Float[Tensor, ""]:
    """Return L_S = 1/(8|T|) sum_k sum_{j in N(k)} c_kj v_j cos(n_k, n_j) |p_k - p_j|_1, eq. (5).

    Args:
        texture: the colours p; |T| counts all its texels.
        neighbours: c and the cosines, from `texel_neighbours` at the texture's size.
        visible: v, the texels seen in some sub-frame; every texel when not given.
    """
    weights = neighbours.weights
    # Each pair stands for two terms of the sum: k looking at j counts if j is seen, j looking at k if k is.
    if visible is None:
        weights = 2 * weights
    else:
        seen = visible.to(weights)
        weights = weights * seen
        for weight, base, (down, right) in zip(weights, neighbours.weights, _DIRECTIONS, strict=True):
            _window(weight, down, right).addcmul_(_window(base, down, right), _shifted(seen, down, right))
    return _Variation.apply(texture, weights) / (8 * texture.shape[0] * texture.shape[1])


class _Variation(torch.autograd.Function):
    """Weighted total variation, sum_k sum_directions w |p_neighbour - p_k|_1.

    The gradient, signs times weights, is computed in the same pass, three times as fast as by autograd. Where two
    colours are equal it is zero.
    """

    @staticmethod
    def forward(ctx: Any, texture: Float[Tensor, "A A 3"], weights: Float[Tensor, "4 A A"]) -> Float[Tensor, ""]:
        total, gradient = texture.new_zeros(()), torch.zeros_like(texture)
        for weight, (down, right) in zip(weights, _DIRECTIONS, strict=True):
            difference = _shifted(texture, down, right) - _window(texture, down, right)
            slope = difference.sign().mul_(_window(weight, down, right)[..., None])
            total += torch.dot(slope.flatten(), difference.flatten())
            _shifted(gradient, down, right).add_(slope)
            _window(gradient, down, right).sub_(slope)
        ctx.save_for_backward(gradient)
        return total

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_total: Float[Tensor, ""]) -> tuple[Float[Tensor, "A A 3"], None]:
        return ctx.saved_tensors[0] * grad_total, None


def _window(picture: Tensor, down: int, right: int) -> Tensor:
    """Return the texels that have a neighbour at (down, right), as a view."""
    height, width = picture.shape[:2]
    return picture[: height - down, max(-right, 0) : width - max(right, 0)]


def _shifted(picture: Tensor, down: int, right: int) -> Tensor:
    """Return those neighbours, in the same order, as a view."""
    width = picture.shape[1]
    return picture[down:, max(right, 0) : width - max(-right, 0)]
