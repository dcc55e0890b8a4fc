"""The tasks of single frames: images out of the footage, matte, first body."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hfb.config import InitConfig, MattingConfig
from hfb.errors import InputError
from hfb.networks.mediapipe_files import LandmarkChoice
from hfb.tasks.core.caller_parts import caller_parts
from hfb.tasks.core.handles import Call, FileHandle, FirstBodyHandle, FrameHandle
from hfb.tasks.core.video_handles import BodyFound, FootageHandle, FrameCall, FramesHandle, MatteHandle, SeenFrameCall
from hfb.tasks.inputs.given_networks import check_networks, person_matting, with_pose_network
from hfb.tasks.task import task
from hfb.typing import Array

if TYPE_CHECKING:
    from hfb.motion.static_pose import FirstBody


class ExtractCall(Call):
    """Frames `start` to `stop` (exclusive) of a clip, and its background, with whose exposure they are compared."""

    footage: FootageHandle
    plate: FileHandle
    start: int
    stop: int
    folder: Path


class MatteCall(FrameCall):
    """A frame whose matte is to be estimated.

    Attributes:
        box: of the person [px].
        alone: whether the person is the only one in the clip.
        config: options of the matte.
        network: the user's own, for methods that need one.
        landmarks: choice among the landmark networks.
        pose_networks: those that tell the person from shade on the floor, by `shade_networks`.
        quick: the windows' fits refine the matte.
    """

    box: tuple[float, float, float, float]
    alone: bool
    config: MattingConfig
    network: FileHandle | None
    landmarks: LandmarkChoice
    pose_networks: tuple[FileHandle, ...]
    quick: bool


class KeyBodyCall(SeenFrameCall):
    """A key frame, whose first body is estimated without neighbours.

    Attributes:
        config: options of the first body.
        networks: the installed pose networks, or the user's own; others give a new estimate.
    """

    config: InitConfig
    networks: tuple[FileHandle, ...]


class BetweenCall(SeenFrameCall):
    """A frame between key frames.

    Attributes:
        known: the bodies of the key frames around it, with their numbers.
    """

    known: tuple[tuple[int, FirstBodyHandle], ...]


@task("frames", where="worker")
def extract_frames(call: ExtractCall) -> FramesHandle:
    """Write some frames as images, so that no later step has to read the video.

    Args:
        call: the frames.
    """
    from hfb.io.media.images.image_io import read_picture_srgb, write_png
    from hfb.matting.exposure_match import frame_gain
    from hfb.matting.plate_check import plate_distance_px
    from hfb.tasks.core.scene import in_light
    from hfb.tasks.video.video_clip import reading

    def linear(stored: Array) -> Array:
        return in_light(stored, call.footage.transfer, "linear").numpy()

    empty = linear(read_picture_srgb(call.plate.path))
    start, stop, bits = call.start, call.stop, call.footage.bits
    frames: list[FrameHandle] = []
    beside_px: list[float] = []
    with reading(call.footage, start, stop) as footage:
        for number, frame in enumerate(footage.frames(start, stop), start):
            path = call.folder / f"frame_{number:06d}.png"
            write_png(path, frame, bits=bits)
            frames.append(FrameHandle.of(path, gain=frame_gain(linear(frame), empty)))
            if number in (start, stop - 1):
                beside_px.append(plate_distance_px(linear(frame), empty))
    if len(frames) != stop - start:
        raise InputError(
            f"frame {start + len(frames)} can no longer be read: the footage has changed; run the same command again"
        )
    return FramesHandle(files=tuple(frames), beside_px=tuple(beside_px))


@task("mattes", where="cluster")
def find_matte(call: MatteCall) -> MatteHandle:
    """Estimate the matte of one frame; a frame without a person is a gap, not a failure.

    Args:
        call: the frame.
    """
    import numpy as np

    from hfb.io.media.images.image_io import write_matte
    from hfb.tasks.core.scene import load_image
    from hfb.tracking.tracks import keep_person, surroundings

    matting = caller_parts().matting or person_matting(
        call.config, call.network, call.landmarks, call.pose_networks, quick=call.quick
    )
    frame, plate = (load_image(one, call.still).numpy() for one in (call.still.frames[0], call.still.background))
    # A matte is of the largest thing that differs, which may be somebody else: each is then looked at alone.
    near = np.s_[:, :] if call.alone else surroundings(np.asarray(call.box), *frame.shape[:2])
    alpha = np.zeros(frame.shape[:2], np.float32)
    try:
        alpha[near] = matting(frame[near], plate[near])
        alpha = keep_person(alpha, np.asarray(call.box))
    except InputError as error:
        return MatteHandle(file=None, reason=str(error))
    path = call.folder / f"matte_{call.number:06d}.png"
    write_matte(path, alpha)
    return MatteHandle(file=FileHandle.of(path), area_px=round(float(alpha.sum()), 3))


@task("first bodies", where="cluster")
def find_key_body(call: KeyBodyCall) -> BodyFound:
    """Estimate the first body of a key frame.

    Args:
        call: the frame.
    """
    from hfb.initialization.fronts import front_doubts
    from hfb.initialization.initializer import make_initializer
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    initializer = caller_parts().initializer
    if initializer is None:
        check_networks(call.config, call.networks)
        initializer = make_initializer(with_pose_network(call.config, call.networks))
    seen, model = load_observation(call.still, (call.matte,)), load_chosen_body(call.body)
    try:
        found = initializer(seen.frames_linear[0], seen.plate_linear, seen.mattes[0], seen.camera, model)
        doubt = float(front_doubts(seen, [found], model)[0])
    except InputError as error:
        return BodyFound(first=None, reason=str(error))
    return BodyFound(first=write_body(call.folder / f"key_body_{call.number:06d}.npz", found, doubt))


@task("first bodies between", where="cluster")
def find_body_between(call: BetweenCall) -> BodyFound:
    """Estimate the first body of a frame from the bodies of the key frames around it.

    Args:
        call: the frame.
    """
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.core.scene import load_chosen_body, load_observation
    from hfb.tracking.clip_bodies import body_between

    seen, model = load_observation(call.still, (call.matte,)), load_chosen_body(call.body)
    around = {frame: load_first_body(first.path) for frame, first in call.known}
    try:
        found = body_between(call.number, around, seen.mattes[0].numpy(), seen.camera, model)
    except InputError as error:
        return BodyFound(first=None, reason=str(error))
    return BodyFound(first=write_body(call.folder / f"first_body_{call.number:06d}.npz", found))


def write_body(path: Path, found: FirstBody, doubt: float = 0.0) -> FirstBodyHandle:
    """Write a first body and return its handle.

    Args:
        path: the file.
        found: the body.
        doubt: see `FirstBodyHandle`.
    """
    from hfb.motion.static_pose import save_first_body

    save_first_body(path, found)
    return FirstBodyHandle.of(path, source=found.source, doubt=doubt)
