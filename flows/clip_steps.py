"""The steps of a clip, each a few tasks over all its frames: see, find first bodies, fit windows, join, look."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.evaluation.warnings import ResultWarning, check_never_left
from hfb.fitting.clip.windows import ClipWindow, person_config, person_windows, plan_windows, window_config
from hfb.flows.runtime.trouble import ServerWatch
from hfb.io.media.plate import HOLDS_PERSON
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, PriorsHandle
from hfb.tasks.core.task import Step
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
from hfb.tasks.results.export_files import ExportsHandle
from hfb.tasks.results.films import films_of
from hfb.tasks.results.result_report import ReportParts, page_film, write_report
from hfb.tasks.results.result_warnings import look_for_warnings, looks_over, plate_warnings, tell
from hfb.tasks.telemetry import progress
from hfb.tasks.video.given_result import find_given_body, looks_at, pictures_of, read_result
from hfb.tasks.video.video_clip import find_background, find_person, look_at_clip
from hfb.tasks.video.video_frames import extract_frames, find_body_between, find_key_body, find_matte
from hfb.tasks.video.video_look import draw_clip, judge_clip, score_frames
from hfb.tasks.video.video_windows import fill_bodies, fit_clip_window, join_clip, mend_fronts, settle_person
from hfb.tasks.workers.many import Outcome, run_all
from hfb.tracking.clip_bodies import key_frames

_CHUNK = 16  # frames per task where a task per frame would cost more than its work
_SHOWN = 6
R = TypeVar("R")


@dataclass(frozen=True)
class Scene:
    """A clip whose frames are pictures.

    Attributes:
        mattes: of the frames in which somebody is seen; areas: their sums [px], 0 elsewhere.
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
        """One frame for a step that needs the camera but no time."""
        return self.footage.still(self.frames[number], self.plate, camera=True)


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
    footage = look_at_clip(inputs, config.video.average, config.camera, config.exposure, folder)
    for remark in footage.remarks:
        progress.say(f"hfb: {remark}")
    plate = find_background(footage, inputs.plate, inputs.background, folder)
    progress.say(f"hfb: {plate.source}")
    track = find_person(footage, plate, inputs.clip.person, inputs.track)
    doubts = _plate_doubts(inputs, plate, track)
    tell(doubts)
    alone = track.others == 0
    if not alone:
        progress.say(f"hfb: {track.others + 1} people are seen: following {track.name}; [person] in clip.toml chooses")
    chunks = [(footage, at, min(at + _CHUNK, footage.count), folder) for at in range(0, footage.count, _CHUNK)]
    frames = tuple(file for chunk in _all(extract_frames, chunks, "frames") for file in chunk.files)
    calls = [
        (footage.still(frame, plate), number, track.boxes[number], alone, config.matting, inputs.matting, folder)
        for number, frame in enumerate(frames)
    ]
    found = _all(find_matte, calls, "mattes")
    mattes = {number: one.file for number, one in enumerate(found) if one.file is not None}
    if not mattes:
        raise InputError(f"nobody is seen in any of the {footage.count} frames ({found[0].reason})")
    areas = tuple(one.area_px for one in found)
    return Scene(inputs, config, folder, footage, plate, frames, mattes, areas, doubts)


def _plate_doubts(inputs: VideoInputs, plate: PlateHandle, track: TrackHandle) -> tuple[ResultWarning, ...]:
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
    searched = _all(
        find_key_body,
        [(scene.still(n), n, scene.mattes[n], body, config.init, networks, scene.folder) for n in keys],
        "first bodies",
    )
    found = {number: one.first for number, one in zip(keys, searched, strict=True) if one.first is not None}
    if not found:
        raise InputError(f"no body is found in any frame ({searched[0].reason})")
    agreed = mend_fronts(tuple(found), tuple(found.values()), scene.folder)
    known = {n: one for n, one in zip(found, agreed.firsts, strict=True) if one is not None}
    others = [number for number in scene.mattes if number not in keys]
    calls = [
        (scene.still(n), n, scene.mattes[n], _around(n, known), body, scene.folder) for n in others
    ]  # fmt: skip
    for number, one in zip(others, _all(find_body_between, calls, "first bodies between"), strict=True):
        if one.first is not None:
            known[number] = one.first
    numbers = tuple(sorted(known))
    firsts = tuple(known[number] for number in numbers)
    here = tuple(bool(one) for one in present)
    return fill_bodies(numbers, firsts, here, config.video.longest_fill, scene.folder)


def _bodies_of_result(scene: Scene) -> ClipBodiesHandle:
    """Another system's bodies, each laid onto its matte; frames in which it saw nobody by their neighbours."""
    inputs, config, folder = scene.inputs, scene.config, scene.folder
    size = (scene.footage.height, scene.footage.width)
    looks = looks_at(scene.footage, scene.mattes, config.init.frame)
    pictures = pictures_of(scene.footage, inputs.video, config.init.frame)
    result = read_result(inputs.init_files, *size, config.init.person, looks, inputs.body, *pictures, folder)
    if remark := result.remark():
        progress.say(f"hfb: {remark}")
    numbers = sorted(scene.mattes)
    calls = [
        (scene.footage, scene.still(n), n, scene.mattes[n], result, config.init.frame, inputs.body, folder)
        for n in numbers
    ]  # fmt: skip
    given = _all(find_given_body, calls, "first bodies of the result")
    found = [(n, one.first) for n, one in zip(numbers, given, strict=True) if one.first is not None]
    if not found:
        raise InputError(f"the result has a body for none of the frames ({given[0].reason}); say with --init.frame")
    frames, firsts = zip(*found, strict=True)
    here = tuple(number in scene.mattes for number in range(len(scene.frames)))
    return fill_bodies(frames, firsts, here, config.video.longest_fill, folder)


