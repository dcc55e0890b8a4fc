"""The run in MLflow: what went in, how it went, what came out."""

import json
from pathlib import Path
from typing import Any

from hfb.config import Record, RunConfig
from hfb.export.names import CURVES, EXPORTED_NAMES
from tasks import tracking
from tasks.handles import FileHandle, FitHandle, ScoresHandle, digest
from tasks.inputs import Inputs, input_hashes
from tasks.recipe import COMMAND_TAG, RECIPE, recipe
from tasks.task import code_version, task


class RunHandle(Record):
    """A recorded run."""

    run_id: str
    link: str


@task("record in MLflow", cached=False)
def record(
    inputs: Inputs,
    config: RunConfig,
    mattes: tuple[FileHandle, ...],
    fit: FitHandle,
    scores: ScoresHandle,
    strip: FileHandle,
    published: dict[str, FileHandle],
    result: dict[str, Any],
) -> RunHandle:
    """Find or create the run of these inputs, options and code, and log everything into it.

    Args:
        published: the files that the run leaves, by name.

    Raises:
        tracking.StoreLost: the store cannot be reached; the result itself does not depend on it.
    """
    params = {
        **config.model_dump(mode="json"),
        "input": input_hashes(inputs),
        "clip": inputs.clip.model_dump(mode="json"),
    }
    key = digest([params, code_version()])
    histories = {f"loss/{term}": values for term, values in json.loads(fit.history.path.read_text()).items()}
    final = {f"eval/{name}": [value] for name, value in scores.scores.items()}
    final |= {f"warning/{one['code']}": [one["value"]] for one in result["warnings"]}
    alternatives = [fit.alternatives.path] if fit.alternatives else []
    exports = [published[name].path for name in (CURVES, *EXPORTED_NAMES) if name in published]
    timing = {"time/fit_s": [fit.seconds], "fit/best_iteration": [fit.best_iteration]}
    tags = {"code": code_version(), "seed": str(config.seed), "preset": config.preset, COMMAND_TAG: "fit"}
    made_of = recipe("fit", config, inputs, published, code_version())
    with tracking.recorded_run(Path(result["out"]).name, key, params, tags) as run:
        if not run.complete:
            tracking.log_histories(run, histories | final | timing)
            tracking.log_files(run, [strip.path, fit.motion.path, fit.texture_picture.path, *alternatives, *exports])
            tracking.log_files(run, [matte.path for matte in mattes], folder="mattes")
            tracking.log_dict(run, result, "result.json")
            tracking.log_dict(run, config.model_dump(mode="json"), "config.json")
            tracking.log_dict(run, made_of.model_dump(mode="json"), RECIPE)
        return RunHandle(run_id=run.run_id, link=tracking.link(run))
