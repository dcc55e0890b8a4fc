"""Videos in a folder: files, or folders of numbered images; frames are read on demand.

Frames count from 0. A folder is one video per name of its numbered images (f001.png, f002.png, ...), if there are
eight or more of that name.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np

from hfb.errors import InputError
from hfb.io.clip import Clip, read_clip
from hfb.io.media.capture_rate import Rate, capture_remark, differs, stated_capture_rate
from hfb.io.media.footage_names import PICTURE_SUFFIXES
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.interlacing import Scan
from hfb.io.media.video.video_file import open_video, video_stream
from hfb.io.media.video.video_index import index_video
from hfb.io.media.video.video_reading import read_frames
from hfb.photometry import as_srgb, srgb_to_linear
from hfb.typing import Array, Bool, Float

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v"})
_LEAST_PICTURES = 8
_ASSUMED_FPS = 30.0
_LOOKED_AT = 300  # frames in which two fields are looked for
_JITTER = 0.25  # of a frame interval: containers round their times to milliseconds, dropped frames are off by 1
_NUMBERED = re.compile(r"(.*?)(\d+)")


@dataclass(frozen=True)
class Footage:
    """One video of a static camera.

    Attributes:
        path: the video file, or the first of its numbered images.
        pictures: the numbered images in order; empty for a video file.
        stem: name without ending, shared by its companion files.
        fps: frames per second; fps_known is False where nothing says and 30 was assumed.
        steady: for every frame but the last, whether the next one follows after one regular interval.
        clip: its clip.toml, or an empty one.
        remarks: remarks for the user on how it is read.
    """

    path: Path
    pictures: tuple[Path, ...]
    stem: str
    fps: float
    fps_known: bool
    steady: Bool[Array, "n"]
    clip: Clip
    remarks: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """How many frames it has."""
        return len(self.steady) + 1

    def stored_frames(self, start: int, stop: int) -> Iterator[Float[Array, "H W 3"]]:
        """Yield the frames from `start` up to `stop` as stored in [0, 1], one after another (see `to_linear`).

        Args:
            start: first frame.
            stop: frame after the last one.

        Raises:
            InputError: a frame cannot be read, or the video ends before `stop`.
        """
        given = 0
        for stored in self._stored(start, stop):
            given += 1
            yield stored
        if given < stop - start:
            raise InputError(f"{self.path}: ends at frame {start + given}, before frame {stop}; convert it to H.264.")

    def to_linear(self, stored: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """Convert a stored image, or a part of one, to linear light.

        Args:
            stored: image or part of one, as stored in [0, 1].
        """
        return stored if self.clip.transfer == "linear" else srgb_to_linear(as_srgb(stored, self.clip.transfer))

    def _stored(self, start: int, stop: int) -> Iterator[Float[Array, "H W 3"]]:
        if not self.pictures:
            return read_frames(self.path, start, stop)
        return (read_picture_srgb(path) for path in self.pictures[start:stop])


def find_footage(folder: Path) -> tuple[list[Footage], dict[str, str]]:
    """Return the videos in the order of their relative paths, and by relative path why others cannot be used.

    Args:
        folder: searched with its subfolders.

    Raises:
        InputError: the folder is missing or holds no video at all.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; give the folder that holds the videos.")
    found, refused = [], {}
    for first, pictures in _candidates(folder):
        try:
            found.append(_looked_at(open_footage(first, pictures)))
        except InputError as error:
            refused[first.relative_to(folder).as_posix()] = str(error)
    if not found and not refused:
        raise InputError(f"{folder} holds no video; put .mp4, .mov, .avi, .mkv or .webm files or numbered pictures in.")
    return found, refused


def open_footage(path: Path, pictures: tuple[Path, ...] = ()) -> Footage:
    """Look at one video: how many frames, how fast; nothing is decoded.

    Args:
        path: the video file, or the first of the images.
        pictures: its numbered images, for a video that is a folder of them; found again when not given.

    Raises:
        InputError: no video, too short, images missing in between, or a clip.toml that is wrong.
    """
    if not pictures and path.suffix.lower() in PICTURE_SUFFIXES:
        pictures = dict(_picture_runs(path.parent)).get(path, ())
    stem = _stem_of_pictures(pictures) if pictures else path.stem
    clip = _clip_beside(path, stem)
    if pictures:
        _check_numbers(pictures)
        fps, steady = clip.exposure.fps or _ASSUMED_FPS, np.ones(len(pictures) - 1, bool)
        return Footage(path, pictures, stem, fps, clip.exposure.fps is not None, steady, clip)
    fps, steady, remarks = _timing(path, clip.exposure.fps)
    return Footage(path, (), stem, fps, True, steady, clip, remarks)


