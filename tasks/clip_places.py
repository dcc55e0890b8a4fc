"""Where clips lie: a video, a folder of pictures, a clip.toml, or a folder that holds one of these. Light to import."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hfb.clip import read_clip
from hfb.errors import InputError

CLIP_FILE = "clip.toml"
VIDEOS = {
    ".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mts", ".m2ts", ".mpg", ".mpeg", ".ts", ".wmv", ".mxf", ".gif",
}  # fmt: skip
PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"}
_FRAMES_FOLDER = "frames"
_PLATE_NAMES = {"background", "plate"}


@dataclass(frozen=True)
class ClipPlace:
    """One clip of a folder of clips.

    Attributes:
        source: what `hfb video` would be given. clip: its clip.toml, where it has one.
        files: everything that belongs to it, as far as the folder tells.
        stray: one of these that is a link to a place outside of the folder.
    """

    name: str
    source: Path
    clip: Path | None
    files: tuple[Path, ...]
    stray: Path | None = None

    def check(self) -> None:
        """Raises InputError where a file lies elsewhere: who may put clips into a folder may not see other files."""
        if self.stray is not None:
            raise InputError(f"{self.stray} is a link that leads out of the folder of clips: put the file itself there")


def find_clips(folder: Path, out: Path) -> tuple[ClipPlace, ...]:
    """The clips of a folder, by name: ``NAME.mp4`` with ``NAME.toml``, and folders ``NAME/`` with a clip.toml.

    Args:
        out: where results go; nothing in it is a clip.

    Raises:
        InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder: give one that holds clips")
    results = out.resolve()
    places = {}
    ground = folder.resolve()

    def place(name: str, source: Path, clip: Path | None, files: tuple[Path, ...]) -> ClipPlace:
        beside = plate_beside((source,)) if source.is_file() else None
        named = (source, *files, beside) if beside else (source, *files)
        stray = next((one for one in named if not one.resolve().is_relative_to(ground)), None)
        return ClipPlace(name, source, clip, files, stray)

    for path in sorted(folder.iterdir(), key=_natural):
        if path.resolve() == results or path.name.startswith("."):
            continue
        if path.is_file() and path.suffix.lower() in VIDEOS:
            sidecar = path.with_suffix(".toml")
            files: tuple[Path, ...] = (path, sidecar) if sidecar.exists() else (path,)
            places[path.stem] = place(path.stem, path, sidecar if sidecar.exists() else None, files)
        elif path.is_dir() and (path / CLIP_FILE).exists():
            files = tuple(sorted(one for one in path.rglob("*") if one.is_file()))
            places[path.name] = place(path.name, path, path / CLIP_FILE, files)
    return tuple(places.values())


def resolve_source(source: Path, clip: Path | None) -> tuple[tuple[Path, ...], Path | None]:
    """The files of a clip's pictures, in order, and its clip.toml.

    Args:
        source: a video, a folder of pictures, a clip.toml that names its video, or a folder that holds a clip.toml.
        clip: a clip.toml that the user names; it wins over one that is found.

    Raises:
        InputError: nothing is there, or it is not clear which of several is meant.
    """
    if source.is_dir():
        clip = clip or (source / CLIP_FILE if (source / CLIP_FILE).exists() else None)
        return (_named_video(clip) if clip else None) or _inside(source), clip
    if not source.exists():
        raise InputError(f"{source} does not exist")
    if source.suffix.lower() == ".toml":
        named = _named_video(source) or _inside(source.parent)
        return named, clip or source
    return (source,), clip


def plate_beside(files: Sequence[Path]) -> Path | None:
    """The background that lies with a clip: NAME_plate, background or plate, as a picture."""
    first = files[0]
    pictures = first.suffix.lower() in PICTURES
    for folder in (first.parent, first.parent.parent) if pictures else (first.parent,):
        for name in sorted(_PLATE_NAMES) if pictures else [f"{first.stem}_plate", *sorted(_PLATE_NAMES)]:
            found = [path for path in sorted(folder.glob(f"{name}.*")) if path.suffix.lower() in PICTURES]
            if found:
                return found[0]
    return None


def _named_video(clip: Path) -> tuple[Path, ...] | None:
    video = read_clip(clip).video
    if video is None:
        return None
    if not video.exists():
        raise InputError(f"{clip} names the video {video}, which does not exist")
    return _inside(video) if video.is_dir() else (video,)


def _inside(folder: Path) -> tuple[Path, ...]:
    """The one video of a folder, or its pictures in their natural order (those of ``frames/`` where there is one)."""
    videos = sorted(path for path in folder.iterdir() if path.suffix.lower() in VIDEOS)
    if len(videos) == 1:
        return (videos[0],)
    if videos:
        raise InputError(f"{folder} holds {len(videos)} videos: name one, or write `video = ...` into its {CLIP_FILE}")
    place = folder / _FRAMES_FOLDER if (folder / _FRAMES_FOLDER).is_dir() else folder
    pictures = [
        path for path in place.iterdir() if path.suffix.lower() in PICTURES and path.stem.lower() not in _PLATE_NAMES
    ]  # fmt: skip
    if not pictures:
        raise InputError(f"{folder} holds neither a video nor pictures: give a video, or a folder of frames")
    return tuple(sorted(pictures, key=_natural))


def _natural(path: Path) -> list[tuple[int, str]]:
    """frame_10 after frame_9."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts] + [(-1, path.name)]
