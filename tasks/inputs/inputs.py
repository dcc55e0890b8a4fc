"""The user's inputs, identified by content before anything is computed. Light to import."""

from __future__ import annotations

import logging
from pathlib import Path

from hfb.config import OWN_NETWORKS, ExposureConfig, InitConfig, Record, RunConfig
from hfb.errors import InputError
from hfb.interop.writers.export_names import check_formats
from hfb.io.clip import Clip, ClipExposure, read_clip
from hfb.io.names import is_text
from hfb.networks.mediapipe_files import LandmarkChoice, networks_in_use
from hfb.tasks.core.handles import FileHandle, ReadoutRecord, files_in
from hfb.tasks.inputs.given_networks import init_files, matting_file
from hfb.tasks.inputs.out_place import check_pictures_out

_log = logging.getLogger(__name__)
_OF_VIDEOS = ("video", "scan", "start", "stop", "start_s", "stop_s", "background", "person")
"""Entries of clip.toml without effect on single images, whose plate is given."""

_ONE_OF = {"frames": "frame", "first_bodies": "first_body", "networks": "network", "init_files": "init_file"}


class Inputs(Record):
    """All inputs of a user, as they were when the run began."""

    frames: tuple[FileHandle, ...]
    background: FileHandle
    clip: Clip = Clip()
    body: FileHandle | None = None
    pose_prior: FileHandle | None = None
    motion_prior: FileHandle | None = None
    truth: FileHandle | None = None
    first_bodies: tuple[FileHandle, ...] = ()
    networks: tuple[FileHandle, ...] = ()
    matting: FileHandle | None = None
    init_files: tuple[FileHandle, ...] = ()


