"""Fit one blurred image, or several of one static camera; and the embedded example."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.datasets.example import write_example
from hfb.evaluation.warnings import ResultWarning, check_front
from hfb.fitting.alternatives import what_is_unknown
from hfb.fitting.confidence import radius_condition
from hfb.fitting.direction_trust import direction_condition
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.flows.runtime.workspace import publish, workspace
from hfb.interop.writers.export_names import CURVES, RECORD, REPORT
from hfb.io.safe_folder import check_tree
from hfb.matting.exposure_match import describe_gains
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FitHandle, PriorsHandle, ScoresHandle
from hfb.tasks.core.result_records import records_in
from hfb.tasks.image.evaluate import evaluate
from hfb.tasks.image.first_body import first_body, given_body
from hfb.tasks.image.fit_motion import fit_motion
from hfb.tasks.image.fit_strip import strip
from hfb.tasks.image.matte import matte
from hfb.tasks.image.prepare import prepare
from hfb.tasks.inputs.given_networks import shade_networks, tell_networks
from hfb.tasks.inputs.inputs import Inputs, input_hashes, take_inputs, with_height
from hfb.tasks.results.exports import ShotHandle, export_motion
from hfb.tasks.results.result_report import ReportParts, add_report, draw_page_film, fit_curves, write_report
from hfb.tasks.results.result_warnings import look_for_warnings, plate_warnings, tell
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.fit_record import fit_record, record
from hfb.tasks.tracking.run_record import keep_for_later
from hfb.tasks.video.external_poses import Look, body_of_result, read_result, require
from hfb.tasks.video.video_windows import mend_fronts


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
    config = with_height(config, inputs.clip)
    with workspace(out) as folder, records_in(folder):
        scene = prepare(
            frames=inputs.frames,
            background=inputs.background,
            clip=inputs.clip,
            camera=config.camera,
            exposure=config.exposure,
        )
        for remark in scene.remarks:
            progress.say(f"hfb: {remark}")
        if exposures := describe_gains([frame.gain for frame in scene.frames]):
            progress.say(f"hfb: {exposures}")
        numbers, body = range(len(scene.frames)), inputs.body
        mattes = tuple(
            matte(
                clip=scene,
                index=index,
                config=config.matting,
                landmarks=config.init.landmarks,
                pose_networks=shade_networks(config.init, inputs.networks),
                folder=folder,
                network=inputs.matting,
            )
            for index in numbers
        )
        firsts = _first_bodies(scene, mattes, inputs=inputs, config=config, folder=folder)
        priors = PriorsHandle(kind=config.prior.kind, pose=inputs.pose_prior, motion=inputs.motion_prior)
        fitted = fit_motion(
            clip=scene,
            mattes=mattes,
            first_bodies=firsts,
            body=body,
            priors=priors,
            config=config.fit,
            seed=config.seed,
            folder=folder,
        )
        scores = evaluate(
            clip=scene,
            mattes=mattes,
            first_bodies=firsts,
            fit=fitted,
            body=body,
            truth=inputs.truth,
            config=config.fit,
            folder=folder,
        )
        # Warnings compare with the mattes of before the fit: refined ones share its errors.
        found = look_for_warnings(
            clip=scene,
            numbers=tuple(numbers),
            mattes=mattes,
            motion=fitted.motion,
            matte_iou=(),
            body=body,
            config=config.fit,
        ).warnings
        if fitted.front is not None:
            turns = dict.fromkeys(numbers, fitted.front.turn_deg)
            doubtful = check_front(dict.fromkeys(numbers, fitted.front.probability), turns)
            found = (*found, *([doubtful] if doubtful else []))
        tell(found)
        image = strip(clip=scene, fit=fitted, body=body, config=config.fit, folder=folder)
        shot = ShotHandle(clip=scene, motion=fitted.motion, texture=fitted.texture, body=body, config=config.fit)
        exports = export_motion(shot, fitted.texture_image, config.export, folder)
        warnings = (*plate_warnings(scene.remarks), *found)
        result = _result(
            out=out,
            config=config,
            inputs=inputs,
            scene=scene,
            firsts=firsts,
            fitted=fitted,
            scores=scores,
            warnings=warnings,
        )
        files: dict[str, FileHandle] = {
            "motion.npz": fitted.motion,
            **({"alternatives.npz": fitted.alternatives} if fitted.alternatives else {}),
            "texture.png": fitted.texture_image,
            "strip.png": image,
            CURVES: fit_curves(fitted, folder),
            **{f"matte_{index}.png": one for index, one in enumerate(fitted.mattes)},
            **exports.by_name(),
        }
        of_run = fit_record(inputs=inputs, config=config, fit=fitted, scores=scores, published=files, result=result)
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
            parts = ReportParts(
                motion=fitted.motion,
                curves=files[CURVES],
                body=body,
                texture=fitted.texture_image,
                strip=image,
                alternatives=fitted.alternatives,
                film=draw_page_film(shot, folder),
            )
            files[REPORT] = write_report(parts, result, folder)
            add_report(result["mlflow_run_id"], files[REPORT])
        publish(out, {name: file.path for name, file in files.items()}, result)
    return result


def _first_bodies(
    scene: ClipHandle, mattes: tuple[FileHandle, ...], *, inputs: Inputs, config: RunConfig, folder: Path
) -> tuple[FirstBodyHandle, ...]:
    """Return one body per frame: given, from another system's result, or estimated and made consistent in front."""
    if inputs.first_bodies:
        return tuple(given_body(file) for file in inputs.first_bodies)
    numbers = tuple(range(len(scene.frames)))
    if not inputs.init_files:
        tell_networks(inputs.networks)
        firsts = tuple(
            first_body(
                clip=scene,
                index=index,
                mattes=mattes,
                body=inputs.body,
                config=config.init,
                networks=inputs.networks,
                folder=folder,
            )
            for index in numbers
        )
        agreed = mend_fronts(numbers, firsts, folder).firsts if len(firsts) > 1 else firsts
        return tuple(one for one in agreed if one is not None)
    first = config.init.frame
    looks = tuple(Look(matte=one, frame=None if first is None else first + n) for n, one in enumerate(mattes))
    pictures = tuple(file.path.name for file in inputs.frames) if first is None else ()
    external = read_result(
        files=inputs.init_files,
        height=scene.height,
        width=scene.width,
        person=config.init.person,
        looks=looks,
        body=inputs.body,
        pictures=pictures,
        frames=0,
        folder=folder,
    )
    if whom := external.remark():
        progress.say(f"hfb: {whom}")
    return tuple(
        require(
            body_of_result(
                clip=scene, index=index, number=number, mattes=mattes, result=external, body=inputs.body, folder=folder
            )
        )
        for index, number in enumerate(external.numbers_of(len(scene.frames), first))
    )


