"""Scores of a fit: against the frames always, against the truth where it is known."""

import json
from dataclasses import replace
from pathlib import Path

from hfb.config import FitConfig
from hfb.datasets.truth import load_truth
from hfb.evaluation.protocol import at_rest, picture_scores, reblur, truth_scores
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.motion_file import load_motion
from hfb.motion.static_pose import load_first_body
from hfb.rendering.backends import make_rasterizer
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FitHandle, ScoresHandle
from hfb.tasks.core.scene import load_chosen_body, load_mattes, load_observation, load_texture
from hfb.tasks.task import task


@task("evaluation")
def evaluate(
    *,
    clip: ClipHandle,
    mattes: tuple[FileHandle, ...],
    first_bodies: tuple[FirstBodyHandle, ...],
    fit: FitHandle,
    body: FileHandle | None,
    truth: FileHandle | None,
    config: FitConfig,
    folder: Path,
) -> ScoresHandle:
    """Score the fit, and the first body held still as ``initial_*``; always with the exact silhouette.

    Args:
        clip: all frames.
        mattes: of all frames, from before the fit: the region of interest must not depend on the fit. Everything else
            uses the fit's own mattes.
        first_bodies: of all frames.
        fit: the motion, and the mattes it used last.
        body: the user's body model; None for the embedded one.
        truth: of a synthetic case.
        config: options of the fit.
        folder: where the scores go.
    """
    observation, model = load_observation(clip, fit.mattes), load_chosen_body(body)
    region = replace(observation, mattes=load_mattes(mattes)).region()
    rasterizer = make_rasterizer("coverage", config.rasterizer, config.threads)
    fitted, _ = load_motion(fit.motion.path)
    still = at_rest([load_first_body(first.path) for first in first_bodies], fitted, model)
    texture = load_texture(fit.texture)
    scores: dict[str, float] = {}
    known = load_truth(truth.path) if truth else None
    for prefix, motion in (("initial_", still), ("", fitted)):
        found = picture_scores(reblur(motion, texture, observation, model, rasterizer), observation, region)
        if known is not None:
            found |= truth_scores(motion, known, model, rasterizer)
        scores |= {prefix + name: value for name, value in found.items()}
    path = folder / "scores.json"
    write_bytes_atomic(path, json.dumps(scores, indent=2).encode())
    return ScoresHandle.of(path, scores=scores)
