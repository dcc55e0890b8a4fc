"""An iteration against the product that it cannot do without, whole fits, and two of them at once."""

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.config import preset
from hfb.fitting.fit import Problem, fit_all
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.priors.anatomy import AnatomicalPrior
from tests.bench import jobs
from tests.bench.conftest import Scale
from tests.bench.figures import Figures
from tests.bench.rounds import Times, between, clock, interleaved, together
from tests.scenes import Scene, moving_scene


def pose_blend_product(vertex_count: int) -> Callable[[], None]:
    """The floor: SMPL's pose blend shapes of 8 bodies as one product, forward and backward."""
    generator = torch.Generator().manual_seed(0)
    feature = torch.randn(8, 207, generator=generator).requires_grad_()
    directions = torch.randn(207, 3 * vertex_count, generator=generator)
    gradient = torch.randn(8, 3 * vertex_count, generator=generator)

    def once() -> None:
        feature.grad = None
        (feature @ directions).backward(gradient)

    return once


def iterations_of(scene: Scene, body: Body, count: int) -> Times:
    """Single iterations of a fit at its real size, from one forward's end to the next's; the first is left out."""
    stamps: list[tuple[float, float]] = []
    jobs.small_fit(scene, body, jobs.default_config(count), lambda *_: stamps.append(clock()))
    return between(stamps[1:])


