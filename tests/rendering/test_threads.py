"""The same bits for any number of threads, beside other fits, and in a forked child."""

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from hfb.geometry.camera import PinholeCamera
from hfb.kernels.threads import run_tasks
from hfb.rendering.backends import make_rasterizer
from tests.rendering.bodies import people, person_mesh, smooth_texture

CAMERA = PinholeCamera.from_focal(110.0, 96, 80)


def bits(threads: int, silhouette: str = "coverage", seed: int = 0) -> list[torch.Tensor]:
    """Picture and gradients of nine bodies: more than there are partial sums of the texture's gradient."""
    vertices = people(9, seed, torch.float32).requires_grad_()
    texture = smooth_texture(64, dtype=torch.float32).requires_grad_()
    rasterizer, mesh = make_rasterizer(silhouette, "cpu", threads), person_mesh(torch.float32)
    picture = rasterizer.render_mean(vertices, texture, CAMERA, mesh)
    alpha = rasterizer.silhouette_mean(vertices, CAMERA, mesh)
    noise = torch.rand(picture.shape, generator=torch.Generator().manual_seed(0))
    ((picture * noise).sum() + (alpha * noise[..., 0]).sum()).backward()
    assert vertices.grad is not None
    assert texture.grad is not None
    return [picture.detach(), alpha.detach(), vertices.grad, texture.grad]


def same(found: list[torch.Tensor], expected: list[torch.Tensor]) -> bool:
    return all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
def test_any_number_of_threads_gives_the_same_bits(silhouette: str) -> None:
    expected = bits(1, silhouette)
    for threads in (2, 3, 4, 16):
        assert same(bits(threads, silhouette), expected)


@pytest.mark.parametrize("textured", [True, False])
def test_a_body_has_the_bits_it_has_alone(textured: bool) -> None:
    """Eight are looked at together, then three: one reaches behind the camera, one is there."""
    vertices, mesh = people(11, dtype=torch.float32), person_mesh(torch.float32)
    vertices[2, :, 2] -= 3.0  # much of it beside the picture, some behind
    vertices[4, :, 2] -= 9.0
    vertices[9, :, 0] += 0.5
    texture = smooth_texture(64, dtype=torch.float32) if textured else None
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    together = rasterizer.render(vertices, texture, CAMERA, mesh)
    alone = [rasterizer.render(one[None], texture, CAMERA, mesh) for one in vertices]
    assert same(list(together), [one[0] for one in alone])
    assert together[4].abs().max() == 0
    assert all(together[k].abs().max() > 0 for k in range(11) if k != 4)


@pytest.mark.parametrize("threads", [1, 2])
def test_fits_beside_each_other_do_not_disturb_each_other(threads: int) -> None:
    expected = [bits(1, seed=seed) for seed in range(3)]
    with ThreadPoolExecutor(3) as pool:
        jobs = [(seed, pool.submit(bits, threads, "coverage", seed)) for seed in (0, 1, 2) * 4]
        assert all(same(job.result(), expected[seed]) for seed, job in jobs)


def _in_child(results: "multiprocessing.Queue[int]") -> None:
    results.put(sum(run_tasks(lambda i: i * i, 10, 2)))


@pytest.mark.integration
@pytest.mark.integration  # forks
@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_makes_its_own_threads() -> None:
    """An inherited pool has no threads behind it: a child that waits for it hangs."""
    assert sum(run_tasks(lambda i: i * i, 10, 2)) == 285
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    child = context.Process(target=_in_child, args=(results,))
    child.start()
    try:
        assert results.get(timeout=30) == 285
    finally:
        child.join(10)
        child.kill()


def test_a_failing_task_is_heard_and_the_threads_survive() -> None:
    def fail(i: int) -> int:
        if i == 5:
            raise ValueError("five")
        return i

    for threads in (1, 2, 4):
        with pytest.raises(ValueError, match="five"):
            run_tasks(fail, 10, threads)
        assert run_tasks(lambda i: i, 5, threads) == [0, 1, 2, 3, 4]
