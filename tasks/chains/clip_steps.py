"""The steps of a clip, each a few tasks over all its frames: see, find first bodies, fit windows, join."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.evaluation.warnings import ResultWarning, check_never_left
from hfb.fitting.clip.windows import ClipWindow, person_config, person_windows, plan_windows, window_config
from hfb.io.media.plate import HOLDS_PERSON
from hfb.matting.exposure_match import describe_gains
from hfb.matting.plate_check import tell_distances
from hfb.tasks.core.caller_parts import caller_parts
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle, FrameHandle, FrontRecord, PriorsHandle
from hfb.tasks.core.video_handles import (
    BodyFound,
    ClipBodiesHandle,
    FootageHandle,
    JoinedHandle,
    PlateHandle,
    TrackHandle,
    WindowHandle,
)
from hfb.tasks.inputs.given_networks import shade_networks, tell_networks
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.map_task import Outcome, require_all
from hfb.tasks.results.exports import ShotHandle
from hfb.tasks.results.result_warnings import input_warnings, tell
from hfb.tasks.telemetry import progress
from hfb.tasks.video.external_poses import GivenBodyCall, find_given_body, looks_at, pictures_of, read_result
from hfb.tasks.video.front_votes import weigh_segments
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
from hfb.tasks.video.video_windows import (
    MirrorCall,
    WindowCall,
    estimate_identity,
    fill_bodies,
    fit_clip_window,
    join_clip,
    mend_fronts,
    mirror_body,
)
from hfb.tracking.clip_bodies import key_frames

_NOBODY = "nobody differs from the background"
CHUNK = 16  # frames per task where a task per frame would cost more than its work


@dataclass(frozen=True)
class Scene:
    """A clip whose frames are image files.

    Attributes:
        mattes: of the frames in which the person is visible.
        areas: sums of the mattes [px], 0 elsewhere.
        unseen: why the other frames have no matte.
        look: called after each result of a mapped task; what it raises ends the chain.
        warnings: about the plate, shown before the fit.
    """

    inputs: VideoInputs
    config: RunConfig
    folder: Path
    footage: FootageHandle
    plate: PlateHandle
    frames: tuple[FrameHandle, ...]
    mattes: Mapping[int, FileHandle]
    areas: tuple[float, ...]
    unseen: Mapping[int, str]
    look: Callable[[], None]
    warnings: tuple[ResultWarning, ...] = ()

    def of(self, numbers: Sequence[int]) -> tuple[ClipHandle, tuple[FileHandle, ...]]:
        """Return some frames as a clip of their own, and their mattes.

        Args:
            numbers: of the frames.
        """
        plate = FileHandle(path=self.plate.path, sha256=self.plate.sha256)
        frames = tuple(self.frames[number] for number in numbers)
        return self.footage.clip(frames, plate), tuple(self.mattes[number] for number in numbers)

    def still(self, number: int) -> ClipHandle:
        """Return one frame for a step that needs the camera but no time.

        Args:
            number: of the frame.
        """
        return self.footage.still(self.frames[number], self.plate, camera=True)

    def shot(self, motion: FileHandle, person: FileHandle) -> ShotHandle:
        """Return everything that films are rendered from.

        Args:
            motion: of the whole clip.
            person: with the texture.
        """
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
    """All windows of a clip, and the person's identity.

    Attributes:
        resumed: frames whose fit an earlier run had finished.
        fronts: which way the person faces, per segment whose windows fitted both fronts.
    """

    windows: tuple[WindowHandle, ...]
    person: FileHandle
    resumed: frozenset[int] = field(default_factory=frozenset)
    fronts: Mapping[int, FrontRecord] = field(default_factory=dict)


def see(inputs: VideoInputs, config: RunConfig, folder: Path, look: Callable[[], None]) -> Scene:
    """Extract the frames, find the plate, and estimate the matte of every frame in which the person is visible.

    Args:
        inputs: of the run.
        config: all options.
        folder: of intermediate files.
        look: see `Scene`.

    Raises:
        InputError: the footage, the plate or the track cannot be used, or no frame shows a person.
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
        ExtractCall(footage=footage, plate=plate, start=at, stop=min(at + CHUNK, footage.count), folder=folder)
        for at in range(0, footage.count, CHUNK)
    ]
    extracted = require_all(extract_frames, chunks, "frames", look)
    frames = tuple(file for chunk in extracted for file in chunk.files)
    if moves := tell_distances([distance for chunk in extracted for distance in chunk.beside_px]):
        tell(moved := input_warnings((moves,), (moves,)))
        plate_faults += moved
    if exposures := describe_gains([frame.gain for frame in frames]):
        progress.say(f"hfb: {exposures}")
    calls = [
        MatteCall(
            still=footage.still(frame, plate),
            number=number,
            box=box,
            alone=alone,
            config=config.matting,
            network=inputs.matting,
            landmarks=config.init.landmarks,
            pose_networks=shade_networks(config.init, inputs.networks),
            quick=config.fit.matte_again,
            folder=folder,
        )
        for number, (frame, box) in enumerate(zip(frames, track.boxes, strict=True))
        if box is not None
    ]
    found = dict(zip((call.number for call in calls), require_all(find_matte, calls, "mattes", look), strict=True))
    mattes = {number: one.file for number, one in found.items() if one.file is not None}
    if not mattes:
        reason = next((one.reason for one in found.values()), _NOBODY)
        raise InputError(f"nobody is seen in any of the {footage.count} frames ({reason})")
    areas = tuple(found[number].area_px if number in found else 0.0 for number in range(len(frames)))
    unseen = {n: found[n].reason if n in found else _NOBODY for n in range(len(frames)) if n not in mattes}
    return Scene(inputs, config, folder, footage, plate, frames, mattes, areas, unseen, look, plate_faults)


