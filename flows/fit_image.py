"""One blurred picture, or several of one static camera, to one moving body."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from prefect import flow

from hfb.config import RunConfig
from hfb.evaluation.warnings import ResultWarning
from hfb.fitting.alternatives import what_is_unknown
from hfb.fitting.confidence import radius_condition
from hfb.flows.runtime.reaper import mark_owner
from hfb.flows.runtime.workplace import publish, workplace
from hfb.interop.writers.names import CURVES, RECORD, REPORT
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FitHandle, PriorsHandle, ScoresHandle
from hfb.tasks.core.result_records import records_in
from hfb.tasks.core.task import code_version
from hfb.tasks.image.evaluate import evaluate
from hfb.tasks.image.first_body import first_body, given_body
from hfb.tasks.image.fit_motion import fit_motion
from hfb.tasks.image.matte import matte
from hfb.tasks.image.prepare import prepare
from hfb.tasks.image.strip import strip
from hfb.tasks.inputs.given_networks import tell_networks
from hfb.tasks.inputs.inputs import Inputs, input_hashes, take_inputs, with_height
from hfb.tasks.results.export_files import export_files
from hfb.tasks.results.films import films_of
from hfb.tasks.results.result_report import ReportParts, add_report, fit_curves, page_film, write_report
from hfb.tasks.results.result_warnings import look_for_warnings, plate_warnings, tell
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.record import fit_record, record
from hfb.tasks.tracking.run_record import keep_for_later
from hfb.tasks.video.given_result import Look, body_of_result, needed, read_result
from hfb.tasks.video.video_windows import mend_fronts


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
    return _fitted(take_inputs(frames, background, config, clip, truth, first_bodies, out), out, config)


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
        firsts = _first_bodies(scene, mattes, inputs, config, folder)
        priors = PriorsHandle(kind=config.prior.kind, pose=inputs.pose_prior, motion=inputs.motion_prior)
        fitted = fit_motion(
            scene, mattes, firsts, inputs.body, priors, config.fit, config.seed, folder
        )  # fmt: skip
        scores = evaluate(scene, mattes, firsts, fitted, inputs.body, inputs.truth, config.fit, folder)
        # Warnings compare with the mattes of before the fit: refined ones share its errors.
        found = look_for_warnings(scene, tuple(numbers), mattes, fitted.motion, (), inputs.body, config.fit).warnings
        tell(found)
        picture = strip(scene, fitted, inputs.body, config.fit, folder)
        exports = export_files(fitted.motion, fitted.texture_picture, inputs.body, config.export, folder)
        films = films_of(scene, fitted.motion, fitted.texture, inputs.body, config, folder)
        warnings = (*plate_warnings(scene.remarks), *found)
        result = _result(out, config, inputs, firsts, fitted, scores, warnings)
        files: dict[str, FileHandle] = {
            "motion.npz": fitted.motion, **({"alternatives.npz": fitted.alternatives} if fitted.alternatives else {}),
            "texture.png": fitted.texture_picture, "strip.png": picture, CURVES: fit_curves(fitted, folder),
            **{f"matte_{index}.png": one for index, one in enumerate(fitted.mattes)}, **exports.by_name(),
            **films.by_name(),
        }  # fmt: skip
        of_run = fit_record(inputs, config, fitted, scores, files, result)
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
            files[REPORT] = _reported(scene, fitted, files, inputs, config, result, folder)
        publish(out, {name: file.path for name, file in files.items()}, result)
    return result


def _first_bodies(
    scene: ClipHandle, mattes: tuple[FileHandle, ...], inputs: Inputs, config: RunConfig, folder: Path
) -> tuple[FirstBodyHandle, ...]:
    """One per frame: given, out of another system's result, or estimated and agreed on one front."""
    if inputs.first_bodies:
        return tuple(given_body(file) for file in inputs.first_bodies)
    numbers = tuple(range(len(scene.frames)))
    if not inputs.init_files:
        tell_networks(inputs.networks)
        firsts = tuple(
            first_body(scene, index, mattes, inputs.body, config.init, inputs.networks, folder) for index in numbers
        )
        agreed = mend_fronts(numbers, firsts, folder).firsts if len(firsts) > 1 else firsts
        return tuple(one for one in agreed if one is not None)
    first = config.init.frame
    looks = tuple(Look(matte=one, frame=None if first is None else first + n) for n, one in enumerate(mattes))
    pictures = tuple(file.path.name for file in inputs.frames) if first is None else ()
    size = scene.height, scene.width
    given = read_result(inputs.init_files, *size, config.init.person, looks, inputs.body, pictures, 0, folder)
    if whom := given.remark():
        progress.say(f"hfb: {whom}")
    return tuple(
        needed(body_of_result(scene, index, number, mattes, given, inputs.body, folder))
        for index, number in enumerate(given.numbers_of(len(scene.frames), first))
    )


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
    warnings: tuple[ResultWarning, ...],
) -> dict[str, Any]:
    """result.json: scores and times, where things are, and what they were made from."""
    return {
        **{name: value if math.isfinite(value) else None for name, value in scores.scores.items()},
        "fit_seconds": round(fitted.seconds, 3),
        "fit_stage_seconds": {name: round(seconds, 3) for name, seconds in fitted.stage_seconds.items()},
        "directions": list(fitted.directions),
        "unknown": what_is_unknown(fitted.directions) if fitted.directions else None,
        "warnings": [one.model_dump(mode="json") for one in warnings],
        "confidence": radius_condition([first.source for first in firsts]),
        "out": str(out.resolve()),
        "strip": str(out.resolve() / "strip.png"),
        "report": str(out.resolve() / REPORT) if config.export.report else None,
        "mlflow_run_id": None,
        "mlflow_link": None,
        "first_bodies": [first.source for first in firsts],
        "pose_networks": [file.path.name for file in inputs.networks],
        "inputs": input_hashes(inputs),
        "config": config.model_dump(mode="json"),
        "code": code_version(),
    }
