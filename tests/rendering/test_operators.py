"""The torch operators, as torch itself checks them: schema, fake shapes, autograd under tracing."""

import pytest
import torch

from hfb.geometry.camera import PinholeCamera
from hfb.kernels.objective.image_losses import Target
from hfb.kernels.rendering import render_operators as operators
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.cpu import CpuRasterizer
from tests.rendering.bodies import at, ball, smooth_texture

CHECKS = ("test_schema", "test_autograd_registration", "test_faketensor")
CAMERA = PinholeCamera.from_focal(40.0, 24, 20)


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
@pytest.mark.parametrize("textured", [True, False])
def test_operators_are_well_formed(silhouette: str, textured: bool) -> None:
    vertices, mesh = ball(subdivisions=1)
    body = torch.cat([at(vertices, 0.1, 0, 2.0), at(vertices, 0.2, 0, 2.0)]).requires_grad_()
    texture = smooth_texture(8).requires_grad_() if textured else None
    arguments = CpuRasterizer(silhouette, 1).arguments(body, texture, CAMERA, mesh, True)
    torch.library.opcheck(operators.draw, arguments, test_utils=CHECKS)


def test_a_texture_that_is_not_fitted_costs_no_gradient() -> None:
    vertices, mesh = ball(subdivisions=1)
    body, texture = at(vertices, 0.1, 0, 2.0), smooth_texture(8)
    picture = make_rasterizer().render_mean(body.requires_grad_(), texture, CAMERA, mesh)
    picture.sum().backward()
    assert body.grad is not None
    assert texture.grad is None
    still = texture.clone().requires_grad_()
    make_rasterizer().render_mean(body.detach(), still, CAMERA, mesh).sum().backward()
    assert still.grad is not None


def test_views_and_other_layouts_are_welcome() -> None:
    vertices, mesh = ball(subdivisions=1)
    body, texture = at(vertices, 0.1, 0, 2.0), smooth_texture(8)
    expected = make_rasterizer().render_mean(body, texture, CAMERA, mesh)
    strided = torch.stack([body, body], -1)[..., 0]
    turned = texture.permute(2, 0, 1).contiguous().permute(1, 2, 0)
    assert not strided.is_contiguous()
    assert torch.equal(make_rasterizer().render_mean(strided, turned, CAMERA, mesh), expected)


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
@pytest.mark.parametrize("threads", [1, 3])
def test_the_short_cut_is_the_operator(silhouette: str, threads: int) -> None:
    """Values and gradients, bit for bit."""
    vertices, mesh = ball(subdivisions=1)
    results = []
    for traced in (False, True):
        body = torch.cat([at(vertices, 0.02 * s, 0, 2.0) for s in range(5)]).requires_grad_()
        texture, rasterizer = smooth_texture(8).requires_grad_(), CpuRasterizer(silhouette, threads)
        if traced:
            drawn = operators.draw(*rasterizer.arguments(body, texture, CAMERA, mesh, True))[0].squeeze(0)
        else:
            drawn = rasterizer.render_mean(body, texture, CAMERA, mesh)
        drawn.square().sum().backward()
        results.append((drawn.detach(), body.grad, texture.grad))
    for found, expected in zip(*results, strict=True):
        assert torch.equal(found, expected)


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
@pytest.mark.parametrize("threads", [1, 3])
def test_a_judge_at_hand_says_what_it_says_of_the_picture(silhouette: str, threads: int) -> None:
    """Of bodies in the picture, at its border and outside."""
    vertices, mesh = ball(subdivisions=1)
    generator = torch.Generator().manual_seed(0)
    plate, frame, matte = (torch.rand(24, 20, n, generator=generator, dtype=torch.float64) for n in (3, 3, 1))
    judge, rasterizer = Target(plate, frame, matte[..., 0], 2, 3), CpuRasterizer(silhouette, threads)
    for x_m in (0.0, 0.8, 9.0):
        results = []
        for at_hand in (True, False):
            body = torch.cat([at(vertices, x_m + 0.02 * s, 0, 2.0) for s in range(5)]).requires_grad_()
            texture = smooth_texture(8).requires_grad_()
            if at_hand:
                losses = rasterizer.image_losses(body, texture, CAMERA, mesh, judge)
            else:
                losses = judge.losses(rasterizer.render_mean(body, texture, CAMERA, mesh))
            (2 * losses[0] + 3 * losses[1]).backward()
            results.append((torch.stack(losses).detach(), body.grad, texture.grad))
        assert bool(results[0][1].any()) == (x_m < 9)
        for found, expected in zip(*results, strict=True):
            torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-15)


def test_a_rasterizer_keeps_nothing_of_another_camera_or_mesh() -> None:
    """What it keeps from call to call is of the last one alone."""
    kept, texture = make_rasterizer(), smooth_texture(8)
    shapes = [ball(subdivisions=1), ball(subdivisions=2)]
    cameras = [CAMERA, PinholeCamera.from_focal(30.0, 24, 20), PinholeCamera.from_focal(40.0, 20, 24)]
    for vertices, mesh in (*shapes, shapes[0]):
        body = torch.cat([at(vertices, 0.02 * s, 0, 2.0) for s in range(3)])
        for camera in (*cameras, CAMERA):
            for draw in ("render", "render_mean"):
                found, expected = (getattr(one, draw)(body, texture, camera, mesh) for one in (kept, make_rasterizer()))
                assert torch.equal(found, expected)
