"""The tasks of single frames: pictures out of the footage, matte, first body."""

from __future__ import annotations

from pathlib import Path

from hfb.config import InitConfig, MattingConfig
from hfb.errors import InputError
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle
from hfb.tasks.core.task import task
from hfb.tasks.core.video_handles import BodyFound, FootageHandle, FramesHandle, MatteHandle
from hfb.tasks.inputs.given_networks import check_networks, with_matting_network, with_pose_network
from hfb.tasks.workers.workers import compute, spread

_Box = tuple[float, float, float, float]


@task("frames")
def extract_frames(footage: FootageHandle, start: int, stop: int, folder: Path) -> FramesHandle:
    """Frames `start` to `stop` (exclusive) as pictures, so that no later step has to read the video."""
    return compute(_extract, footage, start, stop, folder)


@task("mattes")
def find_matte(
    still: ClipHandle,
    number: int,
    box: _Box | None,
    alone: bool,
    config: MattingConfig,
    network: FileHandle | None,
    folder: Path,
) -> MatteHandle:
    """The matte of one frame; a frame without anybody is a gap, and no failure.

    Args:
        network: the user's own, for methods that need one.
        box: where the person is; None where nobody is.
        alone: nobody else is seen in the clip.
    """
    if box is None:
        return MatteHandle(file=None, reason="nobody differs from the background")
    return spread(_matte, still, number, box, alone, config, network, folder)


@task("first bodies")
def find_key_body(
    still: ClipHandle,
    number: int,
    matte: FileHandle,
    body: FileHandle | None,
    config: InitConfig,
    networks: tuple[FileHandle, ...],
    folder: Path,
) -> BodyFound:
    """The first body of a key frame, looked for from nothing.

    Args:
        networks: the pose networks at hand, or METRO's; with other ones the estimate is made again.
    """
    return spread(_key_body, still, number, matte, body, config, networks, folder)


@task("first bodies between")
def find_body_between(
    still: ClipHandle,
    number: int,
    matte: FileHandle,
    known: tuple[tuple[int, FirstBodyHandle], ...],
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    """The first body of another frame, from the bodies of the key frames around it."""
    return spread(_body_between, still, number, matte, known, body, folder)


def _extract(footage: FootageHandle, start: int, stop: int, folder: Path) -> FramesHandle:
    from hfb.io.media.pictures import write_png
    from hfb.tasks.video.video_clip import reading

    paths = []
    with reading(footage, start, stop) as pictures:
        for number, frame in enumerate(pictures.frames(start, stop), start):
            paths.append(folder / f"frame_{number:06d}.png")
            write_png(paths[-1], frame, bits=footage.bits)
    if len(paths) != stop - start:
        raise InputError(
            f"frame {start + len(paths)} can no longer be read: the footage has changed; run the same command again"
        )
    return FramesHandle(files=tuple(FileHandle.of(path) for path in paths))


def _matte(
    still: ClipHandle,
    number: int,
    box: _Box,
    alone: bool,
    config: MattingConfig,
    network: FileHandle | None,
    folder: Path,
) -> MatteHandle:
    import numpy as np

    from hfb.io.media.pictures import write_matte
    from hfb.matting.methods import make_matting
    from hfb.tasks.core.scene import load_picture
    from hfb.tracking.tracks import keep_person, surroundings

    frame, plate = (load_picture(one, still).numpy() for one in (still.frames[0], still.background))
    # A matte is of the largest thing that differs, which may be somebody else: each is then looked at alone.
    near = np.s_[:, :] if alone else surroundings(np.asarray(box), *frame.shape[:2])
    alpha = np.zeros(frame.shape[:2], np.float32)
    try:
        alpha[near] = make_matting(with_matting_network(config, network))(frame[near], plate[near])
        alpha = keep_person(alpha, np.asarray(box))
    except InputError as error:
        return MatteHandle(file=None, reason=str(error))
    path = folder / f"matte_{number:06d}.png"
    write_matte(path, alpha)
    return MatteHandle(file=FileHandle.of(path), area_px=round(float(alpha.sum()), 3))


def _key_body(
    still: ClipHandle,
    number: int,
    matte: FileHandle,
    body: FileHandle | None,
    config: InitConfig,
    networks: tuple[FileHandle, ...],
    folder: Path,
) -> BodyFound:
    from hfb.initialization.initializer import make_initializer
    from hfb.tasks.core.scene import load_chosen_body, load_observation
    from hfb.tracking.clip_bodies import front_doubt

    check_networks(config, networks)
    initializer = make_initializer(with_pose_network(config, networks))
    seen, model = load_observation(still, (matte,)), load_chosen_body(body)
    try:
        found = initializer(seen.frames_linear[0], seen.plate_linear, seen.mattes[0], seen.camera, model)
        doubt = front_doubt(seen, found, model)
    except InputError as error:
        return BodyFound(first=None, reason=str(error))
    return BodyFound(first=saved_body(folder / f"key_body_{number:06d}.npz", found, doubt))


def _body_between(
    still: ClipHandle,
    number: int,
    matte: FileHandle,
    known: tuple[tuple[int, FirstBodyHandle], ...],
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.core.scene import load_chosen_body, load_observation
    from hfb.tracking.clip_bodies import body_between

    seen = load_observation(still, (matte,))
    around = {frame: load_first_body(first.path) for frame, first in known}
    try:
        found = body_between(number, around, seen.mattes[0].numpy(), seen.camera, load_chosen_body(body))
    except InputError as error:
        return BodyFound(first=None, reason=str(error))
    return BodyFound(first=saved_body(folder / f"first_body_{number:06d}.npz", found))


def saved_body(path: Path, found: object, doubt: float = 0.0) -> FirstBodyHandle:
    """The handle of a first body that is written now."""
    from hfb.motion.static_pose import FirstBody, save_first_body

    assert isinstance(found, FirstBody)
    save_first_body(path, found)
    return FirstBodyHandle.of(path, source=found.source, doubt=doubt)
