"""The fast rasteriser against the readable one and against finite differences: whole vectors, not single numbers."""

import pytest
import torch

from hfb.body.mesh import Mesh
from hfb.geometry.camera import PinholeCamera
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from tests.rendering.bodies import at, ball, box, limb, people, person_mesh, smooth_texture, two_balls

CAMERA = PinholeCamera.from_focal(80.0, 64, 56)


def weights(channels: int, seed: int = 0) -> torch.Tensor:
    """A smooth random picture: the loss is its product with what is drawn."""
    coarse = torch.rand(1, channels, 8, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    fine = torch.nn.functional.interpolate(coarse, size=(CAMERA.height, CAMERA.width), mode="bicubic")
    return fine[0].permute(1, 2, 0)


def picture_and_gradients(
    rasterizer: Rasterizer, vertices: torch.Tensor, texture: torch.Tensor, mesh: Mesh
) -> list[torch.Tensor]:
    """The mean picture, and the gradients of a product with it by the vertices and by the texture."""
    vertices, texture = vertices.clone().requires_grad_(), texture.clone().requires_grad_()
    picture = rasterizer.render_mean(vertices, texture, CAMERA, mesh)
    (picture * weights(4)).sum().backward()
    assert vertices.grad is not None
    assert texture.grad is not None
    return [picture.detach(), vertices.grad, texture.grad]


def assert_same_direction_and_size(found: torch.Tensor, expected: torch.Tensor, relative: float) -> None:
    found, expected = found.double().flatten(), expected.double().flatten()
    assert expected.norm() > 0
    assert (found - expected).norm() <= relative * expected.norm()
    assert torch.cosine_similarity(found, expected, dim=0) >= 1 - relative**2 / 2 - 1e-9


SCENES = {
    "people": lambda: (people(2, seed=3), person_mesh()),
    "ball": lambda: (at(ball()[0], 0.1, 0.05, 1.9), ball()[1]),
    "ball cut by the picture's corner": lambda: (at(ball()[0], -0.7, -0.8, 1.9), ball()[1]),
    "two balls": lambda: (at(two_balls()[0], 0.0, 0.0, 2.0), two_balls()[1]),
}


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
def test_double_precision_agrees_with_the_reference(scene, silhouette) -> None:
    vertices, mesh = scene()
    fast = picture_and_gradients(make_rasterizer(silhouette, "cpu", 1), vertices, smooth_texture(), mesh)
    slow = picture_and_gradients(make_rasterizer(silhouette, "reference"), vertices, smooth_texture(), mesh)
    for found, expected in zip(fast, slow, strict=True):
        assert_same_direction_and_size(found, expected, 1e-9)


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_single_precision_is_double_precision_rounded(silhouette) -> None:
    """float32 vertices are one place in space in either precision; the kernels compute in float64."""
    vertices, texture = people(2, seed=5, dtype=torch.float32), smooth_texture(dtype=torch.float32)
    rasterizer = make_rasterizer(silhouette, "cpu", 1)
    single = picture_and_gradients(rasterizer, vertices, texture, person_mesh(torch.float32))
    double = picture_and_gradients(rasterizer, vertices.double(), texture.double(), person_mesh())
    assert [tensor.dtype for tensor in single] == [torch.float32] * 3
    for found, expected in zip(single, double, strict=True):
        assert_same_direction_and_size(found, expected, 2e-6)


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_the_silhouette_alone_has_the_same_gradient(silhouette) -> None:
    vertices = people(2, seed=1)
    rasterizer = make_rasterizer(silhouette, "cpu", 1)
    gradients = []
    for draw in (
        lambda body: rasterizer.render_mean(body, smooth_texture(), CAMERA, person_mesh())[..., 3],
        lambda body: rasterizer.silhouette_mean(body, CAMERA, person_mesh()),
        lambda body: rasterizer.render(body, None, CAMERA, person_mesh()).mean(0)[..., 3],
    ):
        body = vertices.clone().requires_grad_()
        (draw(body) * weights(1)[..., 0]).sum().backward()
        gradients.append(body.grad)
    assert_same_direction_and_size(gradients[1], gradients[0], 1e-12)
    assert_same_direction_and_size(gradients[2], gradients[0], 1e-12)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_any_scene_agrees_with_the_reference(silhouette: str, seed: int) -> None:
    """Turned solids anywhere, also around and behind the lens, in pictures of any size from one pixel on."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * torch.rand((), generator=generator).item()

    vertices, mesh = (ball(0.5, 1), box((0.3, 0.6, 0.2)), limb(), two_balls())[seed % 4]
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0]
    turned = vertices @ (turn * torch.det(turn).sign()).T
    bodies = torch.cat([at(turned, uniform(-0.5, 0.5), uniform(-0.5, 0.5), uniform(-0.3, 3.0)) for _ in range(3)])
    height, width, focal = int(uniform(1, 30)), int(uniform(1, 30)), 3 * 130 ** uniform(0, 1)
    camera = PinholeCamera(focal, 1.1 * focal, uniform(-5, width + 5), uniform(-5, height + 5), height, width)
    results = []
    for backend in ("cpu", "reference"):
        leaf = bodies.clone().requires_grad_()
        picture = make_rasterizer(silhouette, backend, 1).render_mean(leaf, smooth_texture(16), camera, mesh)
        (picture * torch.linspace(0, 1, picture.numel(), dtype=torch.float64).view_as(picture)).sum().backward()
        results.append((picture.detach(), leaf.grad))
    for found, expected in zip(*results, strict=True):
        assert (found - expected).norm() <= 1e-9 * expected.norm() + 1e-12


def slope(loss, vertices: torch.Tensor, direction: torch.Tensor, step: float) -> float:
    return ((loss(vertices + step * direction) - loss(vertices - step * direction)) / (2 * step)).item()


@pytest.mark.parametrize("channels", [slice(3, 4), slice(0, 3)], ids=["silhouette", "colour"])
@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_gradients_are_finite_differences(silhouette, channels) -> None:
    """Rigid and bending motions of a ball, in steps small enough to stay within one order of pieces and faces."""
    vertices, mesh = ball()
    body = at(vertices, 0.1037, 0.0521, 1.9)
    rasterizer, texture = make_rasterizer(silhouette, "cpu", 1), smooth_texture()

    def loss(moved: torch.Tensor) -> torch.Tensor:
        return (rasterizer.render_mean(moved, texture, CAMERA, mesh) * weights(4))[..., channels].sum()

    leaf = body.clone().requires_grad_()
    loss(leaf).backward()
    x, y, z = body.unbind(-1)
    generator = torch.Generator().manual_seed(0)
    for direction in (
        torch.stack([x * 0 + 1, y * 0, z * 0], -1),
        torch.stack([x * 0, y * 0 + 1, z * 0], -1),
        torch.stack([x * 0, y * 0, z * 0 + 1], -1),
        torch.stack([-y, x, z * 0], -1),
        torch.stack([torch.sin(5 * y), torch.cos(4 * x), torch.sin(3 * z)], -1),
        torch.randn(body.shape, generator=generator, dtype=torch.float64),
    ):
        expected = (leaf.grad * direction).sum().item()
        assert slope(loss, body, direction, 1e-7) == pytest.approx(
            expected, rel=2e-3, abs=1e-3 * leaf.grad.norm().item()
        )


def test_the_texture_gradient_is_exact() -> None:
    """The picture is linear in the texture: any step will do."""
    vertices, mesh = people(1), person_mesh()
    rasterizer, texture = make_rasterizer(), smooth_texture()
    _, _, gradient = picture_and_gradients(rasterizer, vertices, texture, mesh)
    direction = torch.rand(texture.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    change = rasterizer.render_mean(vertices, texture + direction, CAMERA, mesh) - rasterizer.render_mean(
        vertices, texture, CAMERA, mesh
    )
    assert (change * weights(4)).sum().item() == pytest.approx((gradient * direction).sum().item(), rel=1e-9)


def test_coverage_moves_as_supersampled_coverage_does() -> None:
    """The gradient predicts how the covered share, counted in 16 x 16 samples per pixel, changes with a small step."""
    fine = PinholeCamera.from_focal(80.0, 64, 56).resize(1024, 896)
    rasterizer, body = make_rasterizer(), people(1, seed=2)

    def counted(vertices: torch.Tensor) -> torch.Tensor:
        colour = rasterizer.render(vertices, torch.ones(4, 4, 3).double(), fine, person_mesh())[0, ..., 3]
        return (colour > 0.5).double().unflatten(0, (64, 16)).unflatten(2, (56, 16)).mean((1, 3))

    leaf = body.clone().requires_grad_()
    (rasterizer.silhouette_mean(leaf, CAMERA, person_mesh()) * weights(1)[..., 0]).sum().backward()
    step, found, expected = 0.01, [], []  # a quarter of a pixel: samples are counted, so it cannot be small
    x, y, z = body.unbind(-1)
    for direction in (
        torch.stack([x * 0 + 1, y * 0, z * 0], -1),
        torch.stack([x * 0, y * 0 + 1, z * 0], -1),
        torch.stack([x * 0, y * 0, z * 0 + 1], -1),
        torch.stack([-y, x, z * 0], -1),
        torch.stack([x, y, z * 0], -1),
        torch.stack([torch.sin(3 * y), torch.cos(4 * x), torch.sin(3 * x)], -1),
    ):
        change = counted(body + step * direction) - counted(body - step * direction)
        expected.append((change * weights(1)[..., 0]).sum() / (2 * step))
        found.append((leaf.grad * direction).sum())
    assert_same_direction_and_size(torch.stack(found), torch.stack(expected), 0.03)
