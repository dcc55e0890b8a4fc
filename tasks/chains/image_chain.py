"""From images to a fitted motion, its figures and its files: the steps of `hfb fit` and of `hfb.fit`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hfb.config import InitConfig, RunConfig
from hfb.evaluation.warnings import ResultWarning, check_front
from hfb.fitting.alternatives import what_is_unknown
from hfb.fitting.confidence import radius_condition
from hfb.fitting.direction_trust import direction_condition
from hfb.interop.writers.export_names import CURVES
from hfb.matting.exposure_match import describe_gains
from hfb.tasks.core.caller_parts import NO_PARTS, OwnParts, caller_parts
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FitHandle, PriorsHandle, ScoresHandle
from hfb.tasks.image.evaluate import evaluate
from hfb.tasks.image.first_body import first_body, given_body
from hfb.tasks.image.fit_motion import fit_motion
from hfb.tasks.image.fit_strip import strip
from hfb.tasks.image.matte import matte
from hfb.tasks.image.prepare import prepare
from hfb.tasks.inputs.given_networks import shade_networks, tell_networks
from hfb.tasks.inputs.inputs import Inputs, input_hashes
from hfb.tasks.results.exports import ShotHandle
from hfb.tasks.results.result_report import fit_curves
from hfb.tasks.results.result_warnings import input_warnings, look_for_warnings, tell
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking.fit_record import fit_record
from hfb.tasks.tracking.run_record import RunRecord
from hfb.tasks.video.external_poses import Look, body_of_result, read_result, require
from hfb.tasks.video.video_windows import mend_fronts


@dataclass(frozen=True)
class ImageFit:
    """A finished fit of one or several frames.

    Attributes:
        inputs: of the run.
        config: all options.
        scene: frames, plate, camera and times.
        firsts: first bodies of all frames.
        fitted: the motion, its texture and the mattes it used last.
        scores: figures of the fit.
        warnings: signs that it is wrong.
        strip: the image strip.
        curves: losses per iteration.
        own: parts of the caller's own.
    """

    inputs: Inputs
    config: RunConfig
    scene: ClipHandle
    firsts: tuple[FirstBodyHandle, ...]
    fitted: FitHandle
    scores: ScoresHandle
    warnings: tuple[ResultWarning, ...]
    strip: FileHandle
    curves: FileHandle
    own: OwnParts

    @property
    def shot(self) -> ShotHandle:
        """Everything that films are rendered from."""
        fitted, config = self.fitted, self.config.fit
        return ShotHandle(
            clip=self.scene, motion=fitted.motion, texture=fitted.texture, body=self.inputs.body, config=config
        )

    def files(self) -> dict[str, FileHandle]:
        """Return the files of the result by the names under which they are published."""
        fitted = self.fitted
        return {
            "motion.npz": fitted.motion,
            **({"alternatives.npz": fitted.alternatives} if fitted.alternatives else {}),
            "texture.png": fitted.texture_image,
            "strip.png": self.strip,
            CURVES: self.curves,
            **{f"matte_{index}.png": one for index, one in enumerate(fitted.mattes)},
        }

    def facts(self) -> dict[str, Any]:
        """Return result.json but for the result's place: scores, times, inputs and options."""
        fitted, sources = self.fitted, [first.source for first in self.firsts]
        directions = {"directions": direction_condition(sources)} if fitted.directions else {}
        return {
            **{name: value if math.isfinite(value) else None for name, value in self.scores.scores.items()},
            "fit_seconds": round(fitted.seconds, 3),
            "fit_stage_seconds": {name: round(seconds, 3) for name, seconds in fitted.stage_seconds.items()},
            "front": fitted.front.model_dump() if fitted.front else None,
            "directions": list(fitted.directions),
            "unknown": what_is_unknown(fitted.directions) if fitted.directions else None,
            "warnings": [one.model_dump(mode="json") for one in self.warnings],
            "confidence": radius_condition(sources) | directions,
            "mlflow_run_id": None,
            "mlflow_link": None,
            "first_bodies": sources,
            "pose_networks": [] if self.own.initializer else [file.path.name for file in self.inputs.networks],
            "exposure_gain": [list(frame.gain) for frame in self.scene.frames],
            "inputs": input_hashes(self.inputs),
            "config": self.config.model_dump(mode="json"),
            "code": code_version(),
            **({"own_parts": self.own.names()} if self.own != NO_PARTS else {}),
        }

    def record(
        self, published: Mapping[str, FileHandle], result: dict[str, Any], lacks: tuple[str, ...] = ()
    ) -> RunRecord:
        """Return the run's record.

        Args:
            published: the files of the result, by name.
            result: the content of result.json.
            lacks: see `hfb.tasks.tracking.recipe.Recipe`; functions of the caller's own come to it.
        """
        return fit_record(
            inputs=self.inputs,
            config=self.config,
            fit=self.fitted,
            scores=self.scores,
            published=published,
            result=result,
            lacks=(*lacks, *self.own.lacks()),
        )


