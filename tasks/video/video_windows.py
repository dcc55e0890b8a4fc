"""The tasks of a clip's windows: the person, the fits, the join, and how well it explains every frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hfb.config import FitConfig
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, PriorsHandle
from hfb.tasks.core.task import AtOnce, task
from hfb.tasks.core.video_handles import ClipBodiesHandle, FootageHandle, JoinedHandle, WindowHandle
from hfb.tasks.workers.workers import compute, remote, spread


@task("fronts and backs")
def mend_fronts(numbers: tuple[int, ...], firsts: tuple[FirstBodyHandle, ...], folder: Path) -> ClipBodiesHandle:
    """Bodies of some frames that agree on which way the person faces; in the order of ``numbers``."""
    return compute(_mend_fronts, numbers, firsts, folder)


@task("missed frames")
def fill_bodies(
    numbers: tuple[int, ...],
    firsts: tuple[FirstBodyHandle, ...],
    present: tuple[bool, ...],
    longest_fill: int,
    folder: Path,
) -> ClipBodiesHandle:
    """A body for every frame that has one or lies in a short stretch without; a longer one is a gap."""
    return compute(_fill_bodies, numbers, firsts, present, longest_fill, folder)


def _count_at_once(call: tuple[Any, ...]) -> int:
    """Windows that are one problem for a GPU; a cluster's worker is given one at a time."""
    from hfb.fitting.clip.windows import window_batch_size

    (config,) = (one for one in call if isinstance(one, FitConfig))
    return 1 if remote() else window_batch_size(config)


def _fit_at_once(calls: Sequence[tuple[Any, ...]]) -> list[WindowHandle]:
    return compute(_fit_windows, calls)


@task("windows", at_once=AtOnce(_count_at_once, _fit_at_once))
def fit_clip_window(
    clip: ClipHandle,
    frames: tuple[int, ...],
    segment: int,
    mattes: tuple[FileHandle, ...],
    firsts: tuple[FirstBodyHandle, ...],
    body: FileHandle | None,
    priors: PriorsHandle,
    person: FileHandle | None,
    config: FitConfig,
    seed: int,
    folder: Path,
) -> WindowHandle:
    """Fit one window, with the clip's person where it is known.

    Args:
        clip, mattes, firsts: of the window's frames alone.
    """
    return spread(
        _fit_window, clip, frames, segment, mattes, firsts, body, priors, person, config, seed, folder,
        gpu=config.rasterizer == "cuda",
    )  # fmt: skip


@task("person")
def settle_person(windows: tuple[WindowHandle, ...], body: FileHandle | None, folder: Path) -> FileHandle:
    """Shape and texture that a few windows agree on."""
    return compute(_settle_person, windows, body, folder)


@task("join")
def join_clip(
    footage: FootageHandle,
    windows: tuple[WindowHandle, ...],
    person: FileHandle,
    body: FileHandle | None,
    subframes: int,
    longest_fill: int,
    folder: Path,
) -> JoinedHandle:
    """One continuous motion out of all windows; short stretches without anybody are bridged."""
    return compute(_join, footage, windows, person, body, subframes, longest_fill, folder)


def _mend_fronts(numbers: tuple[int, ...], firsts: tuple[FirstBodyHandle, ...], folder: Path) -> ClipBodiesHandle:
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.video.video_frames import saved_body
    from hfb.tracking.clip_bodies import agree_on_front

    found = agree_on_front(
        {n: load_first_body(one.path) for n, one in zip(numbers, firsts, strict=True)},
        {n: one.doubt for n, one in zip(numbers, firsts, strict=True)},
    )
    agreed = tuple(saved_body(folder / f"agreed_body_{number:06d}.npz", found[number]) for number in numbers)
    return ClipBodiesHandle(firsts=agreed, filled=(False,) * len(agreed), usable=(True,) * len(agreed))


