"""Where clips lie: a video, a folder of pictures, a clip.toml, or a folder that holds one of these. Light to import."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hfb.clip import BACKGROUND_WORDS, Clip, read_clip
from hfb.errors import InputError
from hfb.export.names import RESULT
from hfb.media.footage_names import PICTURE_SUFFIXES, is_hidden, is_plate, natural_order, others_in, pictures_in
from tasks.handles import FileHandle, StaleFile

CLIP_FILE = "clip.toml"
VIDEOS = {
    ".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mts", ".m2ts", ".mpg", ".mpeg", ".ts", ".wmv", ".mxf", ".gif",
}  # fmt: skip
_FRAMES_FOLDER = "frames"
_PLATE_NAMES = ("background", "plate")


@dataclass(frozen=True)
class ClipPlace:
    """One clip of a folder of clips.

    Attributes:
        source: what `hfb video` would be given. clip: its clip.toml, where it has one.
        files: everything that its result depends on, as far as the folder tells.
        stray: one of these that is a link to a place outside of the folder.
        twin: the clip to which the result folder of this name belongs; this one's ``name`` is then no folder's.
    """

    name: str
    source: Path
    clip: Path | None
    files: tuple[Path, ...]
    stray: Path | None = None
    twin: Path | None = None

    def check(self) -> None:
        """Raises InputError where another clip has the same name, or a file lies elsewhere.

        Who may put clips into a folder may not see other files.
        """
        if self.twin is not None:
            raise InputError(
                f"{self.source} and {self.twin} are clips of one name, so both results would go into one folder: "
                "rename one of them"
            )
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
    named: dict[str, list[ClipPlace]] = {}
    for path in natural_order(folder.iterdir()):
        place = None if path.resolve() == results or is_hidden(path) else _clip_at(path)
        if place is not None:
            named.setdefault(place.name, []).append(place)
    return tuple(place for name, same in named.items() for place in _told_apart(same, results / name))


def _clip_at(path: Path) -> ClipPlace | None:
    """The clip that a file or a folder in a folder of clips is."""
    if path.is_file() and path.suffix.lower() in VIDEOS:
        sidecar = path.with_suffix(".toml")
        name, clip = path.stem, sidecar if sidecar.exists() else None
        own = [path, sidecar] if clip else [path]
    elif path.is_dir() and (path / CLIP_FILE).exists():
        name, clip = path.name, path / CLIP_FILE
        own = sorted(one for one in path.rglob("*") if one.is_file())
    else:
        return None
    files = tuple(dict.fromkeys((*own, *_named_or_beside(path, clip))))
    ground = path.parent.resolve()
    stray = next((one for one in (path, *files) if not one.resolve().is_relative_to(ground)), None)
    return ClipPlace(name, path, clip, files, stray)


def _named_or_beside(source: Path, clip: Path | None) -> Iterator[Path]:
    """What decides a clip's result besides the clip: the files that its clip.toml names, and its plate."""
    try:
        known = read_clip(clip) if clip else Clip()
        plate = plate_beside(resolve_source(source, clip)[0]) if known.background is None else None
    except (InputError, OSError):  # it is told when the clip's turn comes
        return
    if known.background is not None and known.background not in BACKGROUND_WORDS:
        plate = Path(known.background)
    yield from (one for one in (known.camera.calibration, known.person.track, plate) if one is not None)


def _told_apart(same: Sequence[ClipPlace], result: Path) -> Iterator[ClipPlace]:
    """Clips of one name: one keeps it, and with it the folder of its result; the others get names that no folder has.

    A result that is there already stays its clip's, whatever comes to lie beside that; else the first one's it is.
    """
    if len(same) == 1:  # nothing to tell, nothing to read
        yield same[0]
        return
    keeps = next((one for one in same if _made_of(result, one.source)), same[0])
    for one in same:
        yield one if one is keeps else replace(one, name=f"./{one.source.name}", twin=keeps.source)


def _made_of(result: Path, source: Path) -> bool:
    """Whether a folder holds a video's result. Of a folder of pictures it is not told: that would take hashing all."""
    try:
        sha256 = json.loads((result / RESULT).read_bytes())["inputs"]["video"]
        FileHandle(path=source, sha256=sha256).check()
    except (OSError, ValueError, TypeError, KeyError, RecursionError, StaleFile):
        return False
    return True


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
    """The background that lies with a clip as a picture, in small or capital letters.

    NAME_plate, background or plate beside the video NAME; background or plate in the folder of pictures, another that
    is a plate by its name there, or background or plate one folder up.
    """
    first = files[0]
    if first.suffix.lower() not in PICTURE_SUFFIXES:
        return _picture_called((f"{first.stem}_plate", *_PLATE_NAMES), first.parent)
    return (
        _picture_called(_PLATE_NAMES, first.parent)
        or next((path for path in pictures_in(first.parent) if is_plate(path)), None)
        or _picture_called(_PLATE_NAMES, first.parent.parent)
    )


def _picture_called(names: Sequence[str], folder: Path) -> Path | None:
    """The first of these names that a picture has; the very spelling goes before other letter cases."""
    pictures = pictures_in(folder)
    for name in names:
        found = [path for path in pictures if path.stem.lower() == name.lower()]
        if found:
            return min(found, key=lambda path: (path.stem != name, path.name))
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
    videos = sorted(path for path in folder.iterdir() if path.suffix.lower() in VIDEOS and not is_hidden(path))
    if len(videos) == 1:
        return (videos[0],)
    if videos:
        raise InputError(f"{folder} holds {len(videos)} videos: name one, or write `video = ...` into its {CLIP_FILE}")
    place = folder / _FRAMES_FOLDER if (folder / _FRAMES_FOLDER).is_dir() else folder
    frames = tuple(path for path in pictures_in(place) if not is_plate(path))
    if not frames:
        for other in others_in(place):
            from hfb.media.picture_access import no_picture

            raise no_picture(other)
        raise InputError(f"{folder} holds neither a video nor pictures: give a video, or a folder of frames")
    return frames
