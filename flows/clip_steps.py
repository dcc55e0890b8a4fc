"""The steps of a clip, each a few tasks over all its frames: see, find first bodies, fit windows, join, look."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.evaluation.warnings import ResultWarning, check_never_left
from hfb.fitting.clip.windows import ClipWindow, person_config, person_windows, plan_windows, window_config
from hfb.flows.runtime.failures import ServerWatch
from hfb.io.media.plate import HOLDS_PERSON
from hfb.tasks.core.handles import Call, ClipHandle, FileHandle, FirstBodyHandle, PriorsHandle
from hfb.tasks.core.video_handles import (
    ClipBodiesHandle,
    FootageHandle,
    JoinedHandle,
    PlateHandle,
    TrackHandle,
    WindowHandle,
)
from hfb.tasks.inputs.given_networks import tell_networks
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.map_task import Outcome, map_task
from hfb.tasks.results.exports import ShotHandle
from hfb.tasks.results.result_warnings import look_for_warnings, looks_over, plate_warnings, tell
from hfb.tasks.task import Task
from hfb.tasks.telemetry import progress
from hfb.tasks.video.external_poses import GivenBodyCall, find_given_body, looks_at, pictures_of, read_result
from hfb.tasks.video.video_clip import find_background, find_person, look_at_clip
from hfb.tasks.video.video_frames import (
    BetweenCall,
    ExtractCall,
    KeyBodyCall,
    MatteCall,
    extract_frames,
    find_body_between,
    find_key_body,
    find_matte,
)
from hfb.tasks.video.video_look import ScoreCall, draw_clip, judge_clip, score_frames
from hfb.tasks.video.video_windows import (
    WindowCall,
    estimate_identity,
    fill_bodies,
    fit_clip_window,
    join_clip,
    mend_fronts,
)
from hfb.tracking.clip_bodies import key_frames

_CHUNK = 16  # frames per task where a task per frame would cost more than its work
_SHOWN = 6
C = TypeVar("C", bound=Call)
R = TypeVar("R")


@dataclass(frozen=True)
class Scene:
    """A clip whose frames are pictures.

    Attributes:
        mattes: of the frames in which somebody is seen.
        areas: their sums [px], 0 elsewhere.
        warnings: of the plate, which are told before the fit.
    """

    inputs: VideoInputs
    config: RunConfig
    folder: Path
    footage: FootageHandle
    plate: PlateHandle
    frames: tuple[FileHandle, ...]
    mattes: Mapping[int, FileHandle]
    areas: tuple[float, ...]
    warnings: tuple[ResultWarning, ...] = ()

    def of(self, numbers: Sequence[int]) -> tuple[ClipHandle, tuple[FileHandle, ...]]:
        """Some frames as a clip of their own, and their mattes."""
        plate = FileHandle(path=self.plate.path, sha256=self.plate.sha256)
        frames = tuple(self.frames[number] for number in numbers)
        return self.footage.clip(frames, plate), tuple(self.mattes[number] for number in numbers)

    def still(self, number: int) -> ClipHandle:
        """Return one frame for a step that needs the camera but no time."""
        return self.footage.still(self.frames[number], self.plate, camera=True)

    def shot(self, motion: FileHandle, person: FileHandle) -> ShotHandle:
        """Return what films are drawn from."""
        plate = FileHandle(path=self.plate.path, sha256=self.plate.sha256)
        return ShotHandle(
            clip=self.footage.clip(self.frames, plate),
            motion=motion,
            texture=person,
            body=self.inputs.body,
            config=self.config.fit,
        )


@dataclass(frozen=True)
class Fitted:
    """All windows of a clip, and whose motion they are.

    Attributes:
        resumed: frames whose fit an earlier run had finished.
    """

    windows: tuple[WindowHandle, ...]
    person: FileHandle
    resumed: frozenset[int] = field(default_factory=frozenset)


def see(inputs: VideoInputs, config: RunConfig, folder: Path) -> Scene:
    """The frames as pictures, the plate, and the person's matte in every frame where somebody is seen.

    Raises:
        InputError: the footage, the plate or the track cannot be used, or nobody is seen in any frame.
    """
    footage = look_at_clip(
        inputs=inputs, average=config.video.average, camera=config.camera, exposure=config.exposure, folder=folder
    )
    for remark in footage.remarks:
        progress.say(f"hfb: {remark}")
    plate = find_background(footage, inputs.plate, inputs.background, folder)
    progress.say(f"hfb: {plate.source}")
    track = find_person(footage, plate, inputs.clip.person, inputs.track)
    plate_faults = _check_plate(inputs, plate, track)
    tell(plate_faults)
    alone = track.others == 0
    if not alone:
        progress.say(f"hfb: {track.others + 1} people are seen: following {track.name}; [person] in clip.toml chooses")
    chunks = [
        ExtractCall(footage=footage, start=at, stop=min(at + _CHUNK, footage.count), folder=folder)
        for at in range(0, footage.count, _CHUNK)
    ]
    frames = tuple(file for chunk in _require_all(extract_frames, chunks, "frames") for file in chunk.files)
    calls = [
        MatteCall(
            still=footage.still(frame, plate),
            number=number,
            box=box,
            alone=alone,
            config=config.matting,
            network=inputs.matting,
            folder=folder,
        )
        for number, (frame, box) in enumerate(zip(frames, track.boxes, strict=True))
        if box is not None
    ]
    found = dict(zip((call.number for call in calls), _require_all(find_matte, calls, "mattes"), strict=True))
    mattes = {number: one.file for number, one in found.items() if one.file is not None}
    if not mattes:
        reason = next((one.reason for one in found.values()), "nobody differs from the background")
        raise InputError(f"nobody is seen in any of the {footage.count} frames ({reason})")
    areas = tuple(found[number].area_px if number in found else 0.0 for number in range(len(frames)))
    return Scene(inputs, config, folder, footage, plate, frames, mattes, areas, plate_faults)


def _check_plate(inputs: VideoInputs, plate: PlateHandle, track: TrackHandle) -> tuple[ResultWarning, ...]:
    """Whether the plate holds the person."""
    if HOLDS_PERSON in plate.source:
        return plate_warnings([f"it seems that {HOLDS_PERSON}"])
    never = check_never_left(track.boxes) if inputs.plate == "median" else None
    return (never,) if never else ()


def find_first_bodies(scene: Scene) -> ClipBodiesHandle:
    """A body for every frame but those of long absences.

    Raises:
        InputError: no body is found in any frame.
    """
    config, body, networks = scene.config, scene.inputs.body, scene.inputs.networks
    if scene.inputs.init_files:
        return _bodies_of_result(scene)
    tell_networks(networks)
    present = np.array([number in scene.mattes for number in range(len(scene.frames))], bool)
    keys = key_frames(present, config.video.key_every)
    calls = [
        KeyBodyCall(
            still=scene.still(n),
            number=n,
            matte=scene.mattes[n],
            body=body,
            config=config.init,
            networks=networks,
            folder=scene.folder,
        )
        for n in keys
    ]
    searched = _require_all(find_key_body, calls, "first bodies")
    found = {number: one.first for number, one in zip(keys, searched, strict=True) if one.first is not None}
    if not found:
        raise InputError(f"no body is found in any frame ({searched[0].reason})")
    agreed = mend_fronts(tuple(found), tuple(found.values()), scene.folder)
    known = {n: one for n, one in zip(found, agreed.firsts, strict=True) if one is not None}
    others = [number for number in scene.mattes if number not in keys]
    between = [
        BetweenCall(
            still=scene.still(n),
            number=n,
            matte=scene.mattes[n],
            known=_around(n, known),
            body=body,
            folder=scene.folder,
        )
        for n in others
    ]
    placed = _require_all(find_body_between, between, "first bodies between")
    for number, one in zip(others, placed, strict=True):
        if one.first is not None:
            known[number] = one.first
    return _fill(scene, known)


def _bodies_of_result(scene: Scene) -> ClipBodiesHandle:
    """Another system's bodies, each laid onto its matte; frames in which it saw nobody by their neighbours."""
    inputs, first = scene.inputs, scene.config.init.frame
    names, frames = pictures_of(scene.footage, inputs.video, first)
    result = read_result(
        files=inputs.init_files,
        height=scene.footage.height,
        width=scene.footage.width,
        person=scene.config.init.person,
        looks=looks_at(scene.footage, scene.mattes, first),
        body=inputs.body,
        pictures=names,
        frames=frames,
        folder=scene.folder,
    )
    if remark := result.remark():
        progress.say(f"hfb: {remark}")
    calls = [
        GivenBodyCall(
            footage=scene.footage,
            still=scene.still(n),
            number=n,
            matte=scene.mattes[n],
            result=result,
            first=first,
            body=inputs.body,
            folder=scene.folder,
        )
        for n in sorted(scene.mattes)
    ]
    given = _require_all(find_given_body, calls, "first bodies of the result")
    found = {call.number: one.first for call, one in zip(calls, given, strict=True) if one.first is not None}
    if not found:
        raise InputError(f"the result has a body for none of the frames ({given[0].reason}); say with --init.frame")
    return _fill(scene, found)


