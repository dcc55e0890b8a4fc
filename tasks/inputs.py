"""What a user hands over, taken by content before anything is computed. Light to import."""

from __future__ import annotations

from pathlib import Path

from hfb.clip import Clip, ClipCamera, ClipExposure, read_clip
from hfb.config import Record, RunConfig
from hfb.errors import InputError
from hfb.initialize.networks import NETWORKS, network_path
from tasks.handles import FileHandle, files_in

_ONE_OF = {"frames": "frame", "first_bodies": "first_body", "networks": "network"}


class Inputs(Record):
    """Everything a user hands over, as it was when the run began."""

    frames: tuple[FileHandle, ...]
    background: FileHandle
    clip: Clip = Clip()
    body: FileHandle | None = None
    pose_prior: FileHandle | None = None
    motion_prior: FileHandle | None = None
    truth: FileHandle | None = None
    first_bodies: tuple[FileHandle, ...] = ()
    networks: tuple[FileHandle, ...] = ()


def input_file(path: Path) -> FileHandle:
    """The handle of a user's file.

    Raises:
        InputError: it is not there, or cannot be read.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the file itself")
    try:
        return FileHandle.of(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error


def take_inputs(
    frames: list[Path],
    background: Path,
    config: RunConfig,
    clip: Path | None = None,
    truth: Path | None = None,
    first_bodies: list[Path] | None = None,
) -> Inputs:
    """Everything the user names, hashed.

    Raises:
        InputError: a file is missing, cannot be read, or clip.toml is wrong.
    """
    if first_bodies and len(first_bodies) != len(frames):
        raise InputError(f"{len(first_bodies)} first bodies for {len(frames)} frames: give one per frame")
    return Inputs(
        frames=tuple(input_file(frame) for frame in frames),
        background=input_file(background),
        clip=read_clip(clip) if clip else Clip(),
        body=input_file(config.body.model) if config.body.model else None,
        pose_prior=input_file(config.prior.pose) if config.prior.pose else None,
        motion_prior=input_file(config.prior.motion) if config.prior.motion else None,
        truth=input_file(truth) if truth else None,
        first_bodies=tuple(input_file(first) for first in first_bodies or ()),
        networks=networks_at_hand() if config.init.method != "matte" and not first_bodies else (),
    )


def assumptions(inputs: Inputs, config: RunConfig) -> list[str]:
    """What the user did not say about the recording, and what is assumed instead; one sentence each."""
    assumed = []
    if config.camera.focal_px is None and inputs.clip.camera == ClipCamera():
        assumed.append(
            "no calibration given: assuming a focal length of the picture's diagonal (--clip or --camera.focal-px)"
        )
    if config.exposure.seconds is None and inputs.clip.exposure == ClipExposure():
        assumed.append("no exposure given: assuming the shutter is always open (--clip or --exposure.seconds)")
    return assumed


def networks_at_hand() -> tuple[FileHandle, ...]:
    """The pose networks that `hfb models` has fetched: with new ones the first bodies are estimated again."""
    found = (network_path(network) for network in NETWORKS)
    return tuple(FileHandle.of(path) for path in found if path is not None)


def input_hashes(inputs: Inputs) -> dict[str, str]:
    """sha256 per role: ``frame_0``, ``background``, ..."""
    hashes: dict[str, str] = {}
    for role in type(inputs).model_fields:
        given = getattr(inputs, role)
        for index, file in enumerate(files_in(given)):
            hashes[f"{_ONE_OF[role]}_{index}" if role in _ONE_OF else role] = file.sha256
    return hashes
