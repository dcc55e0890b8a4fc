"""Fit a clip of one person, or of several people one after the other."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.errors import Busy, InputError
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.flows.video import clip_place, run_video
from hfb.io.safe_folder import check_ordinary
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.video_handles import PersonSeen
from hfb.tasks.inputs.video_inputs import VideoInputs, video_hashes
from hfb.tasks.results.workspace import mark_unfinished, publish, workspace
from hfb.tasks.telemetry import progress
from hfb.tasks.video.video_clip import find_background, find_everyone, look_at_clip
from hfb.tasks.workers.engine import Engine

_log = logging.getLogger(__name__)
_KEPT = (
    "frames",
    "sub_frames",
    "gaps",
    "resumed_frames",
    "matte_iou",
    "psnr_db",
    "mpjpe_mm",
    "seconds",
    "out",
    "mlflow_run_id",
    "warnings",
)


def run_clip(inputs: VideoInputs, out: Path, config: RunConfig, engine: Engine | int) -> dict[str, Any]:
    """Fit the clip's person into ``out``; or everyone, each into a folder and a run of their own in it.

    Args:
        inputs: of the run.
        out: where the results go.
        config: all options.
        engine: where computations run.

    Returns:
        the content of result.json; of everyone: the result of each person, and the sums.

    Raises:
        InputError: an input cannot be used; of everyone: no person is visible, or no motion was found.
        InfrastructureError: see `hfb.flows.video.run_video`.
    """
    if inputs.clip.person.which != "everyone":
        return run_video(inputs, out, config, engine)
    if config.fit.height_m is not None:
        raise InputError("--fit.height-m is one person's height: leave it out where everyone is meant")
    began = time.perf_counter()
    people = everyone_in(inputs, out, config)
    progress.say(f"hfb: {len(people)} people, one after the other: {', '.join(one.name for one in people)}")
    with workspace(out):
        mark_unfinished(out)  # of an earlier result some people would be the old ones, some the new ones
        for number in range(1, len(people) + 1):
            check_ordinary(out, f"person-{number}")
    told = [
        _motion_of(one, inputs, out / f"person-{number}", config=config, engine=engine)
        for number, one in enumerate(people, 1)
    ]
    found = [one for one in told if one["error"] is None]
    if not found:
        raise InputError(f"no motion was found of any of {len(told)} people ({told[0]['error']})")
    result = {
        "people": told,
        "frames": max(one["frames"] for one in found),
        "sub_frames": sum(one["sub_frames"] for one in found),
        "resumed_frames": sum(one["resumed_frames"] for one in found),
        "seconds": round(time.perf_counter() - began, 3),
        "out": str(out.resolve()),
        "inputs": video_hashes(inputs),
        "config": config.model_dump(mode="json"),
        "code": code_version(),
    }
    with workspace(out):
        publish(out, {}, result)
    return result


def everyone_in(inputs: VideoInputs, out: Path, config: RunConfig) -> tuple[PersonSeen, ...]:
    """Return the people of a clip in the order of appearance, or of their names in a file of tracks.

    Args:
        inputs: of the run.
        out: where the results go.
        config: all options.

    Raises:
        InputError: no person is visible, or the clip cannot be used.
    """

    # A closure, as in `hfb.flows.video.run_video`.
    def everyone(clip: str) -> tuple[PersonSeen, ...]:
        footage = look_at_clip(
            inputs=inputs, average=config.video.average, camera=config.camera, exposure=config.exposure, folder=folder
        )
        plate = find_background(footage, inputs.plate, inputs.background, folder)
        return find_everyone(footage, plate, inputs.track).people

    with clip_place(out, 1) as folder:
        return recorded_flow("everyone")(everyone)(str(inputs.video[0].path))


def _motion_of(
    one: PersonSeen, inputs: VideoInputs, out: Path, *, config: RunConfig, engine: Engine | int
) -> dict[str, Any]:
    """Fit one person; a failure is part of the result and does not end the others."""
    progress.say(f"hfb: {one.name} (seen in {one.frames} frames)")
    theirs = inputs.model_copy(update={"clip": inputs.clip.model_copy(update={"person": one.choice})})
    told: dict[str, Any] = {"name": one.name, "seen": one.frames, "error": None, **dict.fromkeys(_KEPT)}
    try:
        result = run_video(theirs, out, config, engine)
    except Busy:  # not theirs to mend: the whole command has to wait
        raise
    except InputError as error:
        _log.info("%s: %s", one.name, error)
        progress.say(f"hfb: {one.name}: {error}")
        return told | {"error": str(error), "out": str(out.resolve())}
    return told | {key: result.get(key) for key in _KEPT}
