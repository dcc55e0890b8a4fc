"""Scores, warnings and the strip of a fitted clip, each a few tasks over some of its frames."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hfb.evaluation.warnings import ResultWarning, check_front
from hfb.tasks.chains.clip_steps import CHUNK, Fitted, Scene
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.video_handles import JoinedHandle
from hfb.tasks.map_task import require_all
from hfb.tasks.results.result_warnings import look_for_warnings, looks_over, tell
from hfb.tasks.video.video_look import ScoreCall, draw_clip, judge_clip, score_frames

_SHOWN = 6


def score(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> dict[str, dict[int, float]]:
    """Score how well the motion explains every frame, and its errors where the truth is known.

    Args:
        scene: the clip.
        fitted: its windows.
        joined: its motion.
    """
    numbers = sorted({frame for window in fitted.windows for frame in window.frames})
    calls = []
    for at in range(0, len(numbers), CHUNK):
        some = tuple(numbers[at : at + CHUNK])
        clip, mattes = scene.of(some)
        calls.append(
            ScoreCall(
                clip=clip,
                numbers=some,
                mattes=mattes,
                motion=joined.motion,
                person=fitted.person,
                body=scene.inputs.body,
                config=scene.config.fit,
            )
        )
    told = require_all(score_frames, calls, "scores", scene.look)
    if scene.inputs.truth is not None:
        told.append(judge_clip(joined.motion, scene.inputs.truth))
    scores: dict[str, dict[int, float]] = {}
    for one in told:
        for name, values in one.scores.items():
            scores.setdefault(name, {}).update(zip(one.frames, values, strict=True))
    return scores


def warn(scene: Scene, fitted: Fitted, joined: JoinedHandle, matte_iou: Mapping[int, float]) -> list[ResultWarning]:
    """Return the warnings of the result, the plate's first.

    Args:
        scene: the clip.
        fitted: its windows.
        joined: its motion.
        matte_iou: by frame, where it is known.
    """
    shown = looks_over(sorted({frame for window in fitted.windows for frame in window.frames}))
    clip, mattes = scene.of(shown)
    found = look_for_warnings(
        clip=clip,
        numbers=shown,
        mattes=mattes,
        motion=joined.motion,
        matte_iou=tuple(sorted(matte_iou.items())),
        body=scene.inputs.body,
        config=scene.config.fit,
    ).warnings
    weighed = {
        frame: fitted.fronts[window.segment]
        for window in fitted.windows
        if window.segment in fitted.fronts
        for frame in window.frames
    }
    doubtful = check_front(
        {frame: front.probability for frame, front in weighed.items()},
        {frame: front.turn_deg for frame, front in weighed.items()},
    )
    found = (*found, *([doubtful] if doubtful else []))
    tell(found)
    return [*scene.warnings, *found]


def draw(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> FileHandle:
    """Draw a few frames, spread over the clip, as a strip.

    Args:
        scene: the clip.
        fitted: its windows.
        joined: its motion.
    """
    numbers = sorted({frame for window in fitted.windows for frame in window.frames})
    shown = tuple(sorted({numbers[round(float(at))] for at in np.linspace(0, len(numbers) - 1, _SHOWN)}))
    clip, mattes = scene.of(shown)
    note = f"frames {', '.join(map(str, shown))} of {scene.footage.count}"
    return draw_clip(
        clip=clip,
        numbers=shown,
        mattes=mattes,
        motion=joined.motion,
        person=fitted.person,
        body=scene.inputs.body,
        config=scene.config.fit,
        note=note,
        folder=scene.folder,
    )
