"""What workers share: the process that they are forks of imports this module before the first of them begins.

Each would need three seconds of its own for it. Nothing here starts a thread, which a fork would not have.
"""

import importlib

from hfb.kernels.compile import load_cached

for _name in (
    *("hfb.evaluation.baselines.build", "hfb.evaluation.judge", "hfb.datasets.synthetic.synthesis"),
    *("hfb.matting.methods", "hfb.matting.plate_check", "hfb.kernels.rendering.render_texture"),
    *("hfb.report.images.comparison", "hfb.tasks.benchmark.judge_case", "hfb.tasks.chains.clip_steps"),
):
    importlib.import_module(_name)
for _ in load_cached():
    pass