def see_images(inputs: Inputs, config: RunConfig, folder: Path) -> tuple[ClipHandle, tuple[FileHandle, ...]]:
    """Check the images and estimate their mattes.

    Args:
        inputs: of the run.
        config: all options.
        folder: of intermediate files.

    Raises:
        InputError: the images do not fit together, or no person is found.
    """
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
    mattes = tuple(
        matte(
            clip=scene,
            index=index,
            config=config.matting,
            landmarks=config.init.landmarks,
            pose_networks=shade_networks(config.init, inputs.networks),
            # a start from the matte alone hangs on it
            quick=config.fit.matte_again and bool(shade_networks(config.init, inputs.networks)),
            folder=folder,
            network=inputs.matting,
        )
        for index in range(len(scene.frames))
    )
    return scene, mattes


def fit_images(inputs: Inputs, config: RunConfig, folder: Path) -> ImageFit:
    """Estimate mattes and first bodies, fit, evaluate and draw.

    Args:
        inputs: of the run.
        config: all options.
        folder: of intermediate files.

    Raises:
        InputError: an input cannot be used.
    """
    scene, mattes = see_images(inputs, config, folder)
    firsts = find_first_bodies(scene, mattes, inputs=inputs, config=config, folder=folder)
    numbers, body = tuple(range(len(scene.frames))), inputs.body
    fitted = fit_motion(
        clip=scene,
        mattes=mattes,
        first_bodies=firsts,
        body=body,
        priors=PriorsHandle(kind=config.prior.kind, pose=inputs.pose_prior, motion=inputs.motion_prior),
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
        clip=scene, numbers=numbers, mattes=mattes, motion=fitted.motion, matte_iou=(), body=body, config=config.fit
    ).warnings
    if fitted.front is not None:
        turns = dict.fromkeys(numbers, fitted.front.turn_deg)
        doubtful = check_front(dict.fromkeys(numbers, fitted.front.probability), turns)
        found = (*found, *([doubtful] if doubtful else []))
    tell(found)
    return ImageFit(
        inputs=inputs,
        config=config,
        scene=scene,
        firsts=firsts,
        fitted=fitted,
        scores=scores,
        warnings=(*input_warnings(scene.remarks, scene.plate_remarks), *found),
        strip=strip(clip=scene, fit=fitted, body=body, config=config.fit, folder=folder),
        curves=fit_curves(fitted, folder),
        own=caller_parts(),
    )


def estimate_bodies(
    scene: ClipHandle,
    mattes: tuple[FileHandle, ...],
    *,
    body: FileHandle | None,
    config: InitConfig,
    networks: tuple[FileHandle, ...],
    folder: Path,
) -> tuple[FirstBodyHandle, ...]:
    """Return one body per frame, consistent in front.

    Args:
        scene: all frames.
        mattes: of all frames.
        body: the user's body model; None for the embedded one.
        config: options of the first bodies.
        networks: the installed pose networks, or the user's own.
        folder: of intermediate files.

    Raises:
        InputError: no person was found.
    """
    numbers = tuple(range(len(scene.frames)))
    look = partial(first_body, clip=scene, mattes=mattes, body=body, config=config, networks=networks, folder=folder)
    firsts = tuple(look(index=index) for index in numbers)
    agreed = mend_fronts(numbers, firsts, folder).firsts if len(firsts) > 1 else firsts
    return tuple(one for one in agreed if one is not None)


def find_first_bodies(
    scene: ClipHandle,
    mattes: tuple[FileHandle, ...],
    *,
    inputs: Inputs,
    config: RunConfig,
    folder: Path,
) -> tuple[FirstBodyHandle, ...]:
    """Return one body per frame: given, from another system's result, or estimated and made consistent in front.

    Args:
        scene: all frames.
        mattes: of all frames.
        inputs: of the run.
        config: all options.
        folder: of intermediate files.

    Raises:
        InputError: no person was found, or the other system's result has no body for a frame.
    """
    if inputs.first_bodies:
        return tuple(given_body(file) for file in inputs.first_bodies)
    own = caller_parts().initializer is not None
    if own or not inputs.init_files:
        tell_networks(() if own else inputs.networks)
        return estimate_bodies(
            scene, mattes, body=inputs.body, config=config.init, networks=inputs.networks, folder=folder
        )
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
