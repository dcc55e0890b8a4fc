"""One blurred picture, or several of one static camera, to one moving body."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from prefect import flow

from flows.reaper import mark_owner
from flows.workplace import publish, workplace
from hfb.config import RunConfig
from hfb.export.names import CURVES, REPORT
from hfb.fit.alternatives import what_is_unknown
from hfb.fit.confidence import radius_condition
from tasks import progress, tracking
from tasks.evaluate import evaluate
from tasks.export_files import export_files
from tasks.films import films_of
from tasks.first_body import first_body, given_body
from tasks.fit_motion import fit_motion
from tasks.given_result import Look, body_of_result, needed, read_result
from tasks.handles import ClipHandle, FileHandle, FirstBodyHandle, FitHandle, PriorsHandle, ScoresHandle
from tasks.inputs import Inputs, input_hashes, take_inputs, with_height
from tasks.matte import matte
from tasks.prepare import prepare
from tasks.record import record
from tasks.result_records import records_in
from tasks.result_report import ReportParts, add_report, fit_curves, page_film, write_report
from tasks.strip import strip
from tasks.task import code_version


@flow(name="fit-image", persist_result=False, on_running=[mark_owner])
def fit_image(
    frames: list[Path],
    background: Path,
    out: Path,
    config: RunConfig,
    clip: Path | None = None,
    truth: Path | None = None,
    first_bodies: list[Path] | None = None,
) -> dict[str, Any]:
    """Matte, first body, fitted motion, evaluation, strip; recorded in MLflow, published in ``out``.

    Args:
        truth: a synthetic case's truth.npz; adds errors against it to the result.
        first_bodies: one first-body file per frame, instead of estimating them.

    Returns:
        the content of result.json.

    Raises:
        InputError: something given cannot be used; ``out`` is then as it was.
    """
    return _fitted(take_inputs(frames, background, config, clip, truth, first_bodies), out, config)


@flow(name="fit-image-again", persist_result=False, on_running=[mark_owner])
def fit_image_again(inputs: Inputs, out: Path, config: RunConfig) -> dict[str, Any]:
    """`fit_image` of what was taken before, such as the inputs of a recorded run."""
    return _fitted(inputs, out, config)


def _fitted(inputs: Inputs, out: Path, config: RunConfig) -> dict[str, Any]:
    config = with_height(config, inputs.clip)
    with workplace(out) as folder, records_in(folder):
        scene = prepare(inputs.frames, inputs.background, inputs.clip, config.camera, config.exposure)
        for remark in scene.remarks:
            progress.say(f"hfb: {remark}")
        numbers = range(len(scene.frames))
        mattes = tuple(matte(scene, index, config.matting, folder, inputs.matting) for index in numbers)
        if inputs.first_bodies:
            firsts = tuple(given_body(file) for file in inputs.first_bodies)
        elif inputs.init_files:
            first = config.init.frame
            looks = tuple(
                Look(matte=one, frame=None if first is None else first + number) for number, one in enumerate(mattes)
            )
            given = read_result(
                inputs.init_files, scene.height, scene.width, config.init.person, looks, inputs.body, folder
            )
            if whom := given.remark():
                progress.say(f"hfb: {whom}")
            firsts = tuple(
                needed(body_of_result(scene, index, number, mattes, given, inputs.body, folder))
                for index, number in enumerate(given.numbers_of(len(scene.frames), config.init.frame))
            )
        else:
            firsts = tuple(
                first_body(scene, index, mattes, inputs.body, config.init, inputs.networks, folder) for index in numbers
            )
        priors = PriorsHandle(kind=config.prior.kind, pose=inputs.pose_prior, motion=inputs.motion_prior)
        fitted = fit_motion(
            scene, mattes, firsts, inputs.body, priors, config.fit, config.seed, folder
        )  # fmt: skip
        scores = evaluate(scene, mattes, firsts, fitted, inputs.body, inputs.truth, config.fit, folder)
        picture = strip(scene, mattes, fitted, inputs.body, config.fit, folder)
        exports = export_files(fitted.motion, fitted.texture_picture, inputs.body, config.export, folder)
        films = films_of(scene, fitted.motion, fitted.texture, inputs.body, config, folder)
        result = _result(out, config, inputs, firsts, fitted, scores)
        files: dict[str, FileHandle] = {
            "motion.npz": fitted.motion, **({"alternatives.npz": fitted.alternatives} if fitted.alternatives else {}),
            "texture.png": fitted.texture_picture, "strip.png": picture, CURVES: fit_curves(fitted, folder),
            **{f"matte_{index}.png": one for index, one in enumerate(mattes)}, **exports.by_name(),
            **films.by_name(),
        }  # fmt: skip
        try:
            run = record(inputs, config, mattes, fitted, scores, picture, files, result)
            result |= {"mlflow_run_id": run.run_id, "mlflow_link": run.link}
        except tracking.StoreLost as lost:
            progress.say(f"not recorded in MLflow, the result itself is complete: {lost}")
        if config.export.report:
            files[REPORT] = _reported(scene, fitted, files, inputs, config, result, folder)
        publish(out, {name: file.path for name, file in files.items()}, result)
    return result


def _reported(
    scene: ClipHandle,
    fitted: FitHandle,
    files: dict[str, FileHandle],
    inputs: Inputs,
    config: RunConfig,
    result: dict[str, Any],
    folder: Path,
) -> FileHandle:
    """The page, in MLflow too where the run is there."""
    film = page_film(scene, fitted.motion, fitted.texture, inputs.body, config.fit, folder)
    parts = ReportParts(
        motion=fitted.motion, curves=files[CURVES], body=inputs.body, texture=fitted.texture_picture,
        strip=files["strip.png"], alternatives=fitted.alternatives, film=film,
    )  # fmt: skip
    page = write_report(parts, result, folder)
    add_report(result["mlflow_run_id"], page)
    return page


def _result(
    out: Path,
    config: RunConfig,
    inputs: Inputs,
    firsts: tuple[FirstBodyHandle, ...],
    fitted: FitHandle,
    scores: ScoresHandle,
) -> dict[str, Any]:
    """result.json: scores and times, where things are, and what they were made from."""
    return {
        **{name: value if math.isfinite(value) else None for name, value in scores.scores.items()},
        "fit_seconds": round(fitted.seconds, 3),
        "directions": list(fitted.directions),
        "unknown": what_is_unknown(fitted.directions) if fitted.directions else None,
        "confidence": radius_condition([first.source for first in firsts]),
        "out": str(out.resolve()),
        "strip": str(out.resolve() / "strip.png"),
        "report": str(out.resolve() / REPORT) if config.export.report else None,
        "mlflow_run_id": None,
        "mlflow_link": None,
        "first_bodies": [first.source for first in firsts],
        "inputs": input_hashes(inputs),
        "config": config.model_dump(mode="json"),
        "code": code_version(),
    }
