"""The fit: from a static body per frame to the motion during each exposure."""

import json
from dataclasses import replace
from pathlib import Path

from hfb.config import FitConfig
from hfb.fitting.alternatives import direction_record, save_alternatives
from hfb.fitting.fit import fit
from hfb.initialization.fronts import find_other_front
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import write_matte, write_png
from hfb.motion.footing import stand
from hfb.motion.motion_file import save_motion, write_arrays
from hfb.motion.static_pose import load_first_body
from hfb.objective.floor import floor_terms
from hfb.priors.load import load_pose_prior
from hfb.priors.motion_prior import load_motion_prior
from hfb.tasks.core.caller_parts import caller_parts
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FitHandle, FrontRecord, PriorsHandle
from hfb.tasks.core.scene import load_chosen_body, load_observation
from hfb.tasks.task import task
from hfb.tasks.telemetry import progress


@task("fit")
def fit_motion(
    *,
    clip: ClipHandle,
    mattes: tuple[FileHandle, ...],
    first_bodies: tuple[FirstBodyHandle, ...],
    body: FileHandle | None,
    priors: PriorsHandle,
    config: FitConfig,
    seed: int,
    folder: Path,
) -> FitHandle:
    """Minimise eq. (11); leaves the motion, the texture, the mattes it used last and every term's history.

    Args:
        clip: all frames.
        mattes: of all frames.
        first_bodies: of all frames.
        body: the user's body model; None for the embedded one.
        priors: of pose and motion.
        config: options of the fit.
        seed: of the random numbers.
        folder: where the files go.
    """
    observation, model = load_observation(clip, mattes), load_chosen_body(body)
    firsts, own = [load_first_body(first.path) for first in first_bodies], caller_parts()
    result = fit(
        observation,
        firsts,
        model,
        config,
        seed,
        own.pose_prior or load_pose_prior(priors.pose.path if priors.pose else None, priors.kind),
        on_progress=progress.advance,
        motion_prior=load_motion_prior(priors.motion.path if priors.motion else None),
        other_front=find_other_front(observation, firsts, model, enabled=config.both_fronts),
        own_terms=(*own.terms, *floor_terms(clip.world, config)),
    )
    paths = [folder / name for name in ("motion.npz", "texture.npz", "texture.png", "history.json")]
    moving = stand(replace(result.motion, world=clip.world, size=(clip.width, clip.height)))
    save_motion(paths[0], moving, model.betas_space)
    write_arrays(paths[1], {"texture": result.texture.numpy()})
    write_png(paths[2], observation.to_srgb(result.texture).numpy())
    write_bytes_atomic(paths[3], json.dumps(result.history).encode())
    (folder / "fitted").mkdir(exist_ok=True)  # a tracking store names files as they are named here
    mattes_used = [folder / "fitted" / f"matte_{index}.png" for index in range(len(mattes))]
    for path, alpha in zip(mattes_used, result.mattes, strict=True):
        write_matte(path, alpha.numpy())
    motion, texture, texture_image, history = (FileHandle.of(path) for path in paths)
    alternatives: FileHandle | None = None
    directions: tuple[dict[str, dict[str, float | None]], ...] = ()
    if result.alternatives is not None:
        save_alternatives(folder / "alternatives.npz", result.alternatives, result.joint_features)
        alternatives = FileHandle.of(folder / "alternatives.npz")
        directions = tuple(direction_record(result.alternatives))
    front = None
    if (found := result.front) is not None:
        front = FrontRecord(
            probability=round(found.probability, 4), mirrored=found.mirrored, turn_deg=round(found.turn_deg, 1)
        )
    return FitHandle(
        motion=motion,
        texture=texture,
        texture_image=texture_image,
        history=history,
        mattes=tuple(FileHandle.of(path) for path in mattes_used),
        alternatives=alternatives,
        directions=directions,
        front=front,
        seconds=result.seconds,
        stage_seconds=result.stage_seconds,
        best_iteration=result.best_iteration,
        loss=result.loss,
    )