def _looked_at(footage: Footage) -> Footage:
    """Return the footage with the remarks of `hfb video` on the file.

    Raises:
        InputError: it is interlaced.
    """
    if footage.pictures:
        return footage
    index = index_video(footage.path)
    scan = Scan(footage.path, index.interlaced) if footage.clip.scan == "auto" else None
    if scan:
        index.look_through(0, min(len(index.stamps), _LOOKED_AT), scan=scan)
    seen = (*index.remarks, scan.remark() if scan else None)
    return replace(footage, remarks=(*footage.remarks, *(one for one in seen if one)))


def _candidates(folder: Path) -> list[tuple[Path, tuple[Path, ...]]]:
    """Return every (first file, images) in the order of their paths."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    videos: list[tuple[Path, tuple[Path, ...]]] = [(p, ()) for p in files if p.suffix.lower() in VIDEO_SUFFIXES]
    for inner in sorted({path.parent for path in files if path.suffix.lower() in PICTURE_SUFFIXES}):
        videos += _picture_runs(inner)
    return sorted(videos)


def _picture_runs(folder: Path) -> list[tuple[Path, tuple[Path, ...]]]:
    """Return the numbered images of one folder, one run per common name, by number."""
    runs: dict[tuple[str, str], list[tuple[int, Path]]] = {}
    for path in sorted(folder.iterdir()):
        numbered = _NUMBERED.fullmatch(path.stem)
        if numbered and path.suffix.lower() in PICTURE_SUFFIXES and path.is_file() and len(numbered[2]) < 18:
            runs.setdefault((numbered[1], path.suffix.lower()), []).append((int(numbered[2]), path))
    ordered = [tuple(path for _, path in sorted(run)) for run in runs.values() if len(run) >= _LEAST_PICTURES]
    return sorted((run[0], run) for run in ordered)


def _stem_of_pictures(pictures: tuple[Path, ...]) -> str:
    """Return the images' common name, or their folder's where they are mere numbers (or one letter and a number)."""
    numbered = _NUMBERED.fullmatch(pictures[0].stem)
    name = numbered[1].rstrip("_-. ") if numbered else ""
    return name if len(name) > 1 else pictures[0].parent.name


def _check_numbers(pictures: tuple[Path, ...]) -> None:
    numbers = [int(match[2]) for path in pictures if (match := _NUMBERED.fullmatch(path.stem))]
    for before, after, path in zip(numbers, numbers[1:], pictures[1:], strict=False):
        if after != before + 1:
            raise InputError(f"{path}: follows number {before}, so one is missing or double; number them in a row.")


def _clip_beside(path: Path, stem: str) -> Clip:
    for name in (f"{stem}_clip.toml", "clip.toml"):
        if (path.parent / name).is_file():
            return read_clip(path.parent / name)
    return Clip()


def _timing(path: Path, told_fps: float | None) -> tuple[float, Bool[Array, "n"], tuple[str, ...]]:
    """Return frames per second, which frames are followed by a regular interval, and remarks, from the container.

    Args:
        path: the video file.
        told_fps: by the user; it has priority over the rate of the capture, which has priority over that of the time
            stamps.
    """
    fps, steady, capture = _time_stamps(path)
    if told_fps or not differs(capture, fps) or capture is None:
        return told_fps or fps, steady, ()
    return capture[0], steady, (capture_remark(path.name, capture, fps),)


def _time_stamps(path: Path) -> tuple[float, Bool[Array, "n"], Rate | None]:
    """Return rate and regularity of the time stamps, and the capture rate where the file states it."""
    try:
        with open_video(path) as container:
            stream = video_stream(container)
            stated = float(stream.average_rate or 0)
            base = float(stream.time_base or 0)
            capture = stated_capture_rate(path, {**container.metadata, **stream.metadata})
            # numbers only: the packets together are the whole video
            ticks = [p.pts for p in container.demux(stream) if p.size and not p.is_discard]
    except av.FFmpegError as error:
        raise InputError(f"{path}: can't be read as a video ({error.strerror}); convert it to H.264.") from None
    count, stamps = len(ticks), [tick * base for tick in ticks if tick is not None]
    if count < 2:
        raise InputError(f"{path}: has {count} frames, too few to average; give a longer video.")
    if len(stamps) < count or not max(stamps) > min(stamps):
        if not stated > 0:
            raise InputError(f"{path}: has no time stamps and no frame rate; convert it to H.264 in an .mp4 file.")
        return stated, np.ones(count - 1, bool), capture
    intervals = np.diff(np.sort(np.array(stamps)))
    usual = float(np.median(intervals))
    steady = np.abs(intervals - usual) <= _JITTER * usual
    if not usual > 0:
        raise InputError(f"{path}: most of its frames have the same time stamp; convert it to H.264 in an .mp4 file.")
    fps = 1 / float(intervals[steady].mean())
    return (stated if abs(stated - fps) < 0.01 * fps else fps), steady, capture
