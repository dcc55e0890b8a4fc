"""Training of a prior: recordings -> training data -> weights -> measurements -> the record."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle, digest
from hfb.tasks.task import task
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.run_record import RunHandle
from hfb.training.priors.training_spec import MotionTraining, PoseTraining

PARTS = ("trained", "held_out", "tested")
Training = MotionTraining | PoseTraining

_MEASURED_SHARE = 0.2
"""Exposures to measure on, per second, relative to those to train on: neighbouring ones hardly differ."""


class LessonsHandle(FileHandle):
    """Arrays to train and to measure on, one per part, and the names of the motions they came from.

    Attributes:
        refused: name -> reason, for motions that cannot be read.
    """

    kind: Literal["motion", "pose"]
    trained: tuple[str, ...]
    held_out: tuple[str, ...]
    tested: tuple[str, ...]
    refused: dict[str, str]

    def arrays(self) -> dict[str, Any]:
        """Return ``trained``, ``held_out`` and ``tested``; of exposures also their lengths."""
        with np.load(self.path, allow_pickle=False) as file:
            return dict(file)


class TrainedHandle(FileHandle):
    """The weights of a prior, and the history of its training (a JSON file of one value per epoch and loss)."""

    history: FileHandle
    parameters: int
    seconds: float


@task("motions")
def gather(
    motions: Path,
    listing: str,
    spec: Training,
    tests: tuple[str, ...],
    held_out: tuple[str, ...],
    seed: int,
    folder: Path,
) -> LessonsHandle:
    """Read a folder of recordings once.

    Args:
        motions: the folder.
        listing: names, sizes and times of its files; a change reads everything again.
        spec: of the training.
        tests: patterns of names that are only measured on at the end.
        held_out: patterns of names that are measured on for choosing.
        seed: of the random numbers.
        folder: where the arrays go.

    Raises:
        InputError: no motion to learn from.
    """
    from hfb.datasets.motions.motion_windows import draw_columns, split_motions, take_poses
    from hfb.datasets.motions.sources import open_motions
    from hfb.motion.motion_file import write_arrays

    source = open_motions(motions, seed)
    names = source.names()
    split = split_motions(names, tests, held_out)
    arrays: dict[str, np.ndarray] = {}
    refused: dict[str, str] = {}
    for part in PARTS:
        numbers = getattr(split, part)
        if isinstance(spec, MotionTraining):
            per_second = spec.windows_per_second * (1 if part == "trained" else _MEASURED_SHARE)
            drawn = draw_columns(source, numbers, per_second, seed, refused, progress.advance)
            arrays[part], arrays[f"{part}_exposure_s"] = drawn
        else:
            arrays[part] = take_poses(source, numbers, spec.poses_per_second, refused, progress.advance)
    kind: Literal["motion", "pose"] = "motion" if isinstance(spec, MotionTraining) else "pose"
    least = 2 if isinstance(spec, MotionTraining) else spec.components
    if len(arrays["trained"]) < least:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in list(refused.items())[:3])
        raise InputError(
            f"{motions} has too little motion to learn from ({len(arrays['trained'])} samples"
            f"{'; ' + reasons if reasons else ''}); give a folder with more recordings"
        )
    path = folder / f"{kind}_lessons.npz"
    write_arrays(path, arrays)
    parts = {part: tuple(names[n] for n in getattr(split, part) if names[n] not in refused) for part in PARTS}
    return LessonsHandle.of(path, kind=kind, refused=refused, **parts)


@task("training")
def train(lessons: LessonsHandle, spec: Training, seed: int, folder: Path) -> TrainedHandle:
    """Train; writes the weights and the losses per epoch.

    Args:
        lessons: training data.
        spec: of the training.
        seed: of the random numbers.
        folder: where the weights go.
    """
    began = time.perf_counter()
    arrays, path = lessons.arrays(), folder / f"{lessons.kind}_prior.safetensors"
    if isinstance(spec, MotionTraining):
        history, parameters = _train_motion(arrays["trained"], spec, seed, path)
    else:
        history, parameters = _train_pose(arrays["trained"], spec, seed, path)
    losses = folder / f"{lessons.kind}_losses.json"
    write_bytes_atomic(losses, json.dumps(history).encode())
    return TrainedHandle.of(
        path, history=FileHandle.of(losses), parameters=parameters, seconds=time.perf_counter() - began
    )


@task("measuring")
def measure(lessons: LessonsHandle, trained: TrainedHandle, seed: int, folder: Path) -> FileHandle:
    """Measure the weights, as stored in the file, on motions that were not trained on.

    Args:
        lessons: data to measure on.
        trained: the weights.
        seed: of the random numbers.
        folder: where the measurements go.
    """
    arrays = lessons.arrays()
    measures: dict[str, Any] = {}
    for part in PARTS[1:] if lessons.kind == "motion" else PARTS:
        if len(arrays[part]) == 0:
            continue
        if lessons.kind == "motion":
            measures[part] = _measure_motion(trained.path, arrays[part], arrays[f"{part}_exposure_s"], seed)
        else:
            measures[part] = _measure_pose(trained.path, arrays[part])
    path = folder / f"{lessons.kind}_measures.json"
    write_bytes_atomic(path, json.dumps(measures, indent=1, allow_nan=False).encode())
    return FileHandle.of(path)


@task("record in MLflow", cached=False)
def record_training(
    params: dict[str, Any],
    lessons: LessonsHandle,
    trained: TrainedHandle,
    measures: FileHandle,
    about: dict[str, Any],
    *,
    began_ms: int,
) -> RunHandle:
    """Record losses per epoch, measurements (those by exposure as steps, the shortest first), and the weights.

    Args:
        params: of the run.
        lessons: training data.
        trained: the weights.
        measures: a JSON file.
        about: description of the weights.
        began_ms: when the training began, in milliseconds since 1970.

    Raises:
        tracking.StoreLost: the store cannot be reached.
    """
    key = digest([params, lessons.sha256, code_version()])
    tags = {"code": code_version(), "seed": str(params["seed"]), "kind": lessons.kind}
    with tracking.record_run(f"train-prior-{lessons.kind}", key, params, tags, began_ms=began_ms) as run:
        if not run.complete:
            losses = {f"loss/{name}": values for name, values in json.loads(trained.history.path.read_text()).items()}
            tracking.log_histories(run, losses | _metrics(json.loads(measures.path.read_text())))
            tracking.log_histories(run, {"time/training_s": [trained.seconds], "parameters": [trained.parameters]})
            tracking.log_files(run, [trained.path])
            tracking.log_dict(run, about, f"{lessons.kind}_prior.json")
        return RunHandle(run_id=run.run_id, link=tracking.link(run))


def _train_motion(columns: np.ndarray, spec: MotionTraining, seed: int, path: Path) -> tuple[dict[str, Any], int]:
    import torch

    from hfb.priors.motion_weights import write_networks
    from hfb.training.priors.motion_training import train_motion_prior

    def tell(epoch: int, epochs: int, losses: dict[str, float]) -> None:
        progress.advance(epoch, epochs, f"indicator {losses['indicator']:.3f}, joints {1000 * losses['joints']:.0f} mm")

    result = train_motion_prior(torch.from_numpy(columns), spec, seed, tell)
    write_networks(path, result.discriminator, result.corrector, spec.sizes)
    networks = (result.discriminator, result.corrector)
    return result.history, sum(one.numel() for network in networks for one in network.parameters())


def _train_pose(poses: np.ndarray, spec: PoseTraining, seed: int, path: Path) -> tuple[dict[str, Any], int]:
    from hfb.priors.mixture import write_mixture
    from hfb.training.priors.mixture_training import train_mixture

    def tell(iteration: int, iterations: int, likelihood: float) -> None:
        progress.advance(iteration, iterations, f"log likelihood {likelihood:.2f}")

    mixture = train_mixture(poses, spec, seed, tell)
    write_mixture(path, mixture.means, mixture.covariances, mixture.weights)
    parameters = mixture.means.size + mixture.covariances.size + mixture.weights.size
    return {"log_likelihood": mixture.history}, parameters


def _measure_motion(path: Path, columns: np.ndarray, exposure_s: np.ndarray, seed: int) -> dict[str, Any]:
    import torch

    from hfb.priors.motion_weights import read_networks
    from hfb.training.priors.motion_measures import measure_motion_prior

    discriminator, corrector = read_networks(path)
    return measure_motion_prior(discriminator.eval(), corrector.eval(), torch.from_numpy(columns), exposure_s, seed)


def _measure_pose(path: Path, poses: np.ndarray) -> dict[str, Any]:
    import torch

    from hfb.priors.load import load_pose_prior

    values = load_pose_prior(path)(torch.from_numpy(poses).unflatten(1, (23, 3)))
    quantiles = {f"prior_at_{100 * share:02.0f}": float(torch.quantile(values, share)) for share in (0.05, 0.5, 0.95)}
    return {"count": len(poses), "all": {"prior_mean": float(values.mean()), **quantiles}}


def _metrics(measures: dict[str, Any]) -> dict[str, list[float | None]]:
    """Return measurements by part as MLflow's metrics."""
    metrics: dict[str, list[float | None]] = {}
    for part, found in measures.items():
        metrics |= {f"{part}/{name}": [value] for name, value in found["all"].items()}
        bins = found.get("by_exposure", [])
        names = [name for name in found["all"] if bins]
        metrics |= {f"{part}_by_exposure/{name}": [one[name] for one in bins] for name in names}
    return metrics
