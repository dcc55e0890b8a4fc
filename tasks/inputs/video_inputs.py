"""The user's inputs of a clip, identified by content before anything is computed. Light to import."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from hfb.config import Record, RunConfig
from hfb.errors import InputError
from hfb.interop.writers.export_names import check_formats
from hfb.io.clip import Clip, PersonChoice, read_clip
from hfb.tasks.core.handles import FileHandle, digest
from hfb.tasks.inputs.clip_places import plate_beside, resolve_source
from hfb.tasks.inputs.given_networks import matting_file
from hfb.tasks.inputs.inputs import input_file, input_files, optional_file, pose_networks, result_files
from hfb.tasks.inputs.out_place import check_clip_out

_FOUND: tuple[Literal["median"], Literal["still"]] = ("median", "still")


class VideoInputs(Record):
    """All inputs of a user, as they were when the run began.

    Attributes:
        video: one file, or the images of a folder in their order.
        plate: origin of the background; ``"file"`` is ``background``.
        clip: content of clip.toml; the files that it names are handles of their own.
    """

    video: tuple[FileHandle, ...]
    plate: Literal["file", "median", "still"]
    background: FileHandle | None = None
    clip: Clip = Clip()
    calibration: FileHandle | None = None
    track: FileHandle | None = None
    body: FileHandle | None = None
    pose_prior: FileHandle | None = None
    motion_prior: FileHandle | None = None
    truth: FileHandle | None = None
    networks: tuple[FileHandle, ...] = ()
    matting: FileHandle | None = None
    init_files: tuple[FileHandle, ...] = ()


def take_video_inputs(
    source: Path | tuple[Path, ...],
    config: RunConfig,
    clip: Path | None = None,
    background: str | None = None,
    *,
    truth: Path | None = None,
    everyone: bool = False,
    out: Path | None = None,
) -> VideoInputs:
    """Hash all inputs that the user names.

    Args:
        source: see `hfb.tasks.inputs.clip_places.resolve_source`; or the images in their order, beside which no plate
            is looked for.
        config: all options.
        clip: a clip.toml that overrides one that is found.
        background: a file, ``"median"`` or ``"still"``; overrides clip.toml, which overrides a plate beside the clip.
        truth: a motion file.
        everyone: whether to fit all visible people (or all in the file of tracks), whatever clip.toml says of the
            person.
        out: where results go; it is checked.

    Raises:
        InputError: a file is missing or cannot be read, clip.toml is wrong, it is not clear which video is meant, or
            results in ``out`` would be read as frames.
    """
    check_formats(config.export.formats)
    files, clip_path = (source, clip) if isinstance(source, tuple) else resolve_source(source, clip)
    if out is not None:
        check_clip_out(source if isinstance(source, Path) else files[0], files, out)
    known = read_clip(clip_path) if clip_path else Clip()
    beside = () if isinstance(source, tuple) else files
    how, plate = _plate(background or known.background, beside)
    person, camera = known.person, known.camera
    if everyone:
        if person.height_m is not None:
            raise InputError(f"{clip_path}: height_m is one person's, and everyone is meant: leave one of them out")
        person = PersonChoice(which="everyone", track=person.track)
    # What the files hold counts, not where they lie.
    told = known.model_copy(
        update={
            "video": None,
            "background": None,
            "person": person.model_copy(update={"track": Path(person.track.name)}) if person.track else person,
            "camera": camera.model_copy(update={"calibration": Path(camera.calibration.name)})
            if camera.calibration
            else camera,
        }
    )
    return VideoInputs(
        video=tuple(input_file(path) for path in files),
        plate=how,
        background=plate,
        clip=told,
        calibration=input_file(camera.calibration) if camera.calibration else None,
        track=input_file(person.track) if person.track else None,
        body=input_file(config.body.model) if config.body.model else None,
        pose_prior=input_file(config.prior.pose) if config.prior.pose else None,
        motion_prior=input_file(config.prior.motion) if config.prior.motion else None,
        truth=input_file(truth) if truth else None,
        networks=pose_networks(config.init),
        matting=optional_file(matting_file(config)),
        init_files=result_files(config),
    )


def check_options(config: RunConfig) -> None:
    """Raise InputError if a file that the options name cannot be used: this concerns every clip.

    Args:
        config: all options.
    """
    check_formats(config.export.formats)
    for path in (config.body.model, config.prior.pose, config.prior.motion, matting_file(config)):
        optional_file(path)
    pose_networks(config.init)
    result_files(config)


def video_hashes(inputs: VideoInputs) -> dict[str, str]:
    """Return the sha256 by role; the images of a folder, possibly thousands, count as one.

    Args:
        inputs: of the run.
    """
    hashes = {role: file.sha256 for role, file in input_files(inputs).items() if not role.startswith("video_")}
    video = inputs.video
    return {"video": video[0].sha256 if len(video) == 1 else digest(video), **hashes}


def _plate(told: str | None, files: tuple[Path, ...]) -> tuple[Literal["file", "median", "still"], FileHandle | None]:
    """Return the origin of the background, and its file."""
    for how in _FOUND:
        if told == how:
            return how, None
    path = Path(told) if told else plate_beside(files) if files else None
    if path is None:
        return "median", None
    try:
        return "file", input_file(path)
    except InputError as error:
        raise InputError(f"the background {error}; give a picture, median or still") from None
