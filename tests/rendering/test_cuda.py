"""The Warp kernels against the readable reference: on Warp's CPU device, and on a GPU where there is one."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hfb.body.mesh import Mesh
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from tests.rendering.bodies import at, ball, box, limb, people, person_mesh, smooth_texture, two_balls

pytest.importorskip("warp", reason="the Warp kernels need warp-lang (pip install '.[cuda]')")
from hfb.kernels.warp import operators as cuda_operators
from hfb.rendering.warp import WarpRasterizer

DEVICES = ["warp", *(["cuda"] if torch.cuda.is_available() else [])]
CAMERA = PinholeCamera.from_focal(80.0, 64, 56)
SCENES = {
    "people": lambda: (people(2, seed=3), person_mesh()),
    "a ball cut by the picture's corner": lambda: (at(ball()[0], -0.7, -0.8, 1.9), ball()[1]),
    "two balls": lambda: (at(two_balls()[0], 0.0, 0.0, 2.0), two_balls()[1]),
    "nothing in the picture": lambda: (at(ball()[0], 9.0, 0.0, 2.0), ball()[1]),
    "behind the lens": lambda: (at(ball()[0], 0.0, 0.0, 0.2), ball()[1]),
}


def drawn(
    draw: Callable[[torch.Tensor, torch.Tensor], torch.Tensor], vertices: torch.Tensor, texture: torch.Tensor
) -> list[torch.Tensor]:
    """A picture, and the gradients of a product with it by vertices and texture."""
    vertices, texture = vertices.clone().requires_grad_(), texture.clone().requires_grad_()
    picture = draw(vertices, texture)
    (picture * torch.linspace(-1, 1, picture.numel(), dtype=torch.float64).view_as(picture)).sum().backward()
    assert vertices.grad is not None
    return [picture.detach(), vertices.grad, torch.zeros_like(texture) if texture.grad is None else texture.grad]


def mean_of(rasterizer: Rasterizer, mesh: Mesh, camera: PinholeCamera = CAMERA) -> Callable:
    return lambda vertices, texture: rasterizer.render_mean(vertices, texture, camera, mesh)


def assert_close(found: list[torch.Tensor], expected: list[torch.Tensor], relative: float) -> None:
    """As whole vectors: relative L2, and the cosine of the angle between them."""
    for one, other in zip(found, expected, strict=True):
        one, other = one.double().flatten(), other.double().flatten()
        assert (one - other).norm() <= relative * other.norm() + 1e-12
        assert other.norm() == 0 or torch.cosine_similarity(one, other, dim=0) >= 1 - relative**2 - 1e-9


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
def test_values_and_gradients_are_the_references(scene, device) -> None:
    vertices, mesh = scene()
    fast = drawn(mean_of(make_rasterizer(backend=device), mesh), vertices, smooth_texture())
    slow = drawn(mean_of(make_rasterizer(backend="reference"), mesh), vertices, smooth_texture())
    assert_close(fast, slow, 1e-9)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("device", DEVICES)
def test_any_scene_agrees_with_the_reference(device: str, seed: int) -> None:
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
    fast, slow = (
        drawn(mean_of(make_rasterizer(backend=backend), mesh, camera), bodies, smooth_texture(16))
        for backend in (device, "reference")
    )
    assert_close(fast, slow, 1e-9)


@pytest.mark.parametrize("device", DEVICES)
def test_single_precision_is_rounded_double_precision(device: str) -> None:
    vertices, texture = people(2, seed=5, dtype=torch.float32), smooth_texture(dtype=torch.float32)
    draw = mean_of(make_rasterizer(backend=device), person_mesh(torch.float32))
    single, double = drawn(draw, vertices, texture), drawn(draw, vertices.double(), texture.double())
    assert [tensor.dtype for tensor in single] == [torch.float32] * 3
    assert_close(single, double, 2e-6)


@pytest.mark.parametrize("device", DEVICES)
def test_silhouettes_are_those_of_the_compiled_kernels(device: str) -> None:
    vertices, mesh = people(3, seed=1), person_mesh()
    results = []
    for backend in (device, "cpu"):
        rasterizer = make_rasterizer(backend=backend)
        for draw in (
            lambda body, _, r=rasterizer: r.silhouette_mean(body, CAMERA, mesh),
            lambda body, _, r=rasterizer: r.render(body, None, CAMERA, mesh),
        ):
            results.append(drawn(draw, vertices, smooth_texture(8)))
    assert_close(results[0], results[2], 1e-9)
    assert_close(results[1], results[3], 1e-9)


@pytest.mark.parametrize("device", DEVICES)
def test_pictures_at_once_are_the_pictures_one_by_one(device: str) -> None:
    """Two people of two frames each, every frame with a camera of its own."""
    vertices, mesh = people(8, seed=2).unflatten(0, (4, 2)), person_mesh()
    rasterizer = WarpRasterizer("cuda" if device == "cuda" else "cpu")
    cameras = [replace(CAMERA, fx=70.0 + 5 * number, cy=CAMERA.cy - number) for number in range(4)]
    textures = torch.stack([smooth_texture(), smooth_texture().flip(0)])

    def together(bodies: torch.Tensor, textures: torch.Tensor) -> torch.Tensor:
        return rasterizer.render_pictures(bodies, textures, cameras, mesh)

    def apart(bodies: torch.Tensor, textures: torch.Tensor) -> torch.Tensor:
        frames = zip(bodies, textures.repeat_interleave(2, 0), cameras, strict=True)
        return torch.stack([rasterizer.render_mean(*frame, mesh) for frame in frames])

    pictures, alone = drawn(together, vertices, textures), drawn(apart, vertices, textures)
    assert torch.equal(pictures[0], alone[0])
    assert torch.equal(pictures[1], alone[1])
    assert_close(pictures, alone, 1e-12)


def test_what_does_not_share_out_evenly_is_said() -> None:
    vertices, mesh = people(3, seed=2), person_mesh()
    with pytest.raises(ValueError, match=r"3 bodies, 2 textures, 3 pictures"):
        WarpRasterizer("cpu").render_pictures(
            vertices[:, None], torch.zeros(2, 8, 8, 3, dtype=torch.float64), [CAMERA] * 3, mesh
        )


@pytest.mark.parametrize("device", DEVICES)
def test_every_run_has_the_same_bits(device: str) -> None:
    """Also of several threads at once."""
    vertices, mesh = people(4, seed=4), person_mesh()

    def once(_: int) -> list[torch.Tensor]:
        return drawn(mean_of(make_rasterizer(backend=device), mesh), vertices, smooth_texture())

    first = once(0)
    with ThreadPoolExecutor(3) as pool:
        for again in pool.map(once, range(6)):
            assert all(torch.equal(one, other) for one, other in zip(first, again, strict=True))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("textured", [True, False])
def test_operators_are_well_formed(textured: bool, device: str) -> None:
    vertices, mesh = ball(subdivisions=1)
    body = torch.cat([at(vertices, 0.1, 0, 2.0), at(vertices, 0.2, 0, 2.0)]).requires_grad_()
    textures = smooth_texture(8)[None].requires_grad_() if textured else None
    rasterizer = WarpRasterizer("cuda" if device == "cuda" else "cpu")
    arguments = rasterizer.arguments(body, textures, [PinholeCamera.from_focal(40.0, 24, 20)], mesh)
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(cuda_operators.draw_by_warp, arguments, test_utils=checks)


def test_what_is_not_asked_for_costs_no_gradient() -> None:
    vertices, mesh = ball(subdivisions=1)
    body, texture = at(vertices, 0.1, 0, 2.0), smooth_texture(8)
    rasterizer = make_rasterizer(backend="warp")
    rasterizer.render_mean(body.requires_grad_(), texture, CAMERA, mesh).sum().backward()
    assert body.grad is not None
    assert texture.grad is None
    still = texture.clone().requires_grad_()
    rasterizer.render_mean(body.detach(), still, CAMERA, mesh).sum().backward()
    assert still.grad is not None


def test_a_broken_gradient_is_not_hidden() -> None:
    """The texture's gradient is added up in whole numbers, which know no NaN."""
    vertices, mesh = ball(subdivisions=1)
    texture = smooth_texture(8).requires_grad_()
    picture = make_rasterizer(backend="warp").render_mean(at(vertices, 0.1, 0, 2.0), texture, CAMERA, mesh)
    (picture * torch.nan).sum().backward()
    assert not texture.grad.isfinite().any()


def test_the_kernels_compile_for_an_h200(tmp_path: Path) -> None:
    """NVRTC comes with Warp: no GPU, no driver and no CUDA toolkit are needed to see that CUDA takes them."""
    import warp

    for module in (cuda_operators.screen, cuda_operators.outlines, cuda_operators.surface, cuda_operators.gradients):
        warp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == 4


def test_what_the_kernels_cannot_do_is_said() -> None:
    with pytest.raises(InputError, match=r"exact coverage only.*fit\.rasterizer cpu"):
        make_rasterizer("dibr", "warp")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_a_missing_device_is_said() -> None:
    with pytest.raises(InputError, match=r"no device 'cuda'.*fit\.rasterizer cpu"):
        make_rasterizer(backend="cuda")
