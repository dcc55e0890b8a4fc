"""What any rasteriser must do, whatever its silhouette and however it is computed."""

from math import pi

import numpy as np
import pytest
import torch

from hfb.geometry.camera import PinholeCamera
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from tests.rendering.bodies import at, ball, box, limb, people, person_mesh, smooth_texture, two_balls

CAMERA = PinholeCamera.from_focal(70.0, 40, 48)


@pytest.fixture(params=["coverage-cpu", "coverage-reference", "dibr-cpu", "dibr-reference"])
def rasterizer(request: pytest.FixtureRequest) -> Rasterizer:
    silhouette, backend = request.param.split("-")
    return make_rasterizer(silhouette, backend, 1)


@pytest.fixture(params=["cpu", "reference"])
def covering(request: pytest.FixtureRequest) -> Rasterizer:
    return make_rasterizer("coverage", request.param, 1)


def test_the_mean_is_the_mean_of_the_pictures(rasterizer: Rasterizer) -> None:
    vertices, mesh = ball()
    vertices = torch.cat([at(vertices, 0.1 * k, 0.05, 2.0) for k in range(3)])
    mean = rasterizer.render_mean(vertices, smooth_texture(), CAMERA, mesh)
    pictures = rasterizer.render(vertices, smooth_texture(), CAMERA, mesh)
    assert pictures.shape == (3, 40, 48, 4)
    torch.testing.assert_close(mean, pictures.mean(0))
    torch.testing.assert_close(mean[..., 3], rasterizer.silhouette_mean(vertices, CAMERA, mesh))
    torch.testing.assert_close(mean[..., 3], rasterizer.render_mean(vertices, None, CAMERA, mesh)[..., 3])


def test_silhouettes_are_shares(rasterizer: Rasterizer) -> None:
    alpha = rasterizer.render(people(2, dtype=torch.float32), None, CAMERA, person_mesh())[..., 3]
    assert alpha.min() >= 0
    assert alpha.max() <= 1
    assert (alpha == 1).sum() > 50


def test_one_colour_everywhere_means_no_dark_rim(rasterizer: Rasterizer) -> None:
    colour = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
    picture = rasterizer.render(people(1), colour.expand(16, 16, 3), CAMERA, person_mesh())[0]
    torch.testing.assert_close(picture[..., :3], picture[..., 3:] * colour, rtol=0, atol=1e-12)