def _result(
    *,
    out: Path,
    config: RunConfig,
    inputs: Inputs,
    scene: ClipHandle,
    firsts: tuple[FirstBodyHandle, ...],
    fitted: FitHandle,
    scores: ScoresHandle,
    warnings: tuple[ResultWarning, ...],
) -> dict[str, Any]:
    """Return result.json: scores, times, places of files, inputs and options."""
    sources = [first.source for first in firsts]
    directions = {"directions": direction_condition(sources)} if fitted.directions else {}
    return {
        **{name: value if math.isfinite(value) else None for name, value in scores.scores.items()},
        "fit_seconds": round(fitted.seconds, 3),
        "fit_stage_seconds": {name: round(seconds, 3) for name, seconds in fitted.stage_seconds.items()},
        "front": fitted.front.model_dump() if fitted.front else None,
        "directions": list(fitted.directions),
        "unknown": what_is_unknown(fitted.directions) if fitted.directions else None,
        "warnings": [one.model_dump(mode="json") for one in warnings],
        "confidence": radius_condition(sources) | directions,
        "out": str(out.resolve()),
        "strip": str(out.resolve() / "strip.png"),
        "report": str(out.resolve() / REPORT) if config.export.report else None,
        "mlflow_run_id": None,
        "mlflow_link": None,
        "first_bodies": sources,
        "pose_networks": [file.path.name for file in inputs.networks],
        "exposure_gain": [list(frame.gain) for frame in scene.frames],
        "inputs": input_hashes(inputs),
        "config": config.model_dump(mode="json"),
        "code": code_version(),
    }


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
