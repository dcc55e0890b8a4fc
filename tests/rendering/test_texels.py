import pytest
import torch

from hfb.geometry.camera import PinholeCamera
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.texels import fill_texture_gutter, sample_texture, texel_faces, visible_texels
from tests.rendering.bodies import at, ball, people, person_mesh, smooth_texture


def test_texel_centres_give_texels_back() -> None:
    texture = smooth_texture(8)
    rows, columns = torch.meshgrid(torch.arange(8), torch.arange(8), indexing="ij")
    uv = torch.stack([columns + 0.5, rows + 0.5], -1).reshape(-1, 2).double() / 8
    torch.testing.assert_close(sample_texture(texture, uv), texture.reshape(-1, 3))


def test_the_border_goes_on() -> None:
    texture = smooth_texture(8)
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.5, 1.5]]).double()
    torch.testing.assert_close(sample_texture(texture, corners), texture[[0, 0, 7, 7], [0, 7, 0, 7]])


@pytest.mark.parametrize("size", [1, 2])
def test_the_smallest_textures_work(size: int) -> None:
    vertices, mesh = ball(subdivisions=1)
    body, camera = at(vertices, 0.1, 0, 2.0), PinholeCamera.from_focal(40.0, 24, 20)
    texture = torch.rand(size, size, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    pictures = [
        make_rasterizer("coverage", name, 1).render_mean(body, texture, camera, mesh) for name in ("cpu", "reference")
    ]
    torch.testing.assert_close(*pictures)


def test_charts_own_their_texels() -> None:
    mesh = person_mesh()
    owner = texel_faces(mesh, 128)
    rows, columns = (owner >= 0).nonzero().unbind(1)
    centres = torch.stack([columns + 0.5, rows + 0.5], 1).double() / 128
    corners = mesh.uv[mesh.uv_faces[owner[rows, columns].long()]]
    assert (centres >= corners.amin(1) - 1e-9).all()
    assert (centres <= corners.amax(1) + 1e-9).all()
    assert 0.3 < (owner >= 0).double().mean() < 1


def test_only_the_visible_side_is_seen() -> None:
    """Front and back of a person together are nearly everything, apart they are halves with little in common."""
    camera, mesh, size = PinholeCamera.from_focal(300.0, 240, 240), person_mesh(), 64
    front = people(1, spread_rad=0.0)
    back = front * torch.tensor([-1.0, 1.0, -1.0]) + torch.tensor([0.0, 0.0, 6.4])
    charts = texel_faces(mesh, size) >= 0
    seen = [visible_texels(body, camera, mesh, size) for body in (front, back)]
    assert all(0.2 < (s & charts).sum() / charts.sum() < 0.75 for s in seen)
    assert (seen[0] & seen[1] & charts).sum() < 0.2 * charts.sum()
    assert torch.equal(visible_texels(torch.cat([front, back]), camera, mesh, size), seen[0] | seen[1])


def test_texels_with_a_gradient_are_seen() -> None:
    camera, mesh = PinholeCamera.from_focal(120.0, 96, 96), person_mesh()
    texture = smooth_texture(64).requires_grad_()
    make_rasterizer().render_mean(people(1), texture, camera, mesh).sum().backward()
    seen = visible_texels(people(1), camera, mesh, 64)
    pulled = (texture.grad.abs().sum(-1) > 0).sum()
    # Rim pixels take their colour from the outline, which lies on the border of what is seen.
    assert ((texture.grad.abs().sum(-1) > 0) & ~seen).sum() < 0.25 * pulled


def test_the_gutter_takes_the_nearest_colour() -> None:
    owner = torch.full((6, 6), -1, dtype=torch.int32)
    owner[1, 1], owner[4, 4] = 0, 1
    texture = torch.zeros(6, 6, 3)
    texture[1, 1], texture[4, 4] = torch.tensor([1.0, 0, 0]), torch.tensor([0, 1.0, 0])
    filled = fill_texture_gutter(texture, owner)
    assert torch.equal(filled[0, 0], texture[1, 1])
    assert torch.equal(filled[5, 3], texture[4, 4])
    assert (filled.sum(-1) == 1).all()


def test_a_full_or_empty_chart_changes_nothing() -> None:
    texture = smooth_texture(4)
    for owner in (torch.zeros(4, 4, dtype=torch.int32), torch.full((4, 4), -1, dtype=torch.int32)):
        assert torch.equal(fill_texture_gutter(texture, owner), texture)
