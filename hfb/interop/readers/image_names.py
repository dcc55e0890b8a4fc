"""Matching of a result's images to a clip's frames by file names."""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hfb.interop.readers.pose_track import PoseTrack

_NUMBER = re.compile(r"\d{1,15}")
_SUFFIX = re.compile(r"(\.[A-Za-z]\w{0,4})+$")
_ADDED = re.compile(r"_(keypoints|rendered|vis|pose|result|results|overlay)$", re.IGNORECASE)
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ClipPictures:
    """The images that a result is matched with.

    Attributes:
        names: names of the clip's files, in the order of its frames; empty for a video.
        frames: frames of a video, 0 where unknown.
    """

    names: tuple[str, ...] = ()
    frames: int = 0


def stem(name: str) -> str:
    """Return an image's name without folders, endings and what systems add to it.

    Args:
        name: name of an image, with or without folders.
    """
    plain = re.split(r"[/\\]", name)[-1]
    return _ADDED.sub("", _SUFFIX.sub("", plain)).lower()


def number_in(name: str) -> int | None:
    """Return the last number in an image's name.

    Args:
        name: name of an image, with or without folders.
    """
    found = _NUMBER.findall(stem(name))
    return int(found[-1]) if found else None


def by_pictures(tracks: Sequence[PoseTrack], clip: ClipPictures) -> list[PoseTrack]:
    """Return the tracks with the clip's own frame numbers where they know the names of their images.

    Rows of images that the clip does not have are dropped. Where no name matches, all stay as they are.

    Args:
        tracks: tracks of one result.
        clip: names of its frames' files.
    """
    images = {name for track in tracks for name in track.images or ()}
    frames = _frames_of(images, clip) if images else {}
    if not frames:
        return list(tracks)
    return [_numbered(track, frames) for track in tracks]


def _numbered(track: PoseTrack, frames: dict[str, int]) -> PoseTrack:
    if track.images is None:
        return track
    kept = np.array([row for row, name in enumerate(track.images) if name in frames], np.int64)
    numbers = np.array([frames[track.images[row]] for row in kept], np.int64)
    return replace(track.rows(kept), frames=numbers)


def _frames_of(images: set[str], clip: ClipPictures) -> dict[str, int]:
    """Return the clip's frame of each image; empty where the numbers in the names are used."""
    own = {stem(name): frame for frame, name in enumerate(clip.names)}
    if len(own) == len(clip.names):
        same = {name: own[stem(name)] for name in images if stem(name) in own}
        if same:
            return same
    numbers = {name: number for name in images if (number := number_in(name)) is not None}
    by_number = {number_in(name): frame for frame, name in enumerate(clip.names)}
    if clip.names and None not in by_number and len(by_number) == len(clip.names):
        same = {name: by_number[number] for name, number in numbers.items() if number in by_number}
        if same:
            return same
    count = len(clip.names) or clip.frames
    if count and numbers and min(numbers.values()) >= 1 and max(numbers.values()) == count:
        _log.warning(
            "the result's pictures are numbered from 1 to %d: its picture 1 is taken for the first frame", count
        )
        return {name: number - 1 for name, number in numbers.items()}
    return {}
