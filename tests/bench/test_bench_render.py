"""How long drawing takes: eight bodies, forward and backward, as in one iteration of a fit.

``make bench``; in an ordinary test run each of these is executed once, to see that it works.
"""

from collections.abc import Callable

import pytest
import torch

from hfb.render.camera import PinholeCamera
from hfb.render.rasterizer import Rasterizer, make_rasterizer
from tests.render.bodies import people, person_mesh, smooth_texture

SUBFRAMES = 8


def forward_and_backward(rasterizer: Rasterizer, size_px: int, bodies: int, textured: bool) -> Callable[[], None]:
    """One drawing with its way back, ready to be timed (compiled, tables made)."""
    camera = PinholeCamera.from_focal(1.25 * size_px, size_px, size_px)
    vertices = people(bodies, dtype=torch.float32, spread_rad=0.15).requires_grad_()
    texture, mesh = smooth_texture(128, dtype=torch.float32).requires_grad_(), person_mesh(torch.float32)
    gradient = torch.rand(size_px, size_px, 4, generator=torch.Generator().manual_seed(0))

    def once() -> None:
        vertices.grad = texture.grad = None
        if textured:
            rasterizer.render_mean(vertices, texture, camera, mesh).backward(gradient)
        else:
            rasterizer.silhouette_mean(vertices, camera, mesh).backward(gradient[..., 3])

    once()
    return once


@pytest.mark.parametrize("size_px", [256, 512])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_eight_bodies(benchmark, silhouette: str, threads: int, size_px: int) -> None:
    rasterizer = make_rasterizer(silhouette, "cpu", threads)
    benchmark(forward_and_backward(rasterizer, size_px, SUBFRAMES, textured=True))


@pytest.mark.parametrize("size_px", [256, 512])
def test_eight_silhouettes(benchmark, size_px: int) -> None:
    benchmark(forward_and_backward(make_rasterizer(), size_px, SUBFRAMES, textured=False))


def test_the_reference_on_one_body(benchmark) -> None:
    once = forward_and_backward(make_rasterizer(backend="reference"), 128, 1, textured=True)
    benchmark.pedantic(once, rounds=1, iterations=1)
