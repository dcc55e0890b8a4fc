"""The MLflow run of a fit: inputs, history and results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.interop.writers.export_names import CURVES, EXPORTED_NAMES, RESULT
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle, FitHandle, ScoresHandle, digest
from hfb.tasks.inputs.inputs import Inputs, input_hashes
from hfb.tasks.task import task
from hfb.tasks.tracking.recipe import COMMAND_TAG, RECIPE, recipe
from hfb.tasks.tracking.run_record import RecordedFile, RunHandle, RunRecord, describe_run, write_run

_ARTIFACTS = ("strip.png", "motion.npz", "texture.png", "alternatives.npz", CURVES, *EXPORTED_NAMES)
_MATTE = "matte_"


@task("record in MLflow", cached=False)
def record(of_run: RunRecord, files: dict[str, FileHandle]) -> RunHandle:
    """Find or create a run, and log everything into it.

    Args:
        of_run: the record.
        files: the files that the run leaves, by name.

    Raises:
        hfb.tasks.tracking.tracking.StoreLost: the store cannot be reached; the result itself does not depend on it.
    """
    return write_run(of_run, {name: file.path for name, file in files.items()})


def fit_record(
    *,
    inputs: Inputs,
    config: RunConfig,
    fit: FitHandle,
    scores: ScoresHandle,
    published: Mapping[str, FileHandle],
    result: dict[str, Any],
    lacks: tuple[str, ...] = (),
) -> RunRecord:
    """Return the record of a fit, identified by its inputs, its options and the code.

    Args:
        inputs: of the run.
        config: all options.
        fit: the motion.
        scores: of the motion.
        published: the files of the result, by name.
        result: the content of result.json.
        lacks: see `hfb.tasks.tracking.recipe.Recipe`.
    """
    options = config.model_dump(mode="json")
    params = {**options, "input": input_hashes(inputs), "clip": inputs.clip.model_dump(mode="json")}
    if own := result.get("own_parts"):  # functions have no hash: what they lead to tells runs apart
        params |= {"own_parts": own, "motion": fit.motion.sha256}
    histories: dict[str, list[float | None]] = json.loads(fit.history.path.read_text())
    points = {
        f"loss/{term}": {step: float(value) for step, value in enumerate(values) if value is not None}
        for term, values in histories.items()
    }
    points |= {f"eval/{name}": {0: float(value)} for name, value in scores.scores.items()}
    points |= {f"warning/{one['code']}": {0: float(one["value"])} for one in result["warnings"]}
    points |= {f"time/fit_{stage}_s": {0: seconds} for stage, seconds in fit.stage_seconds.items()}
    points |= {"time/fit_s": {0: fit.seconds}, "fit/best_iteration": {0: float(fit.best_iteration)}}
    files = {
        name: RecordedFile(sha256=file.sha256, folder="mattes" if name.startswith(_MATTE) else None)
        for name, file in published.items()
        if name in _ARTIFACTS or name.startswith(_MATTE)
    }
    made_of = recipe("fit", config, inputs, published, code=code_version(), lacks=lacks)
    return RunRecord(
        name=Path(result["out"]).name,
        key=digest([params, code_version()]),
        params=params,
        tags={"code": code_version(), "seed": str(config.seed), "preset": config.preset, COMMAND_TAG: "fit"},
        points=points,
        files=files,
        description=describe_run("fit", config, result),
        contents={RESULT: dict(result), "config.json": options, RECIPE: made_of.model_dump(mode="json")},
    )
