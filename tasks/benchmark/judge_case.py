"""Run one method on one case and score it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from hfb.datasets.case import Case
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import MethodSpec
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.benchmark.cases import ReadyHandle
from hfb.tasks.core.handles import Call, FileHandle
from hfb.tasks.core.scene import load_chosen_body, load_observation
from hfb.tasks.task import Where, task


class JudgedHandle(FileHandle):
    """The row of one case and method (a JSON file), with motion and images.

    Attributes:
        motion: the estimated motion; None for a method without poses.
        alternatives: motions of other directions; None for a method without them.
        look: image of input, prediction and truth.
    """

    motion: FileHandle | None = None
    alternatives: FileHandle | None = None
    look: FileHandle | None = None


class JudgeCall(Call):
    """A method and a case.

    Attributes:
        ready: the input of every method.
        method: the method.
        body: the user's body model; None for the embedded one.
        folder: of all methods; the result goes to ``NAME/case_0001`` and so on in it.
    """

    ready: ReadyHandle
    method: MethodSpec
    body: FileHandle | None
    folder: Path


def _needs(call: JudgeCall) -> Where:
    return "worker" if call.method.digests else "cluster"  # a network or prior of the user's lies on this machine


@task("methods", where=_needs)
def judge_case(call: JudgeCall) -> JudgedHandle:
    """Run a method on a case and compare with the truth.

    A method that fails (a fit that diverges, a network that finds nobody) leaves a row with the reason.

    Args:
        call: the method and the case.
    """
    from hfb.datasets.truth import load_truth_of
    from hfb.evaluation.baselines.build import make_method
    from hfb.evaluation.judge import judge
    from hfb.fitting.alternatives import save_alternatives
    from hfb.io.media.images.image_io import write_png
    from hfb.motion.motion_file import save_motion
    from hfb.motion.static_pose import load_first_body
    from hfb.report.images.comparison import draw_comparison

    ready, spec = call.ready, call.method
    folder = call.folder / spec.name / f"case_{ready.case.number:04d}"
    case, model = ready.case.open(), load_chosen_body(call.body)
    observation = load_observation(ready.clip, ready.mattes)
    starts = [load_first_body(start.path) for start in ready.starts]
    facts: dict = {
        "case": case.number,
        "method": spec.name,
        "set": case.facts["set"],
        "frames": case.frames,
        "blur_rate": case.blur_rate,
        "source": source_of(case),
    }
    facts |= {name: case.facts[name] for name in ("recording", "average") if name in case.facts}
    facts |= json.loads(ready.initial.path.read_text())
    folder.mkdir(parents=True, exist_ok=True)
    motion = look = alternatives = None
    try:
        prediction = make_method(spec, model)(case, observation, starts)
    except (InputError, FloatingPointError) as error:
        scores: dict = {"failed": str(error)}
    else:
        sharp = _sharp(case)
        scores = {"failed": None, **judge(prediction, observation, load_truth_of(case.truth), model, sharp)}
        if prediction.motion is not None:
            save_motion(folder / "motion.npz", prediction.motion, model.betas_space)
            motion = FileHandle.of(folder / "motion.npz")
        if prediction.alternatives is not None:
            save_alternatives(folder / "alternatives.npz", prediction.alternatives, prediction.joint_features)
            alternatives = FileHandle.of(folder / "alternatives.npz")
        if prediction.pictures is not None:
            write_png(folder / "look.png", draw_comparison(observation, prediction, sharp))
            look = FileHandle.of(folder / "look.png")
    write_bytes_atomic(folder / "row.json", json.dumps(facts | scores, allow_nan=False).encode())
    return JudgedHandle.of(folder / "row.json", motion=motion, alternatives=alternatives, look=look)


def source_of(case: Case) -> str:
    """Return the name of the recording that a case was made from.

    Args:
        case: the case.
    """
    motion = case.facts.get("motion")
    return str(motion["name"] if isinstance(motion, dict) else case.facts.get("video", ""))


def _sharp(case: Case) -> np.ndarray | None:
    """Return the true sub-frames; None for real video without them."""
    from hfb.datasets.synthetic.sharp import load_sharp

    if not all(path.exists() for path in case.sharp_paths()):
        return None
    return np.stack([load_sharp(case, frame) for frame in range(case.frames)])