@pytest.mark.parametrize("width_m", [1e-5, 1e-7, 1e-8])
def test_a_sliver_has_a_colour_of_the_texture(width_m: float) -> None:
    """A board on edge, around a column of centres, thinner than single precision tells its corners apart."""
    vertices, mesh = box((width_m, 0.6, 0.1), torch.float32)
    body = at(vertices, 0.5 / 70.0 * 2.0, 0.004, 2.0).requires_grad_()
    texture = (0.2 + 0.6 * smooth_texture(dtype=torch.float32)).clamp(0.2, 0.8).requires_grad_()
    picture = make_rasterizer("coverage", "cpu", 1).render_mean(body, texture, CAMERA, mesh)
    shown = picture[..., 3] > 0
    assert shown.sum() >= 15
    colours = picture[shown][:, :3] / picture[shown][:, 3:]
    assert 0.2 - 1e-4 <= colours.min() <= colours.max() <= 0.8 + 1e-4
    picture.sum().backward()
    assert body.grad is not None
    assert texture.grad is not None
    assert torch.isfinite(body.grad).all()
    assert torch.isfinite(texture.grad).all()


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_a_crop_of_the_view_is_a_crop_of_the_picture(silhouette: str) -> None:
    """Bodies cut by any border of the picture, and the picture moved by whole pixels."""
    rasterizer = make_rasterizer(silhouette, "cpu", 1)
    vertices, mesh, texture = people(1), person_mesh(), smooth_texture()
    wide = PinholeCamera.from_focal(100.0, 96, 96)
    whole = rasterizer.render(vertices, texture, wide, mesh)[0]
    for left, top in ((10, 20), (30, 44), (48, 5), (-12, -7), (36, 60)):
        # DIB-R measures in units of the picture: a window of the same size keeps them.
        window = rasterizer.render(vertices, texture, wide.crop(left, top, 96, 96), mesh)[0]
        rows, columns = slice(max(0, top), 96 + min(0, top)), slice(max(0, left), 96 + min(0, left))
        inside = window[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
        torch.testing.assert_close(inside, whole[rows, columns], rtol=0, atol=1e-9)


def test_gradients_of_a_crop_are_those_of_the_picture() -> None:
    rasterizer, vertices, mesh = make_rasterizer(), people(1), person_mesh()
    wide = PinholeCamera.from_focal(100.0, 96, 96)
    weights = torch.rand(30, 25, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    gradients = []
    for camera, rows, columns in (
        (wide, slice(20, 50), slice(40, 65)),
        (wide.crop(40, 20, 25, 30), slice(None), slice(None)),
    ):
        body = vertices.clone().requires_grad_()
        picture = rasterizer.render_mean(body, smooth_texture(), camera, mesh)
        (picture[rows, columns] * weights).sum().backward()
        gradients.append(body.grad)
    torch.testing.assert_close(*gradients, rtol=0, atol=1e-9)


def test_a_ball_covers_the_area_of_its_cone(covering: Rasterizer) -> None:
    """A ball at distance D under angle psi projects to an ellipse with semi-axes known in closed form."""
    radius, place, focal = 0.5, np.array([0.3, 0.2, 2.5]), 280.0
    vertices, mesh = ball(radius, subdivisions=4)
    camera = PinholeCamera.from_focal(focal, 240, 240)
    if covering.__class__.__name__ == "ReferenceRasterizer":
        camera, focal = camera.resize(60, 60), 70.0
    distance = np.linalg.norm(place)
    theta, psi = np.arcsin(radius / distance), np.arccos(place[2] / distance)
    along = focal * (np.tan(psi + theta) - np.tan(psi - theta)) / 2
    across = focal * np.sin(theta) / np.sqrt(np.cos(theta) ** 2 - np.sin(psi) ** 2)
    alpha = covering.silhouette_mean(at(vertices, *place), camera, mesh)
    assert alpha.sum().item() == pytest.approx(pi * along * across, rel=3e-3)  # the ball is a polyhedron


def test_a_board_covers_exactly_its_rectangle(covering: Rasterizer) -> None:
    """Face on, edges along the pixel grid at known fractions of a pixel."""
    vertices, mesh = box((0.5, 0.3, 0.2))
    body = at(vertices, 0.0137, -0.021, 2.0)
    scale = 70.0 / 1.9
    x = 24 + scale * (np.array([-0.25, 0.25]) + 0.0137)
    y = 20 + scale * (np.array([-0.15, 0.15]) - 0.021)
    share = [
        np.clip(np.minimum(np.arange(n) + 1, b) - np.maximum(np.arange(n), a), 0, 1) for n, (a, b) in ((48, x), (40, y))
    ]
    expected = torch.tensor(share[1][:, None] * share[0])
    torch.testing.assert_close(covering.silhouette_mean(body, CAMERA, mesh), expected, rtol=0, atol=1e-9)


def test_crossing_outlines_count_once(covering: Rasterizer) -> None:
    """Two balls one before the other cover the union of what each covers alone: measured by a fine picture."""
    vertices, mesh = two_balls()
    body = at(vertices, 0.0, 0.0, 2.0)
    fine = make_rasterizer("coverage", "cpu", 1).silhouette_mean(body, CAMERA.resize(40 * 32, 48 * 32), mesh)
    expected = fine.unflatten(0, (40, 32)).unflatten(2, (48, 32)).mean((1, 3))
    torch.testing.assert_close(covering.silhouette_mean(body, CAMERA, mesh), expected, rtol=0, atol=2e-4)


def test_dibr_draws_a_halo_and_coverage_does_not() -> None:
    """FACTS, 'The fit': DIB-R's alpha covers 1.42 times the true area of a body, thin limbs most."""
    vertices, mesh = limb()
    camera = PinholeCamera.from_focal(320.0, 256, 256)
    body = at(vertices, 0.0, 0.0, 3.2)
    fine = make_rasterizer("coverage", "cpu", 1).silhouette_mean(body, camera.resize(2048, 2048), mesh).sum() / 64
    area = {
        name: make_rasterizer(name, "cpu", 1).silhouette_mean(body, camera, mesh).sum() for name in ("coverage", "dibr")
    }
    assert (area["coverage"] / fine).item() == pytest.approx(1, abs=1e-3)
    assert area["dibr"] / fine > 1.5
    sharp = [make_rasterizer("dibr", one, 1, 10.0).silhouette_mean(body, camera, mesh) for one in ("cpu", "reference")]
    assert 1 < sharp[0].sum() / fine < 1.2
    torch.testing.assert_close(sharp[0], sharp[1], rtol=0, atol=1e-6)


PLACES = {
    "left of the picture": (-5.0, 0.0, 2.0),
    "right of it": (5.0, 0.0, 2.0),
    "above": (0.0, -5.0, 2.0),
    "below": (0.0, 5.0, 2.0),
    "behind the lens": (0.0, 0.0, -3.0),
    "far to the side, barely in front of the lens": (40.0, 0.0, 0.56),
}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES.keys())
def test_what_is_not_in_view_draws_nothing_and_pulls_nothing(
    rasterizer: Rasterizer, place: tuple[float, float, float]
) -> None:
    vertices, mesh = ball()
    body, texture = at(vertices, *place).requires_grad_(), smooth_texture().requires_grad_()
    picture = rasterizer.render_mean(body, texture, CAMERA, mesh)
    picture.sum().backward()
    for tensor in (picture, body.grad, texture.grad):
        assert tensor is not None
        assert (tensor == 0).all()


@pytest.mark.parametrize("depth", [0.4, 0.5, 0.56, 0.7])
def test_a_body_around_or_touching_the_lens_stays_finite(rasterizer: Rasterizer, depth: float) -> None:
    vertices, mesh = ball(0.5, 1)
    body = at(vertices, 0.1, 0.05, depth).requires_grad_()
    picture = rasterizer.render_mean(body, smooth_texture(), CAMERA, mesh)
    picture.sum().backward()
    assert body.grad is not None
    assert torch.isfinite(picture).all()
    assert torch.isfinite(body.grad).all()
    assert picture.min() >= 0
    assert picture.max() <= 1


def test_faces_without_area_are_harmless(rasterizer: Rasterizer) -> None:
    vertices, mesh = ball()
    vertices[mesh.faces[:30, 0]] = vertices[mesh.faces[:30, 1]]
    flat = vertices.clone()
    flat[:, 2] = 0
    for shape in (vertices, flat, vertices * 0):
        body = at(shape, 0.1, 0.05, 2.0).requires_grad_()
        picture = rasterizer.render_mean(body, smooth_texture(), CAMERA, mesh)
        picture.sum().backward()
        assert body.grad is not None
        assert torch.isfinite(picture).all()
        assert torch.isfinite(body.grad).all()


def test_the_outline_may_pass_through_pixel_corners_and_centres(covering: Rasterizer) -> None:
    """Sides at whole and half pixels: ties everywhere, no hole and no double count."""
    vertices, mesh = box((1.0, 1.0, 1.0))
    for half_px in (10.0, 10.5):
        camera = PinholeCamera(half_px * 3, half_px * 3, 24.0, 20.0, 40, 48)
        alpha = covering.silhouette_mean(at(vertices, 0.0, 0.0, 2.0), camera, mesh)
        assert alpha.sum().item() == pytest.approx((2 * half_px) ** 2, rel=1e-9)
        colour = covering.render(at(vertices, 0.0, 0.0, 2.0), torch.ones(4, 4, 3).double(), camera, mesh)[0]
        torch.testing.assert_close(colour[..., 0], colour[..., 3])
