"""What the benchmarks run in processes of their own: `python -m tests.bench.jobs NAME ...` prints a line of JSON.

A process per job, since start-up, peak memory and compilation belong to a process; and without the run-time checks of
the tests, so what is measured is what users run.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.config import FitConfig, preset
from hfb.fitting.fit import FitResult, fit
from hfb.priors.anatomy import AnatomicalPrior
from tests.scenes import Scene, moving_scene

SIZE_PX = 256


def with_pose_blend_shapes(body: Body) -> Body:
    """The embedded body has none; a SMPL file has, and they are most of an iteration's floor.

    Displacements of a millimetre that neighbours share, as in such files: noise on single vertices crumples the
    surface, and its outline, which is what drawing costs, grows by more than half.
    """
    generator = torch.Generator().manual_seed(0)
    waves, phases = 3 * torch.randn(207, 3, 3, generator=generator), 6.3 * torch.rand(3, 207, generator=generator)
    directions = 1.4e-3 * torch.sin(torch.einsum("kcd,vd->vck", waves, body.template) + phases)
    return replace(body, pose_directions=directions)


def small_fit(scene: Scene, body: Body, config: FitConfig, on_progress: Callable | None = None) -> FitResult:
    return fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior(), on_progress=on_progress)


def default_config(iterations: int) -> FitConfig:
    """The defaults of FitConfig: 256 px, N = 8, 200 iterations of the kernels alone (fewer where asked for)."""
    config = FitConfig()
    (stage,) = config.stages
    return config.model_copy(update={"stages": (stage.model_copy(update={"iterations": iterations}),)})


def fits(iterations: int) -> None:
    """One fit per line of standard input; answers with [wall seconds, CPU seconds, peak MB of the process].

    Ready once it has said so.
    """
    torch.set_num_threads(1)
    body = load_default_body()
    scene = moving_scene(body, size_px=SIZE_PX)
    small_fit(scene, body, default_config(3))
    print(json.dumps("ready"), flush=True)
    for _ in sys.stdin:
        before = time.process_time()
        seconds = small_fit(scene, body, default_config(iterations)).seconds
        print(json.dumps([seconds, time.process_time() - before, peak_mb()]), flush=True)


def memory(iterations: int) -> None:
    """Peak memory [MB] of one process that makes one fit of preset `best`, so many iterations a stage."""
    torch.set_num_threads(1)
    body, config = load_default_body(), preset("best").fit
    stages = tuple(stage.model_copy(update={"iterations": iterations}) for stage in config.stages)
    config = config.model_copy(update={"stages": stages})
    small_fit(moving_scene(body, size_px=SIZE_PX), body, config)
    print(json.dumps(peak_mb()))


def peak_mb() -> float:
    """Return this process's peak since its start (ru_maxrss would count the parent's memory before exec)."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # bytes, on macOS


def draw() -> None:
    """Eight bodies there and back in a fresh process: {"imports", "seconds", "compiled"}."""
    began = time.perf_counter()
    from hfb.rendering.backends import make_rasterizer
    from tests.bench.test_bench_raster import ours, there_and_back

    imported = time.perf_counter()
    there_and_back(ours(SIZE_PX, make_rasterizer()), SIZE_PX)()
    modules = [module for name, module in sys.modules.items() if name.startswith("hfb.kernels.")]
    entries = {id(one): one for module in modules for one in vars(module).values() if hasattr(one, "stats")}
    compiled = sum(sum(one.stats.cache_misses.values()) for one in entries.values())
    seconds = {"imports": imported - began, "seconds": time.perf_counter() - imported}
    print(json.dumps({**seconds, "compiled": compiled}))


def environment(folder: Path | None = None) -> dict[str, str]:
    """Of a child: one thread per process; what a run leaves outside its --out goes into the folder."""
    there = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "MLFLOW_"))}
    there |= {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    if folder is not None:
        there |= {"PREFECT_HOME": str(folder / "prefect"), "MLFLOW_TRACKING_URI": f"sqlite:///{folder / 'mlflow.db'}"}
        there |= {f"XDG_{kind}_HOME": str(folder / kind.lower()) for kind in ("DATA", "STATE")}
    return there


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "tests.bench.jobs", *(str(one) for one in arguments)]


def result_of(*arguments: object) -> Any:
    """Run a job and read its line."""
    done = subprocess.run(command(*arguments), env=environment(), capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    name, *numbers = sys.argv[1:]
    {"fits": fits, "memory": memory, "draw": draw}[name](*map(int, numbers))