def _check_plate(inputs: VideoInputs, plate: PlateHandle, track: TrackHandle) -> tuple[ResultWarning, ...]:
    """Return warnings where the plate contains the person."""
    if HOLDS_PERSON in plate.source:
        told = (f"it seems that {HOLDS_PERSON}",)
        return input_warnings(told, told)
    never = check_never_left(track.boxes) if inputs.plate == "median" else None
    return (never,) if never else ()


def find_first_bodies(scene: Scene) -> ClipBodiesHandle:
    """Find a body for every frame except in long gaps.

    Args:
        scene: the clip.

    Raises:
        InputError: no body is found in any frame.
    """
    config, body, networks = scene.config, scene.inputs.body, scene.inputs.networks
    own = caller_parts().initializer is not None
    if scene.inputs.init_files and not own:
        return _bodies_of_result(scene)
    tell_networks(() if own else networks)
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
    searched = require_all(find_key_body, calls, "first bodies", scene.look)
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
    placed = require_all(find_body_between, between, "first bodies between", scene.look)
    known |= {number: one.first for number, one in zip(others, placed, strict=True) if one.first is not None}
    return _fill(scene, known, dict(zip([*keys, *others], [*searched, *placed], strict=True)))


def _bodies_of_result(scene: Scene) -> ClipBodiesHandle:
    """Align another system's bodies with their mattes; frames without the person are filled from their neighbours."""
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
    placed = require_all(find_given_body, calls, "first bodies of the result", scene.look)
    found = {call.number: one.first for call, one in zip(calls, placed, strict=True) if one.first is not None}
    if not found:
        raise InputError(f"the result has a body for none of the frames ({placed[0].reason}); say with --init.frame")
    return _fill(scene, found, dict(zip(sorted(scene.mattes), placed, strict=True)))


def _fill(scene: Scene, known: Mapping[int, FirstBodyHandle], looked: Mapping[int, BodyFound]) -> ClipBodiesHandle:
    """Fill the other frames from their neighbours' bodies."""
    numbers = tuple(sorted(known))
    reasons = {**scene.unseen, **{number: one.reason for number, one in looked.items() if one.first is None}}
    whole = fill_bodies(
        numbers=numbers,
        firsts=tuple(known[number] for number in numbers),
        present=tuple(number in scene.mattes for number in range(len(scene.frames))),
        longest_fill=scene.config.video.longest_fill,
        folder=scene.folder,
    )
    return whole.model_copy(update={"reasons": dict(sorted(reasons.items()))})


