"""Eight bodies, forward and backward, as in one iteration of a fit: ours beside its peers on the same meshes."""

from collections.abc import Callable

import pytest
import torch

from hfb.geometry.camera import PinholeCamera
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from tests.bench import peers
from tests.bench.conftest import Scale
from tests.bench.figures import Figures
from tests.bench.rounds import interleaved
from tests.rendering.bodies import people, person_mesh, smooth_texture

SUBFRAMES = 8
MESH = person_mesh(torch.float32)


def view(size_px: int) -> PinholeCamera:
    """The body's height is two thirds of the picture's."""
    return PinholeCamera.from_focal(1.25 * size_px, size_px, size_px)


def there_and_back(mean: peers.MeanPicture, size_px: int, threads: int = 1, bodies: int = SUBFRAMES) -> Callable:
    """One drawing with its gradients by vertices and texture, ready to be timed."""
    vertices = people(bodies, dtype=torch.float32, spread_rad=0.15).requires_grad_()
    texture = smooth_texture(128, dtype=torch.float32).requires_grad_()
    gradient = torch.rand(size_px, size_px, 4, generator=torch.Generator().manual_seed(0))

    def once() -> torch.Tensor:
        vertices.grad = texture.grad = None
        torch.set_num_threads(threads)
        picture = mean(vertices, texture)
        picture.backward(gradient)
        torch.set_num_threads(1)
        assert vertices.grad is not None
        return picture.detach()

    return once


def ours(size_px: int, rasterizer: Rasterizer) -> peers.MeanPicture:
    camera = view(size_px)
    return lambda vertices, texture: rasterizer.render_mean(vertices, texture, camera, MESH)


def plural(threads: int) -> str:
    return f"{threads} thread{'s' * (threads > 1)}"


def shared_area(one: torch.Tensor, other: torch.Tensor) -> float:
    """Soft intersection over union of two pictures' coverage."""
    return (torch.minimum(one, other)[..., 3].sum() / torch.maximum(one, other)[..., 3].sum()).item()


@pytest.mark.parametrize("size_px", [256, 512])
def test_against_drtk(size_px: int, scale: Scale, figures: Figures) -> None:
    missing = peers.drtk_is_here()
    subjects = {
        f"ours, {plural(threads)}": there_and_back(ours(size_px, make_rasterizer(threads=threads)), size_px)
        for threads in (1, 2)
    }
    if not missing:
        mean = peers.drtk_mean(view(size_px), MESH)
        subjects |= {f"DRTK, {plural(threads)}": there_and_back(mean, size_px, threads) for threads in (1, 2)}
    times = interleaved(subjects, max(scale.rounds * 256 // (2 * size_px), 1))
    for name, found in times.items():
        figures.say(f"8 bodies, {size_px} px, there and back: {name}: {found}")
    if missing:
        figures.say(f"raster_vs_drtk_{size_px}: null, {missing}")
        return
    # A peer that draws something else proves nothing: the same body in the same place (edges differ by half a pixel).
    assert shared_area(subjects["ours, 2 threads"](), subjects["DRTK, 2 threads"]()) > 0.95
    # On a busy machine two threads of OpenMP are slower than one: the peer is taken at its best.
    peer = min(times["DRTK, 1 thread"].best, times["DRTK, 2 threads"].best)
    figures.set(f"raster_vs_drtk_{size_px}", peer / times["ours, 2 threads"].best)


def test_against_pytorch3d(scale: Scale, figures: Figures) -> None:
    """Of one body: PyTorch3D needs ten seconds for it. Its cost grows with their number, as ours does."""
    missing = peers.pytorch3d_is_here()
    if missing:
        figures.say(f"raster_vs_pytorch3d_256: null, {missing}")
        return
    if scale.measures and scale.fits < 2:
        figures.say("raster_vs_pytorch3d_256: null, it takes too long for QUICK=1")
        return
    size_px = 256 if scale.measures else 64
    drawn = {
        "ours": there_and_back(ours(size_px, make_rasterizer()), size_px, bodies=1),
        "PyTorch3D": there_and_back(peers.pytorch3d_mean(view(size_px), MESH), size_px, bodies=1),
    }
    times = interleaved(drawn, 1)
    for name, found in times.items():
        figures.say(f"1 body, {size_px} px, there and back, 1 thread: {name}: {found}")
    mine, theirs = (drawn[name]()[..., 3] for name in ("ours", "PyTorch3D"))
    # Its soft mask is a halo outside the edge (a third more area), so the body has to lie inside of what it covers.
    assert torch.minimum(mine, theirs).sum() > 0.95 * mine.sum()
    assert theirs.sum() < 1.5 * mine.sum()
    figures.set("raster_vs_pytorch3d_256", times["PyTorch3D"].best / times["ours"].best)


@pytest.mark.usefixtures("thorough")
def test_against_the_readable_reference(scale: Scale, figures: Figures) -> None:
    size_px = 128 if scale.measures else 32
    backends = {"ours": make_rasterizer(), "the torch reference": make_rasterizer(backend="reference")}
    drawn = {name: there_and_back(ours(size_px, one), size_px, bodies=1) for name, one in backends.items()}
    assert shared_area(drawn["ours"](), drawn["the torch reference"]()) > 0.999
    times = interleaved(drawn, 1)
    ratio = times["the torch reference"].best / times["ours"].best
    figures.say(f"1 body, {size_px} px, there and back: the torch reference takes {ratio:.0f} times as long as ours")


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
@pytest.mark.parametrize("threads", [1, 2])
def test_eight_bodies(benchmark, silhouette: str, threads: int) -> None:
    benchmark(there_and_back(ours(256, make_rasterizer(silhouette, "cpu", threads)), 256))


def test_eight_silhouettes(benchmark) -> None:
    rasterizer, camera = make_rasterizer(), view(256)

    def silhouette(vertices: torch.Tensor, texture: torch.Tensor) -> torch.Tensor:
        alpha = rasterizer.silhouette_mean(vertices, camera, MESH)[..., None]
        return torch.cat([texture.new_zeros(256, 256, 3), alpha], -1)

    benchmark(there_and_back(silhouette, 256))


@pytest.mark.usefixtures("thorough")
def test_eight_bodies_by_warp(scale: Scale, figures: Figures) -> None:
    """On a GPU where there is one: with 16 frames at once, which is what keeps it busy."""
    pytest.importorskip("warp", reason="the Warp kernels need warp-lang (pip install '.[cuda]')")
    from hfb.rendering.warp import WarpRasterizer

    device = "cuda" if torch.cuda.is_available() else "cpu"
    rasterizer, camera, frames = WarpRasterizer(device), view(256), 16 if device == "cuda" else 1
    vertices = people(SUBFRAMES, dtype=torch.float32, spread_rad=0.15).expand(frames, -1, -1, -1).to(device)
    vertices = vertices.contiguous().requires_grad_()
    textures = smooth_texture(128, dtype=torch.float32)[None].to(device).requires_grad_()

    def once() -> None:
        rasterizer.render_pictures(vertices, textures, [camera] * frames, MESH).sum().backward()
        if device == "cuda":
            torch.cuda.synchronize()

    found = interleaved({"warp": once}, min(scale.rounds // 3 + 1, 20))["warp"]
    figures.say(f"8 bodies x {frames} frames, 256 px, there and back, Warp on {device}: {found}")