def _fill_bodies(
    numbers: tuple[int, ...],
    firsts: tuple[FirstBodyHandle, ...],
    present: tuple[bool, ...],
    longest_fill: int,
    folder: Path,
) -> ClipBodiesHandle:
    import numpy as np

    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.video.video_frames import saved_body
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
            files.append(saved_body(folder / f"filled_body_{number:06d}.npz", body))
        else:
            files.append(known[number])
    filled, usable = (tuple(bool(one) for one in marks) for marks in (whole.filled, whole.usable))
    return ClipBodiesHandle(firsts=tuple(files), filled=filled, usable=usable)


def _fit_window(
    clip: ClipHandle,
    frames: tuple[int, ...],
    segment: int,
    mattes: tuple[FileHandle, ...],
    firsts: tuple[FirstBodyHandle, ...],
    body: FileHandle | None,
    priors: PriorsHandle,
    person: FileHandle | None,
    config: FitConfig,
    seed: int,
    folder: Path,
) -> WindowHandle:
    call = clip, frames, segment, mattes, firsts, body, priors, person, config, seed, folder
    return _fit_windows([call])[0]


def _fit_windows(calls: Sequence[tuple[Any, ...]]) -> list[WindowHandle]:
    """Of one clip, with the same options; see `_fit_window` for what a call is."""
    from hfb.fitting.clip.windows import ClipWindow, WindowScene, fit_windows, save_window
    from hfb.fitting.identity import load_identity
    from hfb.motion.static_pose import load_first_body
    from hfb.priors.load import load_pose_prior
    from hfb.priors.motion_prior import load_motion_prior
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    body, priors, _, config, seed, _ = calls[0][5:]
    scenes = [
        WindowScene(
            ClipWindow(frames, segment),
            load_observation(clip, mattes),
            [load_first_body(first.path) for first in firsts],
            load_identity(person.path) if person else None,
        )
        for clip, frames, segment, mattes, firsts, _, _, person, *_ in calls
    ]
    fits = fit_windows(
        scenes,
        load_chosen_body(body),
        config,
        seed=seed,
        pose_prior=load_pose_prior(priors.pose.path if priors.pose else None, priors.kind),
        motion_prior=load_motion_prior(priors.motion.path if priors.motion else None),
    )
    handles = []
    for call, found in zip(calls, fits, strict=True):
        person, folder = call[7], call[-1]
        path = folder / f"{'window' if person else 'person_window'}_{found.frames[0]:06d}.npz"
        save_window(path, found)
        handles.append(WindowHandle.of(path, frames=found.frames, segment=found.segment, loss=found.loss))
    return handles


def _settle_person(windows: tuple[WindowHandle, ...], body: FileHandle | None, folder: Path) -> FileHandle:
    from hfb.fitting.clip.merge_identities import merge_identities
    from hfb.fitting.clip.windows import load_window
    from hfb.fitting.identity import save_identity
    from hfb.tasks.core.scene import load_chosen_body

    path = folder / "person.npz"
    save_identity(path, merge_identities([load_window(one.path) for one in windows], load_chosen_body(body)))
    return FileHandle.of(path)


def _join(
    footage: FootageHandle,
    windows: tuple[WindowHandle, ...],
    person: FileHandle,
    body: FileHandle | None,
    subframes: int,
    longest_fill: int,
    folder: Path,
) -> JoinedHandle:
    import numpy as np

    from hfb.fitting.clip.join import join_windows
    from hfb.fitting.clip.windows import load_window
    from hfb.fitting.identity import load_identity
    from hfb.motion.motion_file import save_motion
    from hfb.tasks.core.scene import load_chosen_body
    from hfb.tasks.video.video_clip import load_timing

    model = load_chosen_body(body)
    joined = join_windows(
        [load_window(one.path) for one in windows], model, load_identity(person.path), timing=load_timing(footage),
        subframes=subframes, K=np.array(footage.K), longest_fill=longest_fill,
    )  # fmt: skip
    save_motion(folder / "motion.npz", joined.motion, model.betas_space)
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