def _fill(scene: Scene, known: Mapping[int, FirstBodyHandle]) -> ClipBodiesHandle:
    """Bodies of the other frames, from their neighbours'."""
    numbers = tuple(sorted(known))
    return fill_bodies(
        numbers=numbers,
        firsts=tuple(known[number] for number in numbers),
        present=tuple(number in scene.mattes for number in range(len(scene.frames))),
        longest_fill=scene.config.video.longest_fill,
        folder=scene.folder,
    )


def fit_windows(scene: Scene, bodies: ClipBodiesHandle, on_fitted: Callable[[tuple[int, ...], float], None]) -> Fitted:
    """The person from a few windows, then every window with that person.

    Args:
        scene: the clip.
        bodies: its first bodies.
        on_fitted: called in order with the frames that a window settles and its loss.
    """
    config = scene.config
    windows = plan_windows(np.array(bodies.usable, bool), config.video.window)
    settling = person_windows(windows, np.array(scene.areas), config.video.person_windows)
    first_calls = [_window_call(scene, bodies, windows[index], None) for index in settling]
    first_fits = _require_all(fit_clip_window, first_calls, "who it is")
    person = estimate_identity(tuple(first_fits), scene.inputs.body, scene.folder)
    settled = _assign_frames(windows)
    resumed: set[int] = set()

    def fitted(index: int, outcome: Outcome[WindowHandle]) -> None:
        if outcome.result is None:
            return
        if outcome.reused:
            resumed.update(settled[index])
        on_fitted(settled[index], outcome.result.loss)

    calls = [_window_call(scene, bodies, window, person) for window in windows]
    return Fitted(tuple(_require_all(fit_clip_window, calls, "windows", fitted)), person, frozenset(resumed))


