"""Fit one blurred image, or several of one static camera; and the embedded example."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.datasets.example import write_example
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.interop.writers.export_names import RECORD, REPORT
from hfb.io.safe_folder import check_tree
from hfb.tasks.chains.image_chain import fit_images
from hfb.tasks.core.result_records import records_in
from hfb.tasks.inputs.inputs import Inputs, take_inputs, with_height
from hfb.tasks.results.exports import export_motion
from hfb.tasks.results.result_report import ReportParts, add_report, film_beside, write_report
from hfb.tasks.results.workspace import publish, workspace
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.fit_record import record
from hfb.tasks.tracking.run_record import keep_for_later


@recorded_flow("fit-image")
def fit_image(
    frames: list[Path],
    background: Path,
    out: Path,
    config: RunConfig,
    *,
    clip: Path | None = None,
    truth: Path | None = None,
    first_bodies: list[Path] | None = None,
) -> dict[str, Any]:
    """Estimate mattes and first bodies, fit, evaluate and draw; recorded in MLflow, published in ``out``.

    Args:
        frames: blurred images, in their order.
        background: the same view without the person.
        out: where the results go.
        config: all options.
        clip: a clip.toml.
        truth: a synthetic case's truth.npz; adds errors against it to the result.
        first_bodies: one first-body file per frame, instead of estimating them.

    Returns:
        the content of result.json.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
    """
    return _run_chain(
        take_inputs(frames, background, config, clip, truth=truth, first_bodies=first_bodies, out=out), out, config
    )


@recorded_flow("fit-image-again")
def fit_image_again(inputs: Inputs, out: Path, config: RunConfig) -> dict[str, Any]:
    """Run `fit_image` on inputs taken before, such as those of a recorded run.

    Args:
        inputs: with their hashes.
        out: where the results go.
        config: all options.
    """
    return _run_chain(inputs, out, config)


def _run_chain(inputs: Inputs, out: Path, config: RunConfig) -> dict[str, Any]:
    config, began_ms = with_height(config, inputs.clip), time.time_ns() // 1_000_000
    with workspace(out) as folder, records_in(folder):
        fit = fit_images(inputs, config, folder)
        with film_beside(fit.shot, config.export, folder) as page_film:
            exports = export_motion(fit.shot, fit.fitted.texture_image, config.export, folder)
        result = fit.facts() | {
            **exports.facts(),
            "out": str(out.resolve()),
            "strip": str(out.resolve() / "strip.png"),
            "report": str(out.resolve() / REPORT) if config.export.report else None,
        }
        files = fit.files() | exports.by_name()
        of_run = fit.record(files, result).model_copy(update={"began_ms": began_ms})
        try:
            run = record(of_run, files)
            result |= {"mlflow_run_id": run.run_id, "mlflow_link": run.link}
        except tracking.StoreLost as lost:
            files[RECORD] = keep_for_later(of_run, folder)
            progress.say(
                f"not recorded in MLflow ({lost}): the result itself is complete; `hfb record {out}` records it "
                "when MLflow is back"
            )
        if config.export.report:
            parts = ReportParts.among(files, page_film.result(), inputs.body)
            files[REPORT] = write_report(parts, result, folder)
            add_report(result["mlflow_run_id"], files[REPORT])
        publish(out, {name: file.path for name, file in files.items()}, result)
    return result


_EXAMPLE = "example"


def fit_example(out: Path, config: RunConfig, ready: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Make the example in ``out/example``, then fit it; the result holds the errors against its truth.

    The first body is found from the matte alone, whether or not pose networks are installed: everyone gets the same
    figures, and the networks were not trained on rendered bodies.

    Args:
        out: where the results go.
        config: all options.
        ready: called before the flow; returns when Prefect's server answers.
    """
    if config.init.method == "auto":
        config = config.model_copy(update={"init": config.init.model_copy(update={"method": "matte"})})
    check_tree(out, _EXAMPLE)
    with progress.step("example"):
        paths = write_example(out / _EXAMPLE, config.seed)
    ready()
    return fit_image([paths.frame], paths.background, out, config, truth=paths.truth)