def test_iteration_against_the_floor(scale: Scale, figures: Figures) -> None:
    """Both by the CPU seconds of their one thread, which a busy machine changes less than the wall's."""
    plain = load_default_body()
    bodies = {"the embedded body": plain, "a body with pose blend shapes": jobs.with_pose_blend_shapes(plain)}
    scene = moving_scene(plain, size_px=jobs.SIZE_PX if scale.measures else 48)
    product = pose_blend_product(len(plain.template))
    rounds, count = (max(scale.rounds // 5, 2), 12) if scale.measures else (1, 4)
    floor = interleaved({"": product}, 1)[""]
    found = {name: iterations_of(scene, body, 4) for name, body in bodies.items()}
    for _ in range(rounds):
        floor = together(floor, interleaved({"": product}, 10)[""])
        found = {name: together(times, iterations_of(scene, bodies[name], count)) for name, times in found.items()}
    figures.say(f"pose blend product of 8 bodies, there and back, 1 core: {floor}")
    ratios = {name: times.best_cpu / floor.best_cpu for name, times in found.items()}
    for name, times in found.items():
        figures.say(f"one iteration, 256 px, N = 8, {name}, 1 core: {times}: {ratios[name]:.2f} floors")
    figures.set("iteration_vs_floor", ratios["a body with pose blend shapes"], "of CPU seconds, pose blend shapes in")


@contextmanager
def fitting_process(iterations: int) -> Iterator[tuple[Callable[[], None], Callable[[], list[float]]]]:
    """A process that fits when told: (tell it to begin, wait for its wall and CPU seconds)."""
    arguments = jobs.command("fits", iterations)
    with subprocess.Popen(
        arguments, env=jobs.environment(), text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        into, out_of = process.stdin, process.stdout
        assert into is not None
        assert out_of is not None

        def begin() -> None:
            into.write("fit\n")
            into.flush()

        def wait() -> list[float]:
            return json.loads(out_of.readline())

        assert json.loads(out_of.readline()) == "ready"
        yield begin, wait
        into.close()


def test_fits(scale: Scale, figures: Figures) -> None:
    """One fit by itself, then two at once in two processes, in turn."""
    iterations = 200 if scale.measures else 2
    alone, both = [], []
    with fitting_process(iterations) as first, fitting_process(iterations) as second:
        for number in range(scale.fits):
            begin, wait = (first, second)[number % 2]
            begin()
            *times, peak_mb = wait()
            alone.append(times)
            began = time.perf_counter()
            first[0]()
            second[0]()
            cpu = first[1]()[1] + second[1]()[1]
            both.append([time.perf_counter() - began, cpu])
    one, two = (Times(*map(tuple, zip(*found, strict=True))) for found in (alone, both))
    figures.say(f"200 iterations at 256 px, N = 8, one process, one core: {one}")
    figures.say(f"two such fits at once, two cores: {two}")
    figures.set("fit_seconds_1core", one.best, f"{one.best_cpu:.2f} s of CPU")
    figures.set("two_fits_throughput", 2 * one.best / two.best, "best of each")
    figures.set("fit_peak_mb", peak_mb, "whole process, default settings, 256 px")


def test_what_users_run(scale: Scale, figures: Figures, thorough: None) -> None:
    """Preset `best` from first bodies to results: networks, settling, all stages, the search for directions."""
    body, config = load_default_body(), preset("best").fit
    if not scale.measures:
        stages = tuple(stage.model_copy(update={"size_px": 48, "iterations": 1}) for stage in config.stages)
        config = config.model_copy(update={"stages": stages, "settle": 1})
    scenes = [moving_scene(body, size_px=jobs.SIZE_PX if scale.measures else 48, frames=frames) for frames in (1, 2)]
    fits = {f"{len(scene.middle)}": partial(jobs.small_fit, scene, body, config) for scene in scenes}
    for frames, times in interleaved(fits, scale.fits).items():
        figures.say(f"one fit with preset best, frames of {jobs.SIZE_PX} px, {frames} at once, 1 core: {times}")


def test_fits_as_one_problem_on_a_gpu(scale: Scale, figures: Figures) -> None:
    """With pose blend shapes and everything that a fit does; without a GPU only that it runs."""
    pytest.importorskip("warp", reason="the Warp kernels need warp-lang (pip install '.[cuda]')")
    gpu = torch.cuda.is_available()
    if scale.measures and not gpu:
        figures.say("no GPU here: fits on one were not measured")
        return
    count, iterations, size_px = (128, 200, jobs.SIZE_PX) if scale.measures else (2, 2, 48)
    body = load_default_body()
    seen = [moving_scene(body, size_px=size_px, step_m=0.1 + 0.05 * number) for number in range(4)]
    problems = [Problem(seen[number % 4].observation, seen[number % 4].middle) for number in range(count)]
    body = jobs.with_pose_blend_shapes(body)

    def fits(iterations: int) -> float:
        config = jobs.default_config(iterations).model_copy(update={"rasterizer": "cuda" if gpu else "warp"})
        began = time.perf_counter()
        results = fit_all(problems, body, config, 0, AnatomicalPrior(), batch_size=count)
        assert len(results) == count
        return time.perf_counter() - began

    fits(2)
    seconds = fits(iterations)
    if gpu:
        name = torch.cuda.get_device_name()
        each_ms = 1e3 * (seconds - fits(iterations // 2)) / (iterations - iterations // 2)
        ours, products = busy_ms(lambda: fits(iterations // 10), iterations // 10)
        figures.say(
            f"{count} fits of {iterations} iterations, {size_px} px, at once, {name}: {count / seconds:.1f} a s"
        )
        figures.say(
            f"an iteration of them: {each_ms:.1f} ms, our kernels {ours:.1f} ms, matrix products {products:.1f} ms: "
            f"{(ours + products) / each_ms:.0%}"
        )


def busy_ms(work: Callable[[], object], iterations: int) -> tuple[float, float]:
    """Milliseconds per iteration that a GPU spends in Warp's kernels and in matrix products."""
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
        work()
    events = [(one.key, one.self_device_time_total / 1e3 / iterations) for one in profile.key_averages()]
    products = sum(ms for name, ms in events if any(word in name for word in ("gemm", "gemv", "cutlass")))
    return sum(ms for name, ms in events if "cuda_kernel" in name), products


@pytest.mark.benchmark(min_rounds=3)
def test_pose_prior_8_subframes(benchmark) -> None:
    prior = AnatomicalPrior()
    poses = (0.1 * torch.randn(8, 23, 3, generator=torch.Generator().manual_seed(0))).requires_grad_()
    benchmark(lambda: prior(poses).sum().backward())


@pytest.mark.parametrize("blend_shapes", [False, True])
def test_skinning_8_bodies(benchmark, blend_shapes: bool) -> None:
    body = load_default_body()
    if blend_shapes:
        body = jobs.with_pose_blend_shapes(body)
    poses = (0.3 * torch.randn(8, 24, 3, generator=torch.Generator().manual_seed(0))).requires_grad_()
    betas = torch.zeros(10, requires_grad=True)

    def forward_and_backward() -> None:
        posed = body.shape(betas).pose(axis_angle_to_matrix(poses), torch.zeros(8, 3))
        posed.vertices.sum().backward()

    benchmark(forward_and_backward)
