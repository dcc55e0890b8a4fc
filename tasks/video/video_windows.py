"""The tasks from first bodies to the clip's motion: agree on fronts, fill gaps, fit windows, join."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from hfb.config import FitConfig
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.core.caller_parts import caller_parts
from hfb.tasks.core.handles import Call, ClipHandle, FileHandle, FirstBodyHandle, PriorsHandle
from hfb.tasks.core.video_handles import ClipBodiesHandle, FootageHandle, JoinedHandle, SeenFrameCall, WindowHandle
from hfb.tasks.task import BatchFunction, Where, task


class WindowCall(Call):
    """A window of a clip.

    Attributes:
        clip: the window's frames alone.
        frames: their numbers in the clip.
        segment: number of the stretch without a gap that the window belongs to.
        mattes: of the window's frames.
        firsts: first bodies of the window's frames.
        body: the user's body model; None for the embedded one.
        priors: of pose and motion.
        person: shape and texture of the person, where they are known.
        turned: the first bodies were mirrored because both fronts were weighed.
        config: options of the fit.
        seed: of the random numbers.
        folder: where the fit goes.
    """

    clip: ClipHandle
    frames: tuple[int, ...]
    segment: int
    mattes: tuple[FileHandle, ...]
    firsts: tuple[FirstBodyHandle, ...]
    body: FileHandle | None
    priors: PriorsHandle
    person: FileHandle | None
    turned: bool = False
    config: FitConfig
    seed: int
    folder: Path


class MirrorCall(SeenFrameCall):
    """A frame whose first body is to face the other way.

    Attributes:
        first: the body as found.
    """

    first: FirstBodyHandle


@task("fronts and backs", where="worker")
def mend_fronts(numbers: tuple[int, ...], firsts: tuple[FirstBodyHandle, ...], folder: Path) -> ClipBodiesHandle:
    """Make the bodies of some frames agree on which way the person faces.

    Args:
        numbers: of the frames.
        firsts: their bodies.
        folder: where the new bodies go, in the order of ``numbers``.
    """
    from hfb.initialization.fronts import agree_on_front
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.video.video_frames import write_body

    found = agree_on_front(
        {n: load_first_body(one.path) for n, one in zip(numbers, firsts, strict=True)},
        {n: one.doubt for n, one in zip(numbers, firsts, strict=True)},
    )
    agreed = tuple(write_body(folder / f"agreed_body_{number:06d}.npz", found[number]) for number in numbers)
    return ClipBodiesHandle(firsts=agreed, filled=(False,) * len(agreed), usable=(True,) * len(agreed))


@task("other front", where="cluster")
def mirror_body(call: MirrorCall) -> FirstBodyHandle:
    """Mirror a frame's first body in depth and lay it onto the matte.

    Args:
        call: the frame and its body.
    """
    from hfb.initialization.fronts import lay_on_mirrored
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.core.scene import load_chosen_body, load_observation
    from hfb.tasks.video.video_frames import write_body

    seen, model = load_observation(call.still, (call.matte,)), load_chosen_body(call.body)
    turned = lay_on_mirrored(load_first_body(call.first.path), seen, 0, model)
    return write_body(call.folder / f"mirrored_body_{call.number:06d}.npz", turned)


@task("missed frames", where="worker")
def fill_bodies(
    *,
    numbers: tuple[int, ...],
    firsts: tuple[FirstBodyHandle, ...],
    present: tuple[bool, ...],
    longest_fill: int,
    folder: Path,
) -> ClipBodiesHandle:
    """Find a body for every frame that has one or lies in a short stretch without; a longer one is a gap.

    Args:
        numbers: of the frames with a body.
        firsts: their bodies.
        present: for every frame of the clip whether a person is visible.
        longest_fill: how many frames without a body are filled from their neighbours.
        folder: where the new bodies go.
    """
    import numpy as np

    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.video.video_frames import write_body
    from hfb.tracking.clip_bodies import fill_missed

    known = dict(zip(numbers, firsts, strict=True))
    whole = fill_missed(
        {n: load_first_body(one.path) for n, one in known.items()}, np.array(present, bool), longest_fill
    )
    files: list[FirstBodyHandle | None] = []
    for number, body in enumerate(whole.bodies):
        if body is None:
            files.append(None)
        elif whole.filled[number]:
            files.append(write_body(folder / f"filled_body_{number:06d}.npz", body))
        else:
            files.append(known[number])
    filled, usable = (tuple(bool(one) for one in marks) for marks in (whole.filled, whole.usable))
    return ClipBodiesHandle(firsts=tuple(files), filled=filled, usable=usable)


def _gpu_batch_size(call: WindowCall) -> int:
    """Return how many windows are one problem on a GPU."""
    from hfb.fitting.clip.windows import window_batch_size

    return window_batch_size(call.config)


def _fit_windows(calls: Sequence[WindowCall]) -> list[WindowHandle]:
    """Fit windows of one clip with the same options as one problem."""
    from hfb.fitting.clip.windows import ClipWindow, WindowScene, fit_windows, save_window
    from hfb.fitting.identity import load_identity
    from hfb.initialization.fronts import find_other_front
    from hfb.motion.static_pose import load_first_body
    from hfb.objective.floor import floor_terms
    from hfb.priors.load import load_pose_prior
    from hfb.priors.motion_prior import load_motion_prior
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    shared, own = calls[0], caller_parts()
    model = load_chosen_body(shared.body)
    scenes = []
    for call in calls:
        seen = load_observation(call.clip, call.mattes)
        firsts = [load_first_body(first.path) for first in call.firsts]
        identity = load_identity(call.person.path) if call.person else None
        other = find_other_front(seen, firsts, model, enabled=call.config.both_fronts)
        scenes.append(WindowScene(ClipWindow(call.frames, call.segment), seen, firsts, identity, other))
    pose, motion = shared.priors.pose, shared.priors.motion
    fits = fit_windows(
        scenes,
        model,
        shared.config,
        seed=shared.seed,
        pose_prior=own.pose_prior or load_pose_prior(pose.path if pose else None, shared.priors.kind),
        motion_prior=load_motion_prior(motion.path if motion else None),
        own_terms=(*own.terms, *floor_terms(shared.clip.world, shared.config)),
    )
    handles = []
    for call, found in zip(calls, fits, strict=True):
        kind = "window" if call.person else "person_window_turned" if call.turned else "person_window"
        path = call.folder / f"{kind}_{found.frames[0]:06d}.npz"
        save_window(path, found)
        handles.append(
            WindowHandle.of(
                path,
                frames=found.frames,
                segment=found.segment,
                loss=found.loss,
                mirrored=found.mirrored,
                front_log_odds=found.front_log_odds,
                front_turn_deg=found.front_turn_deg,
            )
        )
    return handles


def _needs(call: WindowCall) -> Where:
    return "gpu" if call.config.rasterizer == "cuda" else "cluster"


@task("windows", where=_needs, batch=BatchFunction(_gpu_batch_size, _fit_windows))
def fit_clip_window(call: WindowCall) -> WindowHandle:
    """Fit one window, with the clip's person where it is known.

    Args:
        call: the window.
    """
    return _fit_windows([call])[0]


@task("person", where="worker")
def estimate_identity(windows: tuple[WindowHandle, ...], body: FileHandle | None, folder: Path) -> FileHandle:
    """Find the shape and texture that a few windows agree on.

    Args:
        windows: fitted without a person.
        body: the user's body model; None for the embedded one.
        folder: where the person goes.
    """
    from hfb.fitting.clip.merge_identities import merge_identities
    from hfb.fitting.clip.windows import load_window
    from hfb.fitting.identity import save_identity
    from hfb.tasks.core.scene import load_chosen_body

    path = folder / "person.npz"
    save_identity(path, merge_identities([load_window(one.path) for one in windows], load_chosen_body(body)))
    return FileHandle.of(path)


@task("join", where="worker")
def join_clip(
    *,
    footage: FootageHandle,
    windows: tuple[WindowHandle, ...],
    person: FileHandle,
    body: FileHandle | None,
    subframes: int,
    longest_fill: int,
    folder: Path,
) -> JoinedHandle:
    """Join all windows into one continuous motion; short stretches without a person are bridged.

    Args:
        footage: the clip.
        windows: fitted with the person.
        person: shape and texture of the person.
        body: the user's body model; None for the embedded one.
        subframes: per frame.
        longest_fill: how many frames without a person are bridged.
        folder: where the motion goes.
    """
    import numpy as np

    from hfb.fitting.clip.join import join_windows
    from hfb.fitting.clip.windows import load_window
    from hfb.fitting.identity import load_identity
    from hfb.motion.footing import stand
    from hfb.motion.gravity import find_world
    from hfb.motion.motion_file import save_motion
    from hfb.tasks.core.scene import load_chosen_body
    from hfb.tasks.video.video_clip import load_timing

    model = load_chosen_body(body)
    joined = join_windows(
        [load_window(one.path) for one in windows],
        model,
        load_identity(person.path),
        timing=load_timing(footage),
        subframes=subframes,
        K=np.array(footage.K),
        longest_fill=longest_fill,
    )
    world = find_world(joined.motion, footage.world)
    motion = stand(replace(joined.motion, world=world, size=(footage.width, footage.height)))
    save_motion(folder / "motion.npz", motion, model.betas_space)
    told = {
        "edges": [asdict(edge) for edge in joined.edges],
        "turned": [asdict(one) for one in joined.turned],
        "bridged": list(joined.filled),
    }
    write_bytes_atomic(folder / "edges.json", json.dumps(told, indent=1).encode() + b"\n")
    return JoinedHandle(
        motion=FileHandle.of(folder / "motion.npz"),
        edges=FileHandle.of(folder / "edges.json"),
        gaps=joined.gaps,
        bridged=joined.filled,
        rows=len(joined.motion.times_s),
        worst_jump_mm=max((edge.left_mm for edge in joined.edges), default=None),
        worst_velocity_share=max((edge.left_velocity for edge in joined.edges), default=None),
    )
