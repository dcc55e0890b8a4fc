"""The surface smoothness: by hand on two squares folded along an edge, and against eq. (5) written as loops."""

import math

import numpy as np
import pytest
import torch

from hfb.body.mesh import Mesh, make_mesh
from hfb.objective.texture import texel_neighbours, texture_smoothness


def _folded(angle: float) -> tuple[Mesh, torch.Tensor]:
    """Two faces that share the y axis as an edge, the second tilted by `angle`; a third one elsewhere."""
    vertices = [
        [0, 0, 0], [0, 1, 0], [-1, 0, 0], [math.cos(angle), 0, math.sin(angle)], [5, 0, 0], [6, 0, 0], [5, 1, 0],
    ]  # fmt: skip
    faces = np.array([[0, 1, 2], [1, 0, 3], [4, 5, 6]])
    mesh = make_mesh(faces, np.zeros((7, 2)), faces, torch.float64)
    return mesh, torch.tensor(vertices, dtype=torch.float64)


def _as_written(texture, faces, mesh, vertices, visible) -> float:
    """Eq. (5), loop by loop."""
    corners = vertices[mesh.faces].numpy()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    total, (height, width) = 0.0, faces.shape
    for row in range(height):
        for column in range(width):
            for down, right in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]:
                r, c = row + down, column + right
                if not (0 <= r < height and 0 <= c < width) or faces[row, column] < 0 or faces[r, c] < 0:
                    continue
                one, other = faces[row, column], faces[r, c]
                if not set(mesh.faces[one].tolist()) & set(mesh.faces[other].tolist()) or not visible[r, c]:
                    continue
                cosine = max(float(normals[one] @ normals[other]), 0)
                total += cosine * float((texture[row, column] - texture[r, c]).abs().sum())
    return total / (8 * height * width)


def test_by_hand_two_texels():
    mesh, vertices = _folded(math.pi / 3)
    faces = torch.tensor([[0, 1], [-1, -1]])
    texture = torch.zeros(2, 2, 3, dtype=torch.float64)
    texture[0, 1] = torch.tensor([0.1, 0.2, 0.3])
    texture[1] = 9.0  # the void's colour must not matter
    neighbours = texel_neighbours(mesh, vertices, faces)
    # cos of the fold is 1/2; the one pair is met from both its ends.
    assert texture_smoothness(texture, neighbours).item() == pytest.approx(2 * 0.5 * 0.6 / (8 * 4))
    only_one = torch.tensor([[True, False], [False, False]])
    assert texture_smoothness(texture, neighbours, only_one).item() == pytest.approx(0.5 * 0.6 / (8 * 4))


def test_faces_that_turn_away_or_do_not_touch_are_no_neighbours():
    texture = torch.rand(2, 2, 3, dtype=torch.float64)
    mesh, vertices = _folded(3.0)
    sharp = texel_neighbours(mesh, vertices, torch.tensor([[0, 1], [0, 1]]))
    flat = texel_neighbours(mesh, vertices, torch.tensor([[0, 0], [1, 1]]))
    assert sharp.weights[0].abs().max() == 0
    assert flat.weights[0, :, 0].min() == 1
    apart = texel_neighbours(mesh, vertices, torch.tensor([[0, 2], [2, 0]]))
    assert texture_smoothness(texture, apart).item() == pytest.approx(
        (2 * (texture[0, 0] - texture[1, 1]).abs().sum() + 2 * (texture[0, 1] - texture[1, 0]).abs().sum()).item() / 32
    )


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
def test_against_the_equation_written_as_loops(angle):
    generator = torch.Generator().manual_seed(5)
    mesh, vertices = _folded(angle)
    faces = torch.randint(-1, 3, (6, 6), generator=generator)
    texture = torch.rand(6, 6, 3, dtype=torch.float64, generator=generator)
    visible = torch.rand(6, 6, generator=generator) < 0.6
    value = texture_smoothness(texture, texel_neighbours(mesh, vertices, faces), visible).item()
    assert value == pytest.approx(_as_written(texture, faces.numpy(), mesh, vertices, visible))


def test_one_colour_costs_nothing_and_has_no_gradient():
    mesh, vertices = _folded(0.3)
    neighbours = texel_neighbours(mesh, vertices, torch.zeros(4, 4, dtype=torch.int64))
    texture = torch.full((4, 4, 3), 0.5, dtype=torch.float64, requires_grad=True)
    value = texture_smoothness(texture, neighbours)
    value.backward()
    assert value.item() == 0
    assert torch.equal(texture.grad, torch.zeros(4, 4, 3, dtype=torch.float64))


def test_gradients_match_finite_differences_and_leave_the_void_alone():
    generator = torch.Generator().manual_seed(6)
    mesh, vertices = _folded(0.4)
    faces = torch.randint(-1, 2, (4, 4), generator=generator)
    neighbours = texel_neighbours(mesh, vertices, faces)
    texture = torch.rand(4, 4, 3, dtype=torch.float64, generator=generator).requires_grad_()
    assert torch.autograd.gradcheck(lambda colours: texture_smoothness(colours, neighbours), (texture,))
    texture_smoothness(texture, neighbours).backward()
    assert texture.grad[faces < 0].abs().max() == 0
    assert texture.grad[faces >= 0].abs().max() > 0
