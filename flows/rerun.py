"""Repeat a recorded run from the same inputs and options, and compare the two results."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.evaluation.motion_difference import motion_difference
from hfb.flows.fit_image import fit_image_again
from hfb.flows.record import record_folder
from hfb.flows.video import run_video
from hfb.interop.writers.export_names import RECORD
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.motion_file import load_motion
from hfb.networks.mediapipe_files import LandmarkChoice
from hfb.tasks.core.environment import code_version, environment
from hfb.tasks.core.handles import FileHandle, sha256_of
from hfb.tasks.core.repetition import Repetition, repeat_run
from hfb.tasks.core.result_folder import list_unfinished_files
from hfb.tasks.inputs.inputs import Inputs, networks_at_hand
from hfb.tasks.inputs.out_place import check_clip_out, check_pictures_out
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.results.reload_inputs import locate_inputs
from hfb.tasks.results.stored_runs import StoredRun, fetch_file, find_run, readable_store
from hfb.tasks.results.workspace import INTERMEDIATE
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.hidden_options import with_options
from hfb.tasks.tracking.recipe import COMMAND_TAG, RECIPE, Recipe, read_recipe, recipe_config, recipe_inputs, to_recipe
from hfb.tasks.tracking.run_record import read_kept

MOTION = "motion.npz"
VERDICT = "rerun.json"
InputsT = TypeVar("InputsT", Inputs, VideoInputs)
_FETCHED_NETWORKS = ("auto", "mediapipe")  # ways to a first body that use what `hfb models` has fetched
_ENVIRONMENT = ("version.", "platform", "processor", "device")


@dataclass(frozen=True)
class Plan:
    """A run that can be repeated: all its inputs exist.

    Attributes:
        again: runs the command's chain and returns the content of its result.json.
        out: a new folder, or one in which this repetition was interrupted.
        results: sha256 of the run's files, by name.
        changed: differences in code and machine, one sentence each.
    """

    run: StoredRun
    again: Callable[[], dict[str, Any]]
    out: Path
    results: dict[str, str]
    changed: tuple[str, ...]


def plan_rerun(
    words: str,
    inputs_folder: Path | None = None,
    out: Path | None = None,
    *,
    workers: int = 1,
    options: Mapping[str, str] | None = None,
) -> Plan:
    """Find a run and everything it needs.

    Args:
        words: a run's id, the beginning of it, or its result's folder.
        inputs_folder: where to look for files that were moved; they are recognised by their content.
        out: the folder of the repetition; None for a new one under runs/.
        workers: processes that compute a clip; their number changes no digit.
        options: values that the record hides, since they held a secret.

    Raises:
        InputError: there is no such run, it cannot be repeated, an input is gone or was changed, a hidden option is not
            given, or the folder holds something already.
    """
    if (Path(words) / RECORD).is_file():  # nobody has recorded this result yet
        _check_whole(to_recipe(read_kept(Path(words)).contents.get(RECIPE), words), words)
        progress.say(f"hfb: {words} is recorded in MLflow first")
        record_folder(Path(words))
    run = find_run(words)
    if run.tags.get(COMMAND_TAG) is None:
        raise InputError(
            f"run {run.title} cannot be repeated: only runs of `hfb fit`, `hfb demo` and `hfb video` of this version "
            "on say what they were made of; run its own command again"
        )
    if run.status != "FINISHED":
        raise InputError(
            f"run {run.title} is {run.status}: it has no result to compare with; run its own command again"
        )
    with tempfile.TemporaryDirectory() as folder, readable_store():
        path = fetch_file(run, RECIPE, Path(folder))
        if path is None:
            raise InputError(f"the recipe of run {run.title} is gone from the store: run its own command again")
        recipe = with_options(read_recipe(path, run.title), options or {}, run.title)
    _check_whole(recipe, f"run {run.title}")
    fetched = recipe_config(recipe, {}, run.title).init.method in _FETCHED_NETWORKS
    with progress.step("inputs"):
        files = {role: file for role, file in recipe.files.items() if not (fetched and role.startswith("network_"))}
        places = locate_inputs(files, inputs_folder)
    target = _fresh(out, run.run_id)
    again = _chain(recipe, recipe_config(recipe, places, run.title), places, run=run.title, out=target, workers=workers)
    return Plan(run, again, target, recipe.results, _list_changes(run))


def repeat(plan: Plan) -> dict[str, Any]:
    """Run the command's chain again, and compare.

    Args:
        plan: the run.

    Returns:
        the content of rerun.json.
    """
    began = time.perf_counter()
    with repeat_run(Repetition(plan.run.run_id, plan.out)):
        result = plan.again()
    seconds = time.perf_counter() - began
    with progress.step("comparison"):
        verdict = _compare(plan) | {"seconds": round(seconds, 3), "mlflow_run_id": result.get("mlflow_run_id")}
    write_bytes_atomic(plan.out / VERDICT, json.dumps(verdict, indent=2, allow_nan=False).encode() + b"\n")
    _record(verdict)
    return verdict


def _check_whole(recipe: Recipe, what: str) -> None:
    """Raise InputError if the run was made of something that no file holds."""
    if recipe.lacks:
        raise InputError(f"{what} cannot be repeated by a command, since {' and '.join(recipe.lacks)}: repeat its call")


def _chain(
    recipe: Recipe, config: RunConfig, places: dict[str, Path], *, run: str, out: Path, workers: int
) -> Callable[[], dict[str, Any]]:
    """Return the command's chain with the current places of its inputs."""
    if recipe.command == "fit":
        inputs, settled = with_networks(recipe_inputs(Inputs, recipe, places, run), config, run)
        check_pictures_out([one.path for one in inputs.frames], out)
        return lambda: fit_image_again(inputs, out, settled)
    clip, settled = with_networks(recipe_inputs(VideoInputs, recipe, places, run), config, run)
    check_clip_out(clip.video[0].path, [one.path for one in clip.video], out)
    return lambda: run_video(clip, out, settled, workers)


