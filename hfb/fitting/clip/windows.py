"""Windows of a clip: a few neighbouring frames each, fitted separately, overlapping by one frame.

With the person known, no window needs another's result: they can be fitted in any order and at once, and the cost
grows in proportion to the frames.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body
from hfb.config import FitConfig, RunConfig
from hfb.errors import InputError
from hfb.fitting.fit import FitResult, Problem, fit_all
from hfb.fitting.identity import Identity
from hfb.geometry.camera import RowClock
from hfb.io.array_files import read_arrays
from hfb.motion.motion_file import write_arrays
from hfb.motion.static_pose import FirstBody, OtherFront, rescale_first_body
from hfb.motion.trajectory import Trajectory
from hfb.objective.own_term import OwnTerm
from hfb.priors.motion_prior import MotionPrior
from hfb.priors.pose import PosePrior
from hfb.rendering.observation import Observation
from hfb.typing import Array, Bool, Float, Tensor


def window_batch_size(config: FitConfig) -> int:
    """Number of windows that are fitted together (`fit_all`): one alone leaves a device idle.

    Args:
        config: options of the fit.
    """
    return config.batch_size if config.rasterizer in ("cuda", "warp") else 1


@dataclass(frozen=True)
class ClipWindow:
    """Neighbouring frames of a clip that are fitted jointly.

    Attributes:
        frames: their numbers in the clip, one after another.
        segment: which unbroken stretch of the clip they belong to, counted from 0.
    """

    frames: tuple[int, ...]
    segment: int


@dataclass(frozen=True)
class WindowFit:
    """Result of one window's fit, in metres and camera coordinates.

    Attributes:
        frames: see `ClipWindow`.
        segment: see `ClipWindow`.
        texture: linear light; None where the person was known.
        joint_radius_mm: how far off each joint may be, see `SampledMotion`; None where the fit does not say.
        loss: the kept iterate's weighted sum.
        history: one value per iteration of every term.
        mirrored: the fit began from the first bodies' mirror images in depth.
        front_log_odds: that the first bodies face the right way; 0 where both fronts were not fitted.
        front_turn_deg: angle between both fronts, see `hfb.fitting.front_choice.FrontChoice`.
    """

    frames: tuple[int, ...]
    segment: int
    trajectory: Trajectory
    betas: Float[Tensor, "10"]
    texture: Float[Tensor, "A A 3"] | None
    joint_radius_mm: Float[Array, "T S 24"] | None
    loss: float
    seconds: float
    history: dict[str, list[float]] = field(default_factory=dict)
    mirrored: bool = False
    front_log_odds: float = 0.0
    front_turn_deg: float = 0.0


def plan_windows(usable: Bool[Array, "T"], length: int) -> tuple[ClipWindow, ...]:
    """Cut every unbroken run of usable frames into windows of `length` frames that share one with the next.

    The last window of a run is shorter where the run does not divide; a lone frame is a window of its own.

    Args:
        usable: frames that can be fitted.
        length: frames per window.
    """
    if length < 2:
        raise ValueError(f"windows of {length} frames cannot overlap: give 2 or more")
    windows: list[ClipWindow] = []
    for segment, run in enumerate(runs(usable)):
        firsts = range(run.start, max(run.stop - 1, run.start + 1), length - 1)
        windows += [ClipWindow(tuple(range(at, min(at + length, run.stop))), segment) for at in firsts]
    return tuple(windows)


def runs(usable: Bool[Array, "T"]) -> list[range]:
    """Return the unbroken runs of true entries, in order.

    Args:
        usable: one entry per frame.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(np.int8)))
    return [range(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def person_windows(windows: Sequence[ClipWindow], matte_areas: Float[Array, "T"], count: int) -> tuple[int, ...]:
    """Choose windows that determine the person: in the middle of equal parts of the clip, where most is seen.

    Args:
        windows: windows of one clip.
        matte_areas: matte area of every frame of the clip [px], a measure of how much of the person is visible.
        count: largest number of chosen windows.
    """
    whole = np.array_split(np.arange(len(windows)), min(count, len(windows)))
    parts = [part[len(part) // 4 : len(part) - len(part) // 4] for part in whole]  # neighbours tell the same
    seen = np.array([float(np.mean([matte_areas[frame] for frame in window.frames])) for window in windows])
    several = np.array([len(window.frames) > 1 for window in windows])
    # A window of one frame determines depth worst: it is used only where its part has no other.
    return tuple(int(part[np.lexsort((-seen[part], ~several[part]))[0]]) for part in parts)


def window_config(config: RunConfig) -> FitConfig:
    """Return the options of a window once the person is known: fewer and smaller steps than from scratch.

    Args:
        config: options of the run.
    """
    video, base = config.video, config.fit
    return base.model_copy(
        update={
            "stages": video.stages,
            "multi_frame": base.multi_frame.model_copy(update={"iterations": 1.0, "learning_rate": 1.0}),
            "settle": min(video.settle, base.settle),
            "both_fronts": False,
            "directions": base.directions.model_copy(update={"search": False}),
        }
    )


def person_config(config: RunConfig) -> FitConfig:
    """Return the options of windows that determine the person: those of `hfb fit`, without the search for directions.

    Args:
        config: options of the run.
    """
    return config.fit.model_copy(update={"directions": config.fit.directions.model_copy(update={"search": False})})


@dataclass(frozen=True)
class WindowScene:
    """A window and the input of its fit.

    Attributes:
        observation: observation of the window's frames alone.
        first_bodies: first bodies of the window's frames alone.
        identity: shape and texture to hold fixed; both are fitted where it is not given.
        other_front: see `hfb.fitting.fit.Problem`.
    """

    window: ClipWindow
    observation: Observation
    first_bodies: Sequence[FirstBody]
    identity: Identity | None = None
    other_front: OtherFront | None = None


def fit_windows(
    scenes: Sequence[WindowScene],
    body: Body,
    config: FitConfig,
    *,
    seed: int,
    pose_prior: PosePrior,
    motion_prior: MotionPrior | None = None,
    own_terms: Sequence[OwnTerm] = (),
) -> list[WindowFit]:
    """Fit several windows of one clip: in batches on a device (see `fit_all`), in turn otherwise.

    Args:
        scenes: windows with their observations, first bodies and, where known, identity.
        body: the body model.
        config: options of the fits.
        seed: seed of everything random.
        pose_prior: prior of the pose, L_P of eq. (6).
        motion_prior: prior of the motion; the shipped one when not given.
        own_terms: as of `hfb.fitting.fit.fit`.
    """
    batch_size = window_batch_size(config)
    found: dict[int, WindowFit] = {}
    for kind in sorted({_kind(one) for one in scenes}):
        alike = [place for place, one in enumerate(scenes) if _kind(one) == kind]
        for at in range(0, len(alike), batch_size):
            some = alike[at : at + batch_size]
            problems = [_problem(scenes[place], body) for place in some]
            results = fit_all(
                problems,
                body,
                config,
                seed,
                pose_prior,
                motion_prior=motion_prior,
                batch_size=batch_size,
                own_terms=own_terms,
            )
            found |= {
                place: _window_fit(scenes[place], result, config) for place, result in zip(some, results, strict=True)
            }
    return [found[place] for place in range(len(scenes))]


def _kind(scene: WindowScene) -> tuple[int, bool, float, float, RowClock | None]:
    """Return a key of windows that can be fitted in one batch."""
    return len(scene.window.frames), scene.identity is not None, *scene.observation.timing


def _problem(scene: WindowScene, body: Body) -> Problem:
    first_bodies, identity = scene.first_bodies, scene.identity
    if identity is not None:
        first_bodies = [rescale_first_body(first, identity.betas, body) for first in first_bodies]
    return Problem(scene.observation, first_bodies, identity, scene.other_front)


def _window_fit(scene: WindowScene, found: FitResult, config: FitConfig) -> WindowFit:
    radius, frames = found.motion.joint_radius_mm, scene.window.frames
    return WindowFit(
        frames=frames,
        segment=scene.window.segment,
        trajectory=found.trajectory,
        betas=torch.from_numpy(found.motion.betas).float(),
        texture=found.texture if scene.identity is None else None,
        joint_radius_mm=None if radius is None else radius.reshape(len(frames), config.subframes, 24),
        loss=found.loss,
        seconds=found.seconds,
        history=found.history,
        mirrored=found.front is not None and found.front.mirrored,
        front_log_odds=0.0 if found.front is None else found.front.log_odds,
        front_turn_deg=0.0 if found.front is None else found.front.turn_deg,
    )


def save_window(path: Path, found: WindowFit) -> None:
    """Write a window's result (.npz, no pickle) whole or not at all; without the seconds, so that bytes repeat.

    Args:
        path: file to write.
        found: the window's result.
    """
    motion = found.trajectory
    arrays: dict[str, Array] = {
        "frames": np.array(found.frames),
        "segment": np.array(found.segment),
        "betas": found.betas.double().numpy(),
        "rotation": motion.rotation.detach().numpy(),
        "translation": motion.translation.detach().numpy(),
        "kind": np.array(motion.kind),
        "origin": np.array(motion.origin),
        "loss": np.array(found.loss),
        "history": np.array(json.dumps(found.history)),
        "mirrored": np.array(found.mirrored),
        "front_log_odds": np.array(found.front_log_odds),
        "front_turn_deg": np.array(found.front_turn_deg),
    }
    if found.texture is not None:
        arrays["texture"] = found.texture.detach().numpy()
    if found.joint_radius_mm is not None:
        arrays["joint_radius_mm"] = found.joint_radius_mm
    write_arrays(path, arrays)


def load_window(path: Path) -> WindowFit:
    """Read a window's result; its ``seconds`` are 0.

    Args:
        path: the file.

    Raises:
        InputError: missing, damaged, or not a window's result.
    """
    try:
        content = read_arrays(path)
        motion = Trajectory(
            torch.from_numpy(content["rotation"]),
            torch.from_numpy(content["translation"]),
            "axis-angle" if str(content["kind"]) == "axis-angle" else "quaternion",
            float(content["origin"]),
        )
        texture = content.get("texture")
        return WindowFit(
            frames=tuple(int(frame) for frame in content["frames"]),
            segment=int(content["segment"]),
            trajectory=motion,
            betas=torch.from_numpy(content["betas"]).float(),
            texture=None if texture is None else torch.from_numpy(texture),
            joint_radius_mm=content.get("joint_radius_mm"),
            loss=float(content["loss"]),
            seconds=0.0,
            history=json.loads(str(content["history"])),
            mirrored=bool(content["mirrored"]),
            front_log_odds=float(content["front_log_odds"]),
            front_turn_deg=float(content["front_turn_deg"]),
        )
    except FileNotFoundError:
        raise InputError(f"there is no window's result at {path}") from None
    except (KeyError, ValueError, TypeError, OSError) as error:
        raise InputError(f"{path} is not a window's result of hfb ({error}); delete it to have it made again") from None
