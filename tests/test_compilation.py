"""Kernels are compiled once per machine: a second process takes them from the cache."""

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys
from numba.core.dispatcher import Dispatcher
from hfb.body.assets import load_default_body
from hfb.config import FitConfig, Stage
from hfb.fit.loop import fit
from hfb.priors.anatomy import AnatomicalPrior
from tests.scenes import moving_scene

body = load_default_body()
scene = moving_scene(body, size_px=48)
fit(scene.observation, scene.middle, body, FitConfig(stages=(Stage(size_px=48, iterations=2),)), 0, AnatomicalPrior())
kernels = [
    value
    for name, module in sorted(sys.modules.items()) if name.startswith("hfb.") and "kernels" in name
    for value in vars(module).values() if isinstance(value, Dispatcher)
]
stats = [kernel.stats for kernel in kernels]
print(sum(sum(one.cache_hits.values()) for one in stats), sum(sum(one.cache_misses.values()) for one in stats))
"""


def test_a_second_process_compiles_nothing() -> None:
    command = [sys.executable, "-c", SCRIPT]
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[1])
    hits, misses = map(int, done.stdout.split())
    assert misses == 0
    assert hits > 10