def input_file(path: Path) -> FileHandle:
    """Return the handle of a user's file.

    Args:
        path: the file.

    Raises:
        InputError: it is missing, cannot be read, or has a name that servers and records cannot hold.
    """
    if "\0" in str(path):
        raise InputError(f"{str(path)!r} is no name of a file")
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the file itself")
    try:
        handle = FileHandle.of(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    if not is_text(handle.path):
        raise InputError(f"{handle.path} has a name that is not text in UTF-8: rename it, or the folder that it is in")
    return handle


def take_inputs(
    frames: list[Path],
    background: Path,
    config: RunConfig,
    clip: Path | None = None,
    *,
    truth: Path | None = None,
    first_bodies: list[Path] | None = None,
    out: Path | None = None,
) -> Inputs:
    """Hash all inputs that the user names.

    Args:
        frames: blurred images, in their order.
        background: the same view without the person.
        config: all options.
        clip: a clip.toml.
        truth: of a synthetic case.
        first_bodies: one file per frame, instead of estimates.
        out: where results go; it is checked.

    Raises:
        InputError: a file is missing or unreadable, clip.toml is wrong, or results in ``out`` would be read as frames.
    """
    if out is not None:
        check_pictures_out(frames, out)
    if first_bodies and len(first_bodies) != len(frames):
        raise InputError(f"{len(first_bodies)} first bodies for {len(frames)} frames: give one per frame")
    check_formats(config.export.formats)
    return Inputs(
        frames=tuple(input_file(frame) for frame in frames),
        background=input_file(background),
        clip=_clip_of_pictures(clip, frames[0]) if clip else Clip(),
        body=input_file(config.body.model) if config.body.model else None,
        pose_prior=input_file(config.prior.pose) if config.prior.pose else None,
        motion_prior=input_file(config.prior.motion) if config.prior.motion else None,
        truth=input_file(truth) if truth else None,
        first_bodies=tuple(input_file(first) for first in first_bodies or ()),
        networks=pose_networks(config.init) if not first_bodies else (),
        matting=optional_file(matting_file(config)),
        init_files=result_files(config) if not first_bodies else (),
    )


def assumptions(inputs: Inputs, config: RunConfig) -> list[str]:
    """Return sentences on assumptions about the recording, and on entries of clip.toml without effect.

    Args:
        inputs: of the run.
        config: all options.
    """
    clip, remarks = inputs.clip, []
    if config.camera.focal_px is None and not clip.camera.has_lens:
        remarks.append(
            "no calibration given: assuming a focal length of the picture's diagonal (--clip or --camera.focal-px)"
        )
    if find_exposure_s(inputs.frames[0].path, clip.exposure, config.exposure, interval_s=1.0) is None:
        detail = ", and the first picture does not tell it" if clip.exposure.auto else ""
        remarks.append(f"no exposure given{detail}: assuming the shutter is always open (--clip or --exposure.seconds)")
    used = clip.model_copy(update={"person": clip.person.model_copy(update={"height_m": None})})
    vain = [name for name in _OF_VIDEOS if getattr(used, name) != getattr(Clip(), name)]
    vain += ["exposure.position"] if clip.exposure.position != ClipExposure().position else []
    if vain:
        remarks.append(f"`hfb fit` does not use what clip.toml says of {', '.join(vain)}: that is for `hfb video`")
    return remarks


def with_height(config: RunConfig, clip: Clip) -> RunConfig:
    """Return the options with the person's height from clip.toml where no option gives it.

    Args:
        config: all options.
        clip: content of clip.toml.
    """
    if config.fit.height_m is not None or clip.person.height_m is None:
        return config
    fit = config.fit.model_copy(update={"height_m": clip.person.height_m})
    return config.model_copy(update={"fit": fit})


def find_exposure_s(picture: Path, exposure: ClipExposure, config: ExposureConfig, interval_s: float) -> float | None:
    """Return the exposure [s]: an option overrides clip.toml; None where neither gives it.

    Args:
        picture: whose metadata count where clip.toml says ``auto``.
        exposure: as in clip.toml.
        config: options of the exposure.
        interval_s: between frames.
    """
    told = config.seconds or exposure.exposure_s(interval_s)
    if told is None and exposure.auto:
        from hfb.io.media.images.image_io import recorded_exposure

        recorded = recorded_exposure(picture)
        told = recorded[0] if recorded else None
    return told


def find_readout(exposure: ClipExposure, config: ExposureConfig) -> ReadoutRecord | None:
    """Return the rolling shutter, an option before clip.toml; None where neither tells of one.

    Args:
        exposure: as in clip.toml.
        config: options of the exposure.

    Raises:
        InputError: only the direction is told.
    """
    seconds = exposure.readout_s if config.readout_s is None else config.readout_s
    to = config.readout_to or exposure.readout_to
    if to is not None and seconds is None:
        raise InputError(f"readout_to is {to}, but not how long the rows take: give readout_s, too, or leave both out")
    return ReadoutRecord(seconds=seconds, to=to or "down") if seconds else None


def _clip_of_pictures(path: Path, picture: Path) -> Clip:
    """Read clip.toml and replace its calibration file by the file's numbers.

    Raises:
        InputError: clip.toml or the calibration is wrong, or the lens distorts: single images are taken as they are.
    """
    clip = read_clip(path)
    if clip.camera.calibration is None:
        return clip
    from hfb.io.media.images.image_io import picture_size
    from hfb.io.media.lens.camera_pose import calibrated_pose, pose_remarks
    from hfb.io.media.lens.clip_lens import clip_lens

    height, width, _ = picture_size(picture)
    lens = clip_lens(clip.camera, picture.name, height, width)
    if lens is not None and lens.bends(height, width):
        raise InputError(
            f"{clip.camera.calibration}: this lens distorts; undistort the pictures and give K, or use `hfb video`, "
            "which undistorts by itself"
        )
    rotation, translation = calibrated_pose(clip.camera, picture.name) or (None, None)
    for remark in pose_remarks(clip.camera, picture.name):
        _log.warning(remark)
    numbers = {"K": lens.pinhole() if lens else None, "rotation": rotation, "translation": translation}
    camera = clip.camera.model_copy(update={"calibration": None, "name": None, **numbers})
    return clip.model_copy(update={"camera": camera})


def optional_file(path: Path | None) -> FileHandle | None:
    """Return the handle of a file, or None.

    Args:
        path: the file, or None.
    """
    return None if path is None else input_file(path)


def pose_networks(init: InitConfig) -> tuple[FileHandle, ...]:
    """Return the networks that the first bodies depend on.

    Args:
        init: options of the first bodies.

    Raises:
        InputError: a file that the method needs is missing.
    """
    if init.method in OWN_NETWORKS:
        return tuple(input_file(path) for path in init_files(init))
    return networks_at_hand(init.landmarks) if init.method in ("auto", "mediapipe") else ()


def result_files(config: RunConfig) -> tuple[FileHandle, ...]:
    """Return the files of the other system's result that the first bodies are taken from.

    Args:
        config: all options.

    Raises:
        InputError: a file is missing.
    """
    files = init_files(config.init)
    return tuple(input_file(path) for path in files) if config.init.method == "file" else ()


def networks_at_hand(choice: LandmarkChoice = "auto") -> tuple[FileHandle, ...]:
    """Return the installed pose networks: with others, first bodies are estimated again.

    Args:
        choice: which landmark network.

    Raises:
        InputError: as `networks_in_use`.
    """
    return tuple(FileHandle.of(path) for path in networks_in_use(choice))


def input_files(inputs: Record) -> dict[str, FileHandle]:
    """Return the inputs by role: ``frame_0``, ``background``, ...

    Args:
        inputs: of the run.
    """
    files: dict[str, FileHandle] = {}
    for role in type(inputs).model_fields:
        value = getattr(inputs, role)
        for index, file in enumerate(files_in(value)):
            several = isinstance(value, tuple)
            files[f"{_ONE_OF.get(role, role)}_{index}" if several else role] = file
    return files


def input_hashes(inputs: Record) -> dict[str, str]:
    """Return the sha256 of every input by role: ``frame_0``, ``background``, ...

    Args:
        inputs: of the run.
    """
    return {role: file.sha256 for role, file in input_files(inputs).items()}
