"""From a clip to its motion, its figures and its files: the steps of `hfb video` and of `hfb.fit_clip`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.evaluation.warnings import ResultWarning
from hfb.fitting.confidence import radius_condition
from hfb.interop.writers.export_names import CURVES
from hfb.tasks.chains.clip_scores import draw, score, warn
from hfb.tasks.chains.clip_steps import Fitted, Scene, find_first_bodies, fit_windows, join, see
from hfb.tasks.core.caller_parts import NO_PARTS, OwnParts, caller_parts
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.video_handles import ClipBodiesHandle, JoinedHandle
from hfb.tasks.inputs.video_inputs import VideoInputs, video_hashes
from hfb.tasks.results.exports import ShotHandle
from hfb.tasks.results.result_report import clip_curves
from hfb.tasks.tracking.run_record import RunRecord
from hfb.tasks.tracking.video_record import clip_record
from hfb.tasks.video.video_look import draw_texture

_SEEN, _FILLED, _GAP = 1.0, 0.5, 0.0


@dataclass(frozen=True)
class ClipFit:
    """A finished fit of a clip.

    Attributes:
        scene: frames, plate, mattes and times.
        bodies: first bodies of all frames.
        fitted: the windows and the person.
        joined: the motion.
        points: figure -> values by frame.
        warnings: signs that the motion is wrong.
        texture: of the person.
        strip: the image strip.
        curves: losses per iteration, figures per frame.
        seconds: wall time.
        own: parts of the caller's own.
    """

    scene: Scene
    bodies: ClipBodiesHandle
    fitted: Fitted
    joined: JoinedHandle
    points: Mapping[str, Mapping[int, float]]
    warnings: tuple[ResultWarning, ...]
    texture: FileHandle
    strip: FileHandle
    curves: FileHandle
    seconds: float
    own: OwnParts

    @property
    def inputs(self) -> VideoInputs:
        """Inputs of the run."""
        return self.scene.inputs

    @property
    def shot(self) -> ShotHandle:
        """Everything that films are rendered from."""
        return self.scene.shot(self.joined.motion, self.fitted.person)

    def files(self) -> dict[str, FileHandle]:
        """Return the files of the result by the names under which they are published."""
        return {
            "motion.npz": self.joined.motion,
            CURVES: self.curves,
            "edges.json": self.joined.edges,
            "texture.png": self.texture,
            "strip.png": self.strip,
        }

    def facts(self) -> dict[str, Any]:
        """Return result.json but for the result's place: scores, gaps, inputs and options."""
        scene, bodies, fitted, joined = self.scene, self.bodies, self.fitted, self.joined
        scores = {
            name.removeprefix("eval/"): _mean(one) for name, one in self.points.items() if name.startswith("eval/")
        }
        return {
            "frames": scene.footage.count,
            "sub_frames": joined.rows,
            "gaps": [list(gap) for gap in joined.gaps],
            "filled": _filled(bodies, joined),
            "missed": [{"frame": number, "reason": reason} for number, reason in bodies.reasons.items()],
            "windows": len(fitted.windows),
            "resumed_frames": len(fitted.resumed),
            "fronts": [{"segment": segment, **front.model_dump()} for segment, front in fitted.fronts.items()],
            **scores,
            "confidence": radius_condition([first.source for first in bodies.firsts if first is not None]),
            "worst_jump_mm": joined.worst_jump_mm,
            "worst_velocity_share": joined.worst_velocity_share,
            "warnings": [one.model_dump(mode="json") for one in self.warnings],
            "seconds": round(self.seconds, 3),
            "mlflow_run_id": None,
            "mlflow_link": None,
            "pose_networks": [] if self.own.initializer else [file.path.name for file in self.inputs.networks],
            "background": scene.plate.source,
            "exposure_gain": [list(frame.gain) for frame in scene.frames],
            "remarks": list(scene.footage.remarks),
            "inputs": video_hashes(self.inputs),
            "config": scene.config.model_dump(mode="json"),
            "code": code_version(),
            **({"own_parts": self.own.names()} if self.own != NO_PARTS else {}),
        }

    def record(self, published: Mapping[str, FileHandle], result: dict[str, Any], lacks: tuple[str, ...]) -> RunRecord:
        """Return the run's record.

        Args:
            published: the files of the result, by name.
            result: the content of result.json.
            lacks: see `hfb.tasks.tracking.recipe.Recipe`; functions of the caller's own come to it.
        """
        return clip_record(
            self.inputs,
            self.scene.config,
            points=self.points,
            files=published,
            result=result,
            lacks=(*lacks, *self.own.lacks()),
        )


def fit_clip(
    inputs: VideoInputs,
    config: RunConfig,
    folder: Path,
    *,
    look: Callable[[], None] = lambda: None,
    on_values: Callable[[str, Mapping[int, float]], None] = lambda name, values: None,
) -> ClipFit:
    """Estimate mattes and first bodies, fit windows, join them, evaluate and draw.

    Args:
        inputs: of the run.
        config: all options.
        folder: of intermediate files.
        look: called after each result of a mapped task; what it raises ends the chain.
        on_values: called with a figure and its values by frame as soon as they are known.

    Raises:
        InputError: an input cannot be used.
    """
    began, points = time.perf_counter(), dict[str, dict[int, float]]()

    def know(name: str, values: Mapping[int, float]) -> None:
        points.setdefault(name, {}).update(values)
        on_values(name, values)

    scene = see(inputs, config, folder, look)
    bodies = find_first_bodies(scene)
    fitted = fit_windows(scene, bodies, lambda frames, loss: know("fit/loss", dict.fromkeys(frames, loss)))
    joined = join(scene, fitted)
    know("frame/seen", _seen(bodies, joined))
    scores = score(scene, fitted, joined)
    for name, values in scores.items():
        know(f"eval/{name}", values)
    warnings = warn(scene, fitted, joined, scores.get("matte_iou", {}))
    return ClipFit(
        scene=scene,
        bodies=bodies,
        fitted=fitted,
        joined=joined,
        points=points,
        warnings=tuple(warnings),
        texture=draw_texture(scene.footage.light, fitted.person, folder),
        strip=draw(scene, fitted, joined),
        curves=clip_curves(fitted.windows, _pairs(scores), folder),
        seconds=time.perf_counter() - began,
        own=caller_parts(),
    )


def _filled(bodies: ClipBodiesHandle, joined: JoinedHandle) -> list[int]:
    return sorted({number for number, filled in enumerate(bodies.filled) if filled} | set(joined.bridged))


def _seen(bodies: ClipBodiesHandle, joined: JoinedHandle) -> dict[int, float]:
    """Return per frame of the clip whether it was seen (1), filled from its neighbours (0.5), or a gap (0)."""
    filled, pairs = _filled(bodies, joined), enumerate(bodies.usable)
    return {number: _FILLED if number in filled else _SEEN if usable else _GAP for number, usable in pairs}


def _pairs(scores: Mapping[str, Mapping[int, float]]) -> dict[str, tuple[tuple[int, float], ...]]:
    """Return the known scores as (frame, value) pairs."""
    return {
        name: tuple((number, value) for number, value in sorted(values.items()) if math.isfinite(value))
        for name, values in scores.items()
    }


def _mean(values: Mapping[int, float]) -> float | None:
    finite = [value for value in values.values() if math.isfinite(value)]
    return sum(finite) / len(finite) if finite else None
