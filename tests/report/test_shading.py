"""Clay bodies and the view from the side."""

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.mesh import vertex_normals
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.rendering.backends import make_rasterizer
from hfb.report.images.shading import shade_bodies, side_view, time_colours
from tests.scenes import standing_pose

RASTERIZER = make_rasterizer("coverage", "cpu", 1)


@pytest.fixture(scope="module")
def body():
    return load_default_body()


def _standing(body, *positions: tuple[float, float, float]) -> torch.Tensor:
    rotations = axis_angle_to_matrix(standing_pose().expand(len(positions), 24, 3))
    return body.shape(torch.zeros(10)).pose(rotations, torch.tensor(positions, dtype=torch.float32)).vertices


def test_normals_are_unit_vectors_that_point_out_of_the_body(body):
    vertices = _standing(body, (0, 0, 3))
    normals = vertex_normals(vertices, body.mesh)
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(vertices.shape[:2]))
    nearest, farthest = vertices[0, :, 2].argmin(), vertices[0, :, 2].argmax()
    assert normals[0, nearest, 2] < 0 < normals[0, farthest, 2]


def test_clay_covers_what_the_body_covers_and_is_lit_from_the_viewers_upper_left(body):
    camera = PinholeCamera.from_focal(150, 96, 96)
    vertices = _standing(body, (-0.2, 0.1, 3.4), (0.2, 0.1, 3.4))
    colours = time_colours(2)
    pictures = shade_bodies(vertices, colours, camera, body.mesh, RASTERIZER)
    alone = RASTERIZER.render(vertices, torch.ones(4, 4, 3), camera, body.mesh)
    torch.testing.assert_close(pictures[..., 3], alone[..., 3])
    assert (pictures >= 0).all()
    assert (pictures[..., :3] <= alone[..., 3:] * colours[:, None, None] + 1e-5).all()
    for picture, colour in zip(pictures, colours, strict=True):
        inside = picture[..., 3] == 1
        columns = torch.arange(96)[None].expand_as(inside)
        brightness = (picture[..., :3] / colour).mean(-1)
        left, right = (
            inside & (columns < columns[inside].float().mean()),
            inside & (columns > columns[inside].float().mean()),
        )
        assert brightness[left].mean() > brightness[right].mean() + 0.05
        assert 0.3 < brightness[inside].min() < 0.6 < brightness[inside].max() <= 1


def test_time_runs_from_blue_to_orange():
    colours = time_colours(5)
    assert colours[0, 2] > 0.9 > 0.5 > colours[0, 0]
    assert colours[-1, 0] > 0.9 > 0.5 > colours[-1, 2]
    assert ((colours >= 0) & (colours <= 1)).all()


def test_from_the_side_depth_is_width_and_everything_fits(body):
    vertices = _standing(body, (0.3, 0, 3.0), (0.3, 0, 4.0))  # the second stands a metre further away
    turned, camera = side_view(vertices, 80, 60)
    pixels = camera.project(turned)
    assert (pixels > 0).all()
    assert (pixels < torch.tensor([60.0, 80.0])).all()
    first, second = pixels.mean(1)
    assert second[0] < first[0] - 15
    assert second[1] == pytest.approx(first[1], abs=0.5)
    # The length of a body does not change: this is a rotation, seen through a long lens.
    torch.testing.assert_close(
        turned[0].amax(0)[1] - turned[0].amin(0)[1], vertices[0].amax(0)[1] - vertices[0].amin(0)[1]
    )
