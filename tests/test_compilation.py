"""Kernels are compiled once per machine: a second process takes them from the cache, and computes the same bits."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import hashlib
import sys
from dataclasses import replace
import numpy as np
import torch
from numba.core.dispatcher import Dispatcher
from hfb.body.assets import load_default_body
from hfb.config import Stage, preset
from hfb.fit.loop import fit
from hfb.matting.network import NetworkMatting
from hfb.priors.anatomy import AnatomicalPrior
from tests.bench.jobs import with_pose_blend_shapes
from tests.matting.test_moving_layer import Case
from tests.scenes import moving_scene

body = load_default_body()
scene = moving_scene(body, size_px=48)
seen = scene.observation
matte = NetworkMatting()(seen.frames_linear[0].numpy(), seen.plate_linear.numpy())
changes = {"stages": (Stage(size_px=48, iterations=2),), "subframes": 2, "texture_px": 16}
matted = replace(seen, mattes=torch.from_numpy(np.stack([matte] * len(seen.mattes))))
config = preset("best").fit.model_copy(update=changes)
# The embedded body's vertices do not depend on its pose; a SMPL file's do, and other kernels pose them.
bodies = body, with_pose_blend_shapes(body)
fits = [fit(matted, scene.middle, each, config, 0, AnatomicalPrior()) for each in bodies]
kernels = [
    value
    for name, module in sorted(sys.modules.items()) if name.startswith("hfb.") and "kernels" in name
    for value in vars(module).values() if isinstance(value, Dispatcher)
]
stats = [kernel.stats for kernel in kernels]
print(sum(sum(one.cache_hits.values()) for one in stats), sum(sum(one.cache_misses.values()) for one in stats))
_, layer = Case.drawn(1, 64, 48).descended(np.array([0.15, 0.02, 0.3], np.float32), 20)
made = *layer, matte, *(values for found in fits for values in (found.motion.joints, found.texture.numpy()))
print(hashlib.sha256(b"".join(np.ascontiguousarray(values).tobytes() for values in made)).hexdigest())
"""


def test_a_second_process_compiles_nothing_and_computes_the_same(tmp_path: Path) -> None:
    """What a process has just compiled runs with callees of its own, what it loads with the ones in the cache."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    said = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, env=environment,
            cwd=Path(__file__).parents[1],
        )  # fmt: skip
        said.append(done.stdout.splitlines()[-2:])
    (_, compiled), (counts, loaded) = said
    hits, misses = map(int, counts.split())
    assert misses == 0
    assert hits > 10
    assert loaded == compiled