def fit_windows(scene: Scene, bodies: ClipBodiesHandle, on_fitted: Callable[[tuple[int, ...], float], None]) -> Fitted:
    """Estimate the identity from a few pairs of frames, then fit every window with it.

    Args:
        scene: the clip.
        bodies: its first bodies.
        on_fitted: called in order with the frames that a window adds and its loss.
    """
    config = scene.config
    usable = np.array(bodies.usable, bool)
    pairs, windows = plan_windows(usable, 2), plan_windows(usable, config.video.window)
    settling = person_windows(pairs, np.array(scene.areas), config.video.person_windows)
    first_calls = [_window_call(scene, bodies, pairs[index], None) for index in settling]
    first_fits = require_all(fit_clip_window, first_calls, "who it is", scene.look)
    fronts = weigh_segments(first_fits)
    bodies = _turn_bodies(scene, bodies, windows, fronts)
    again = [
        index
        for index, found in zip(settling, first_fits, strict=True)
        if found.mirrored != (found.segment in fronts and fronts[found.segment].mirrored)
    ]
    if again:  # neighbours outvoted what these windows kept
        calls = [_window_call(scene, bodies, pairs[index], None, turned=True) for index in again]
        refitted = dict(
            zip(again, require_all(fit_clip_window, calls, "who it is, other front", scene.look), strict=True)
        )
        first_fits = [refitted.get(index, found) for index, found in zip(settling, first_fits, strict=True)]
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
    fits = tuple(require_all(fit_clip_window, calls, "windows", scene.look, on_outcome=fitted))
    return Fitted(fits, person, frozenset(resumed), fronts)


def _turn_bodies(
    scene: Scene, bodies: ClipBodiesHandle, windows: Sequence[ClipWindow], fronts: Mapping[int, FrontRecord]
) -> ClipBodiesHandle:
    """Mirror the bodies of segments that are likelier to face the other way."""
    mirrored = {segment for segment, front in fronts.items() if front.mirrored}
    numbers = sorted({frame for one in windows if one.segment in mirrored for frame in one.frames})
    if not numbers:
        return bodies
    calls = [
        MirrorCall(
            number=number,
            still=scene.still(number),
            matte=scene.mattes[number],
            body=scene.inputs.body,
            folder=scene.folder,
            first=first,
        )
        for number in numbers
        if (first := bodies.firsts[number]) is not None
    ]
    turned = dict(zip(numbers, require_all(mirror_body, calls, "other front", scene.look), strict=True))
    return bodies.model_copy(
        update={"firsts": tuple(turned.get(number, one) for number, one in enumerate(bodies.firsts))}
    )


def join(scene: Scene, fitted: Fitted) -> JoinedHandle:
    """Join all windows into one continuous motion.

    Args:
        scene: the clip.
        fitted: its windows.
    """
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


def _window_call(
    scene: Scene, bodies: ClipBodiesHandle, window: ClipWindow, person: FileHandle | None, *, turned: bool = False
) -> WindowCall:
    config, inputs = scene.config, scene.inputs
    of_fit = person_config(config) if person is None else window_config(config)
    if turned:
        of_fit = of_fit.model_copy(update={"both_fronts": False})
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
        turned=turned,
        config=of_fit,
        seed=config.seed,
        folder=scene.folder,
    )


def _assign_frames(windows: Sequence[ClipWindow]) -> list[tuple[int, ...]]:
    """Return per window the frames that no earlier window has."""
    seen: set[int] = set()
    settled = []
    for window in windows:
        settled.append(tuple(frame for frame in window.frames if frame not in seen))
        seen.update(window.frames)
    return settled


def _around(number: int, known: Mapping[int, FirstBodyHandle]) -> tuple[tuple[int, FirstBodyHandle], ...]:
    """Return the nearest known bodies before and after a frame; with more, every frame would depend on all."""
    before = max((frame for frame in known if frame < number), default=None)
    after = min((frame for frame in known if frame > number), default=None)
    return tuple((frame, known[frame]) for frame in (before, after) if frame is not None)
