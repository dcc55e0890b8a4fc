"""Fit a blurred video, or a folder of its frames, to one continuous motion."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from prefect.task_runners import ThreadPoolTaskRunner

from hfb.config import RunConfig
from hfb.fitting.confidence import radius_condition
from hfb.flows.clip_scores import draw, score, warn
from hfb.flows.clip_steps import Fitted, Scene, find_first_bodies, fit_windows, join, see
from hfb.flows.runtime.failures import ask_server, explain_failures
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.interop.writers.export_names import CURVES, RECORD, REPORT
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.result_records import records_in
from hfb.tasks.core.video_handles import ClipBodiesHandle, JoinedHandle
from hfb.tasks.inputs.inputs import with_height
from hfb.tasks.inputs.video_inputs import VideoInputs, video_hashes
from hfb.tasks.results.exports import export_motion
from hfb.tasks.results.result_report import ReportParts, add_report, clip_curves, draw_page_film, write_report
from hfb.tasks.results.workspace import publish, workspace
from hfb.tasks.tracking.video_record import ClipRecord
from hfb.tasks.video.video_look import draw_texture
from hfb.tasks.workers.engine import Engine
from hfb.tasks.workers.workers import busy_share, worker_count, workers

_SPARE_THREADS = 2  # tasks that are being checked and looked up while all workers compute
_SEEN, _FILLED, _GAP = 1.0, 0.5, 0.0


def run_video(inputs: VideoInputs, out: Path, config: RunConfig, engine: Engine | int) -> dict[str, Any]:
    """Fit a clip to one motion for all its frames; recorded in MLflow, published in ``out``.

    One task per frame for its matte and its first body, one per window for its fit. Finished steps are cached in
    ``out``: the same call continues from them, also after a kill. The engine does not change the result.

    Args:
        inputs: of the run.
        out: where the results go.
        config: all options.
        engine: where computations run.

    Returns:
        the content of result.json.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
        InfrastructureError: the disk is full, or Prefect's server went away; what is finished is kept.
    """
    config = with_height(config, inputs.clip)

    # A closure: as parameters Prefect would send a folder's pictures to its server, which takes half a megabyte.
    def video(clip: str, out_folder: str) -> dict[str, Any]:
        return _motion_of(inputs, out, folder, config)

    with clip_place(out, engine) as folder:
        threads: Any = ThreadPoolTaskRunner(max_workers=worker_count() + _SPARE_THREADS)
        made = recorded_flow("video", task_runner=threads)(video)
        return made(str(inputs.video[0].path), str(out))


def _motion_of(inputs: VideoInputs, out: Path, folder: Path, config: RunConfig) -> dict[str, Any]:
    began = time.perf_counter()
    record = ClipRecord(out.resolve().name, inputs, config)
    try:
        scene = see(inputs, config, folder)
        bodies = find_first_bodies(scene)
        fitted = fit_windows(scene, bodies, lambda frames, loss: record.frames("fit/loss", dict.fromkeys(frames, loss)))
        joined = join(scene, fitted)
        record.frames("frame/seen", _seen(bodies, joined))
        scores = score(scene, fitted, joined)
        for name, values in scores.items():
            record.frames(f"eval/{name}", values)
        warnings = warn(scene, fitted, joined, scores.get("matte_iou", {}))
        texture = draw_texture(scene.footage.light, fitted.person, folder)
        shot = scene.shot(joined.motion, fitted.person)
        exports = export_motion(shot, texture, config.export, folder)
        curves = clip_curves(fitted.windows, _pairs(scores), folder)
        files: dict[str, FileHandle] = {
            "motion.npz": joined.motion,
            CURVES: curves,
            "edges.json": joined.edges,
            "texture.png": texture,
            "strip.png": draw(scene, fitted, joined),
            **exports.by_name(),
        }
        result = _result(scene=scene, bodies=bodies, fitted=fitted, joined=joined, scores=scores, out=out)
        result |= exports.facts()
        result["warnings"] = [one.model_dump(mode="json") for one in warnings]
        result["seconds"] = round(time.perf_counter() - began, 3)
        result["workers_busy"] = busy_share()
        ask_server()  # a run that cannot end must not be recorded as finished
        place = record.finish(files, result)
        if place is None:
            files[RECORD] = record.keep(files, result, folder)
        else:
            result |= {"mlflow_run_id": place.run_id, "mlflow_link": place.link}
        if config.export.report:
            made_of = ReportParts(
                motion=joined.motion,
                curves=curves,
                body=inputs.body,
                texture=texture,
                strip=files["strip.png"],
                film=draw_page_film(shot, folder),
            )
            files[REPORT] = write_report(made_of, result, folder)
            add_report(result["mlflow_run_id"], files[REPORT])
        publish(out, {name: file.path for name, file in files.items()}, result)
        return result
    except Exception:
        record.stop("FAILED")
        raise
    except BaseException:  # Ctrl-C, SIGTERM
        record.stop("KILLED")
        raise


def _seen(bodies: ClipBodiesHandle, joined: JoinedHandle) -> dict[int, float]:
    """Return per frame of the clip whether it was seen (1), filled from its neighbours (0.5), or a gap (0)."""
    filled = {number for number, made in enumerate(bodies.filled) if made} | set(joined.bridged)
    pairs = enumerate(bodies.usable)
    return {number: _FILLED if number in filled else _SEEN if usable else _GAP for number, usable in pairs}


def _result(
    *,
    scene: Scene,
    bodies: ClipBodiesHandle,
    fitted: Fitted,
    joined: JoinedHandle,
    scores: Mapping[str, Mapping[int, float]],
    out: Path,
) -> dict[str, Any]:
    """Return result.json: scores, places of files, inputs and options."""
    footage = scene.footage
    return {
        "frames": footage.count,
        "sub_frames": joined.rows,
        "gaps": [list(gap) for gap in joined.gaps],
        "filled": sorted({number for number, filled in enumerate(bodies.filled) if filled} | set(joined.bridged)),
        "windows": len(fitted.windows),
        "resumed_frames": len(fitted.resumed),
        "fronts": [{"segment": segment, **front.model_dump()} for segment, front in fitted.fronts.items()],
        **{name: _mean(values) for name, values in scores.items()},
        "confidence": radius_condition([first.source for first in bodies.firsts if first is not None]),
        "worst_jump_mm": joined.worst_jump_mm,
        "worst_velocity_share": joined.worst_velocity_share,
        "out": str(out.resolve()),
        "strip": str(out.resolve() / "strip.png"),
        "report": str(out.resolve() / REPORT) if scene.config.export.report else None,
        "mlflow_run_id": None,
        "mlflow_link": None,
        "pose_networks": [file.path.name for file in scene.inputs.networks],
        "background": scene.plate.source,
        "exposure_gain": [list(frame.gain) for frame in scene.frames],
        "remarks": list(footage.remarks),
        "inputs": video_hashes(scene.inputs),
        "config": scene.config.model_dump(mode="json"),
        "code": code_version(),
    }


def _pairs(scores: Mapping[str, Mapping[int, float]]) -> dict[str, tuple[tuple[int, float], ...]]:
    """Return the known scores as (frame, value) pairs."""
    return {
        name: tuple((number, value) for number, value in sorted(values.items()) if math.isfinite(value))
        for name, values in scores.items()
    }


def _mean(values: Mapping[int, float]) -> float | None:
    finite = [value for value in values.values() if math.isfinite(value)]
    return sum(finite) / len(finite) if finite else None


@contextmanager
def clip_place(out: Path, engine: Engine | int) -> Iterator[Path]:
    """Provide the folder of intermediate files inside the block, locked for this process, and the engine's workers.

    Args:
        out: where the results go.
        engine: where computations run.

    Raises:
        InputError: see `hfb.tasks.results.workspace.workspace` and `hfb.tasks.workers.workers.workers`.
        InfrastructureError: see `hfb.flows.runtime.failures.explain_failures`.
    """
    with explain_failures(out), workspace(out) as folder, workers(engine, apart=True), records_in(folder):
        yield folder