def with_networks(inputs: InputsT, config: RunConfig, run: str) -> tuple[InputsT, RunConfig]:
    """Return inputs and options with the run's pose networks; without any, `auto` meant the matte alone.

    Args:
        inputs: of the run.
        config: all options.
        run: its title, for messages.
    """
    if config.init.method not in _FETCHED_NETWORKS or getattr(inputs, "first_bodies", None):
        return inputs, config
    if not inputs.networks and config.init.method == "auto":
        return inputs, config.model_copy(update={"init": config.init.model_copy(update={"method": "matte"})})
    found: tuple[FileHandle, ...] = ()
    choices: tuple[LandmarkChoice, ...] = (config.init.landmarks, "heavy", "full")
    for choice in choices:  # since then a better network may have been fetched, which auto would take now
        with suppress(InputError):
            found = networks_at_hand(choice) or found
        if [one.sha256 for one in found] == [one.sha256 for one in inputs.networks]:
            init = config.init.model_copy(update={"landmarks": choice})
            return inputs.model_copy(update={"networks": found}), config.model_copy(update={"init": init})
    state = "are other ones now" if found else "are gone"
    raise InputError(f"the pose networks that run {run} used {state}: `hfb models fetch --force` brings them back")


def _fresh(out: Path | None, run_id: str) -> Path:
    """Return a folder without a result, for this repetition alone."""
    if out is not None:
        if not _is_fresh(out):
            raise InputError(f"{out} holds something already: choose a new folder with --out")
        return out
    number, first = 1, Path("runs") / f"rerun-{run_id[:8]}"
    target = first
    while not _is_fresh(target):
        number += 1
        target = first.with_name(f"{first.name}-{number}")
    return target


def _is_fresh(folder: Path) -> bool:
    """Return whether a folder is empty, or holds only what an interrupted run leaves."""
    if not folder.exists() or not folder.is_dir():
        return not folder.exists()
    return {path.name for path in folder.iterdir()} <= {INTERMEDIATE, *list_unfinished_files(folder)}


def _list_changes(run: StoredRun) -> tuple[str, ...]:
    now = environment() | {"code": code_version()}
    then = {name: value for name, value in run.tags.items() if name == "code" or name.startswith(_ENVIRONMENT)}
    names = sorted(name for name in now.keys() | then.keys() if now.get(name) != then.get(name))
    return tuple(
        f"{name.removeprefix('version.')} ({then.get(name, 'unknown')} then, {now.get(name, 'none')} now)"
        for name in names
    )


def _compare(plan: Plan) -> dict[str, Any]:
    """Compare the result with the recorded one; distances are None where the store lost the motion."""
    made = {name: sha256_of(plan.out / name) if (plan.out / name).is_file() else None for name in plan.results}
    differing = sorted(name for name, sha256 in plan.results.items() if made[name] != sha256)
    bit_equal, mean_mm, max_mm = _difference(plan) if MOTION in differing else (True, 0.0, 0.0)
    return {
        "run_id": plan.run.run_id,
        "bit_equal": bit_equal,
        "mean_mm": mean_mm,
        "max_mm": max_mm,
        "same_environment": not plan.changed,
        "changed": list(plan.changed),
        "files_that_differ": [name for name in differing if name != MOTION or not bit_equal],
        "out": str(plan.out.resolve()),
    }


def _difference(plan: Plan) -> tuple[bool, float | None, float | None]:
    """Return whether all arrays are equal (files may be packed differently), and mean and largest distance [mm]."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            path = fetch_file(plan.run, MOTION, Path(folder))
            if path is None or sha256_of(path) != plan.results[MOTION]:
                return False, None, None
        except tracking.StoreLost:
            return False, None, None
        found = motion_difference(load_motion(path)[0], load_motion(plan.out / MOTION)[0])
    return found.bit_equal, found.mean_mm, found.max_mm


def _record(verdict: dict[str, Any]) -> None:
    """Add the verdict to the repetition's record; the result does not depend on it."""
    if verdict["mlflow_run_id"] is None:
        return
    try:
        with tracking.store_losses():
            run = tracking.open_run(verdict["mlflow_run_id"])
            numbers = {name: verdict[name] for name in ("bit_equal", "mean_mm", "max_mm")}
            tracking.log_histories(run, {f"rerun/{name}": [value] for name, value in numbers.items()})
            tracking.log_dict(run, verdict, VERDICT)
    except tracking.StoreLost as lost:
        progress.say(f"the comparison is not recorded in MLflow, the result itself is complete: {lost}")