def fit_windows(scene: Scene, bodies: ClipBodiesHandle, on_fitted: Callable[[tuple[int, ...], float], None]) -> Fitted:
    """The person from a few windows, then every window with that person.

    Args:
        on_fitted: called in order with the frames that a window settles and its loss.
    """
    config = scene.config
    windows = plan_windows(np.array(bodies.usable, bool), config.video.window)
    settling = person_windows(windows, np.array(scene.areas), config.video.person_windows)
    first_fits = _all(
        fit_clip_window,
        [_window_call(scene, bodies, windows[index], None) for index in settling],
        "who it is",
    )
    person = settle_person(tuple(first_fits), scene.inputs.body, scene.folder)
    settled = _settled_frames(windows)
    resumed: set[int] = set()

    def fitted(index: int, outcome: Outcome[WindowHandle]) -> None:
        if outcome.result is None:
            return
        if outcome.reused:
            resumed.update(settled[index])
        on_fitted(settled[index], outcome.result.loss)

    calls = [_window_call(scene, bodies, window, person) for window in windows]
    return Fitted(tuple(_all(fit_clip_window, calls, "windows", fitted)), person, frozenset(resumed))


def join(scene: Scene, fitted: Fitted) -> JoinedHandle:
    """One continuous motion."""
    config = scene.config
    return join_clip(
        scene.footage, fitted.windows, fitted.person, scene.inputs.body, config.fit.subframes,
        config.video.longest_fill, scene.folder,
    )  # fmt: skip


def score(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> dict[str, dict[int, float]]:
    """How well the motion explains every frame, and how far it is from the truth where that is known."""
    numbers = sorted({frame for window in fitted.windows for frame in window.frames})
    calls = []
    for at in range(0, len(numbers), _CHUNK):
        some = tuple(numbers[at : at + _CHUNK])
        clip, mattes = scene.of(some)
        calls.append((clip, some, mattes, joined.motion, fitted.person, scene.inputs.body, scene.config.fit))
    told = _all(score_frames, calls, "scores")
    if scene.inputs.truth is not None:
        told.append(judge_clip(joined.motion, scene.inputs.truth))
    scores: dict[str, dict[int, float]] = {}
    for one in told:
        for name, values in one.scores.items():
            scores.setdefault(name, {}).update(zip(one.frames, values, strict=True))
    return scores


def warn(scene: Scene, fitted: Fitted, joined: JoinedHandle, matte_iou: Mapping[int, float]) -> list[ResultWarning]:
    """What is wrong with the result, the plate's warnings first."""
    shown = looks_over(sorted({frame for window in fitted.windows for frame in window.frames}))
    clip, mattes = scene.of(shown)
    known = tuple(sorted(matte_iou.items()))
    found = look_for_warnings(clip, shown, mattes, joined.motion, known, scene.inputs.body, scene.config.fit).warnings
    tell(found)
    return [*scene.warnings, *found]


def draw(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> FileHandle:
    """A few frames, spread over the clip, as a strip."""
    numbers = sorted({frame for window in fitted.windows for frame in window.frames})
    shown = tuple(sorted({numbers[round(float(at))] for at in np.linspace(0, len(numbers) - 1, _SHOWN)}))
    clip, mattes = scene.of(shown)
    note = f"frames {', '.join(map(str, shown))} of {scene.footage.count}"
    body, config = scene.inputs.body, scene.config.fit
    return draw_clip(clip, shown, mattes, joined.motion, fitted.person, body, config, note, scene.folder)


def film(scene: Scene, fitted: Fitted, joined: JoinedHandle) -> ExportsHandle:
    """The films that are asked for."""
    config, plate = scene.config, FileHandle(path=scene.plate.path, sha256=scene.plate.sha256)
    clip = scene.footage.clip(scene.frames, plate)
    return films_of(clip, joined.motion, fitted.person, scene.inputs.body, config, scene.folder)


def report(scene: Scene, fitted: Fitted, parts: ReportParts, result: dict[str, Any]) -> FileHandle:
    """The result's page, with a film."""
    plate = FileHandle(path=scene.plate.path, sha256=scene.plate.sha256)
    clip = scene.footage.clip(scene.frames, plate)
    small = page_film(clip, parts.motion, fitted.person, scene.inputs.body, scene.config.fit, scene.folder)
    return write_report(parts.model_copy(update={"film": small}), result, scene.folder)


def _window_call(
    scene: Scene, bodies: ClipBodiesHandle, window: ClipWindow, person: FileHandle | None
) -> tuple[Any, ...]:
    config, inputs = scene.config, scene.inputs
    clip, mattes = scene.of(window.frames)
    firsts = tuple(first for number in window.frames if (first := bodies.firsts[number]) is not None)
    priors = PriorsHandle(kind=config.prior.kind, pose=inputs.pose_prior, motion=inputs.motion_prior)
    options = person_config(config) if person is None else window_config(config)
    return (
        clip, window.frames, window.segment, mattes, firsts, inputs.body, priors, person, options, config.seed,
        scene.folder,
    )  # fmt: skip


def _settled_frames(windows: Sequence[ClipWindow]) -> list[tuple[int, ...]]:
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


def _all(
    step: Step[..., R],
    calls: Sequence[tuple[Any, ...]],
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

    outcomes = run_all(step, calls, label, watched)
    return [outcome.result for outcome in outcomes if outcome.result is not None]
