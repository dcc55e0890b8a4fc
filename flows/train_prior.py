"""Train a prior from the user's motion capture: read, train, measure on held-out motions, record."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from hfb.config import Record
from hfb.datasets.set_spec import listing_of
from hfb.errors import InputError
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.io.json_file import read_json
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.result_records import records_in
from hfb.tasks.inputs.out_place import check_sources_out
from hfb.tasks.prior_training import LessonsHandle, TrainedHandle, gather, measure, record_training, train
from hfb.tasks.results.own_files import put_together
from hfb.tasks.results.workspace import workspace
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.training.priors.training_spec import MotionTraining, PoseTraining


class TrainingPlan(Record):
    """Everything that decides a prior's weights."""

    motions: Path
    kind: Literal["motion", "pose"]
    tests: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    seed: int = Field(0, ge=0)
    motion: MotionTraining = MotionTraining()
    pose: PoseTraining = PoseTraining()


def work_folder(out: Path) -> Path:
    """Return the folder in which a training keeps its intermediate files.

    Args:
        out: the file of the weights.
    """
    return out.with_name(f"{out.stem}-training")


@recorded_flow("train-prior")
def train_prior(plan: TrainingPlan, out: Path) -> dict[str, Any]:
    """Train a prior, publish its weights as ``out`` with their description as .json; recorded in MLflow.

    Args:
        plan: recordings and options.
        out: the file of the weights.

    Returns:
        the content of the .json, and where things are.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
    """
    if out.suffix != ".safetensors" or out.is_dir():
        raise InputError(f"{out}: a prior is one file; give --out a name that ends in .safetensors")
    if not plan.motions.is_dir():
        raise InputError(f"{plan.motions} is no folder; give one with recordings, such as .bvh or AMASS .npz files")
    check_sources_out([plan.motions], out.parent)
    _check_room(out)
    spec, began_ms = plan.motion if plan.kind == "motion" else plan.pose, time.time_ns() // 1_000_000
    with workspace(work_folder(out)) as folder, records_in(folder):
        lessons = gather(plan.motions, listing_of(plan.motions), spec, plan.tests, plan.held_out, plan.seed, folder)
        for name, reason in lessons.refused.items():
            progress.say(f"left out: {name}: {reason}")
        trained = train(lessons, spec, plan.seed, folder)
        measures = measure(lessons, trained, plan.seed, folder)
        about = _about(plan, lessons, trained, measures, out.name)
        result = {**about, "out": str(out.resolve()), "mlflow_run_id": None, "mlflow_link": None}
        try:
            run = record_training(_params(plan), lessons, trained, measures, about, began_ms=began_ms)
            result |= {"mlflow_run_id": run.run_id, "mlflow_link": run.link}
        except tracking.StoreLost as lost:
            progress.say(f"not recorded in MLflow, the result itself is complete: {lost}")
        told = json.dumps(about, indent=1, allow_nan=False).encode() + b"\n"
        put_together(out.parent, {out.with_suffix(".json").name: told, out.name: trained.path.read_bytes()})
    return result


def _check_room(out: Path) -> None:
    """Raise InputError if a file that no training wrote would be replaced."""
    about = out.with_suffix(".json")
    if there := [path for path in (out, about) if path.exists() and not work_folder(out).is_dir()]:
        with suppress(InputError, KeyError, TypeError):
            if read_json(about)["weights"] == out.name:
                return
        names = " and ".join(path.name for path in there)
        raise InputError(f"{out.parent} holds {names}, which no training of hfb left: choose another --out")


def _params(plan: TrainingPlan) -> dict[str, Any]:
    """Return the run's identity: the content of the recordings counts, their place does not."""
    other = "pose" if plan.kind == "motion" else "motion"
    return {**plan.model_dump(mode="json", exclude={other}), "motions": plan.motions.name}


def _about(
    plan: TrainingPlan, lessons: LessonsHandle, trained: TrainedHandle, measures: FileHandle, name: str
) -> dict[str, Any]:
    """Return the description of a file of weights: options, recordings and measurements."""
    history = json.loads(trained.history.path.read_text())
    return {
        "weights": name,
        "sha256": trained.sha256,
        "parameters": trained.parameters,
        "training": _params(plan),
        "data": {
            "lessons_sha256": lessons.sha256,
            "trained": list(lessons.trained),
            "held_out": list(lessons.held_out),
            "tested": list(lessons.tested),
            "refused": lessons.refused,
        },
        "last_losses": {loss: values[-1] for loss, values in history.items()},
        "training_seconds": round(trained.seconds, 1),
        "measures": json.loads(measures.path.read_text()),
        "code": code_version(),
    }