def join(scene: Scene, fitted: Fitted) -> JoinedHandle:
    """One continuous motion."""
    config = scene.config
    return join_clip(
        footage=scene.footage,
        windows=fitted.windows,
        person=fitted.person,
        body=scene.inputs.body,
        subframes=config.fit.subframes,
        longest_fill=config.video.longest_fill,
        folder=scene.folder,
    )


def score(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> dict[str, dict[int, float]]:
    """How well the motion explains every frame, and how far it is from the truth where that is known."""
    numbers = sorted({frame for window in fitted.windows for frame in window.frames})
    calls = []
    for at in range(0, len(numbers), _CHUNK):
        some = tuple(numbers[at : at + _CHUNK])
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
    told = _require_all(score_frames, calls, "scores")
    if scene.inputs.truth is not None:
        told.append(judge_clip(joined.motion, scene.inputs.truth))
    scores: dict[str, dict[int, float]] = {}
    for one in told:
        for name, values in one.scores.items():
            scores.setdefault(name, {}).update(zip(one.frames, values, strict=True))
    return scores


def warn(scene: Scene, fitted: Fitted, joined: JoinedHandle, matte_iou: Mapping[int, float]) -> list[ResultWarning]:
    """What is wrong with the result, the plate's warnings first.

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
    tell(found)
    return [*scene.warnings, *found]


def draw(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> FileHandle:
    """A few frames, spread over the clip, as a strip."""
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


def _window_call(scene: Scene, bodies: ClipBodiesHandle, window: ClipWindow, person: FileHandle | None) -> WindowCall:
    config, inputs = scene.config, scene.inputs
    clip, mattes = scene.of(window.frames)
    return WindowCall(
        clip=clip,
        frames=window.frames,
        segment=window.segment,
        mattes=mattes,
        firsts=tuple(first for number in window.frames if (first := bodies.firsts[number]) is not None),
        body=inputs.body,
        priors=PriorsHandle(kind=config.prior.kind, pose=inputs.pose_prior, motion=inputs.motion_prior),
        person=person,
        config=person_config(config) if person is None else window_config(config),
        seed=config.seed,
        folder=scene.folder,
    )


def _assign_frames(windows: Sequence[ClipWindow]) -> list[tuple[int, ...]]:
    """Per window the frames that no window before it has: every frame once."""
    seen: set[int] = set()
    settled = []
    for window in windows:
        settled.append(tuple(frame for frame in window.frames if frame not in seen))
        seen.update(window.frames)
    return settled


def _around(number: int, known: Mapping[int, FirstBodyHandle]) -> tuple[tuple[int, FirstBodyHandle], ...]:
    """The nearest known bodies before and after a frame: more would make every frame depend on all."""
    before = max((frame for frame in known if frame < number), default=None)
    after = min((frame for frame in known if frame > number), default=None)
    return tuple((frame, known[frame]) for frame in (before, after) if frame is not None)


def _require_all(
    task: Task[[C], R],
    calls: Sequence[C],
    label: str,
    on_outcome: Callable[[int, Outcome[R]], None] | None = None,
) -> list[R]:
    """All results in order; the first failure ends the rest, for the whole needs every one."""
    server = ServerWatch()

    def watched(index: int, outcome: Outcome[R]) -> None:
        if outcome.error is not None:
            raise outcome.error
        server.look()
        if on_outcome is not None:
            on_outcome(index, outcome)

    outcomes = map_task(task, calls, label, watched)
    return [outcome.result for outcome in outcomes if outcome.result is not None]
