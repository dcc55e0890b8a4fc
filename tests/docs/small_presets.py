"""The environment of documents that are run: presets with few iterations on small images."""

import os
import sys
from pathlib import Path

from tests.documents import ROOT

# Python runs this at the start of every process.
_SMALL_PRESETS = """
from hfb import config

def small(stages, settle):
    short = tuple(one.model_copy(update={"size_px": min(one.size_px, 64), "iterations": 2}) for one in stages)
    return {"stages": short, "settle": min(settle, 2)}

def preset(name, whole=config.preset):
    given = whole(name)
    fit, video = (one.model_copy(update=small(one.stages, one.settle)) for one in (given.fit, given.video))
    search = fit.directions.model_copy(update={"refits": 1, "iterations": 2, "polish": 2})
    fit = fit.model_copy(update={"directions": search})
    return given.model_copy(update={"fit": fit, "video": video})

config.preset = preset
"""


def small_environment(folder: Path) -> dict[str, str]:
    """Variables of a process whose presets are small and whose home is the folder; its commands are this Python's."""
    (folder / "presets").mkdir(exist_ok=True)
    (folder / "presets" / "sitecustomize.py").write_text(_SMALL_PRESETS)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    modules = os.pathsep.join([str(folder / "presets"), str(ROOT)])
    return {**os.environ, "PATH": path, "HOME": str(folder), "PYTHONPATH": modules}
