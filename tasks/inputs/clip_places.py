"""Locate clips: a video, a folder of images, a clip.toml, or a folder that holds one of these. Light to import."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hfb.errors import InputError, TemporaryError
from hfb.io.clip import BACKGROUND_WORDS, Clip, read_clip
from hfb.io.media.footage_names import PICTURE_SUFFIXES, is_hidden, is_plate, natural_order, others_in, pictures_in
from hfb.io.names import is_text, shown_name
from hfb.io.safe_folder import NotOrdinary, check_readable, entries_below, is_regular
from hfb.tasks.core.handles import FileHandle, StaleFile
from hfb.tasks.core.result_folder import read_result_content
from hfb.tasks.inputs.out_place import CLIP_FILE, FRAMES_FOLDER, VIDEOS

RESERVED = re.compile(r"batch\.json.*|summary(-\d+)?\.html.*|intermediate")
"""Names in a folder of results besides the clips' own folders; some disks do not distinguish letter cases."""

_PLATE_NAMES = ("background", "plate")
_LEADS_OUT = "is a link that leads out of the folder of clips: put the file itself there"
_LINKED = "is a link to a folder, whose files cannot be watched: put the folder itself there"


@dataclass(frozen=True)
class ClipPlace:
    """One clip of a folder of clips.

    Attributes:
        source: argument of `hfb video`.
        clip: its clip.toml, if any.
        files: everything that its result depends on, as far as the folder shows.
        stray: an entry because of which the clip is refused.
        why: why that entry is refused.
        twin: the clip that owns the result folder of this name; this one's ``name`` is then no folder's.
        trouble: why the clip cannot be read.
    """

    name: str
    source: Path
    clip: Path | None
    files: tuple[Path, ...]
    stray: Path | None = None
    why: str = ""
    twin: Path | None = None
    trouble: str = ""

    @property
    def shown(self) -> str:
        """The name for a line of text."""
        return shown_name(self.name)

    def check(self) -> None:
        """Check that the clip has a folder name of its own and reads no files outside the folder of clips.

        Whoever may put clips into a folder may not read other files. The files watched and the files read are the same.
        """
        if self.trouble:
            raise InputError(f"{self.source} cannot be read ({self.trouble}): mend its permissions or its name")
        if not is_text(self.name):
            raise InputError(f"{self.source} has a name that is not text in UTF-8: rename it")
        if RESERVED.fullmatch(self.name.casefold()):
            raise InputError(f"{self.shown} is what hfb calls a file of its own beside results: rename the clip")
        if self.twin is not None:
            raise InputError(
                f"{self.source} and {self.twin} are clips of one name, so both results would go into one folder: "
                "rename one of them"
            )
        if self.stray is not None:
            raise InputError(f"{self.stray} {self.why}")

    def check_read(self, read: Iterable[FileHandle]) -> None:
        """Raise TemporaryError if a file was read that is not watched, because the folder has changed meanwhile.

        Args:
            read: files of the clip's inputs.
        """
        watched = {path.resolve() for path in self.files}
        if other := next((file.path for file in read if file.path not in watched), None):
            raise TemporaryError(f"{other} came to {self.source} while it was being read: it is looked at again")


def find_clips(folder: Path, out: Path) -> tuple[ClipPlace, ...]:
    """Return the clips of a folder, by name: ``NAME.mp4`` with ``NAME.toml``, and folders ``NAME/`` with a clip.toml.

    Args:
        folder: of the clips.
        out: where results go; nothing in it is a clip.

    Raises:
        InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder: give one that holds clips")
    results, identity = out.resolve(), _identity(out) or ()
    named: dict[str, list[ClipPlace]] = {}
    for path in natural_order(folder.iterdir()):
        try:
            skipped = is_hidden(path) or path.resolve() == results or _identity(path) == identity
            place = None if skipped else _clip_at(path)
        except (OSError, RuntimeError) as error:  # not to be opened, too long a name, links in a circle
            place = ClipPlace(path.stem, path, None, (path,), trouble=getattr(error, "strerror", None) or str(error))
        if place is not None:
            named.setdefault(place.name, []).append(place)
    return tuple(place for name, same in named.items() for place in _told_apart(same, results / name))


def _clip_at(path: Path) -> ClipPlace | None:
    """Return the clip at a file or folder in a folder of clips; None where there is none."""
    if path.suffix.lower() in VIDEOS and path.exists() and not path.is_dir():
        sidecar = path.with_suffix(".toml")
        name, clip = path.stem, sidecar if _exists(sidecar) else None
        own = [path, sidecar] if clip else [path]
    elif path.is_dir() and (path / CLIP_FILE).exists():
        name, clip = path.name, path / CLIP_FILE
        if path.is_symlink():
            return ClipPlace(name, path, clip, (clip,), path, _LINKED)
        try:
            own = sorted(entries_below(path))
        except NotOrdinary as error:
            return ClipPlace(name, path, clip, (clip,), path, f"is not read, since {error}")
    else:
        return None
    files = tuple(one for one in own if not one.is_dir())
    stray = _first_stray(path.parent, own)  # before anything is opened or listed that it leads to
    if stray is None:
        files = tuple(dict.fromkeys((*(one for one in files if one.is_file()), *_named_or_beside(path, clip))))
        stray = _first_stray(path.parent, files)
    return ClipPlace(name, path, clip, files, *(stray or ()))


def _first_stray(ground: Path, files: Sequence[Path]) -> tuple[Path, str] | None:
    """Return the first refused entry of a clip, and why: the files read must be the files watched."""
    inside, own = ground.resolve(), {ground}  # folders that are no links
    for path in files:
        if path.parent not in own:
            steps = path.relative_to(ground).parts
            folders = [ground.joinpath(*steps[:count]) for count in range(1, len(steps))]
            if linked := next((one for one in folders if one.is_symlink()), None):
                return linked, _LINKED
            own.update(folders)
        if is_regular(path):
            continue
        if path.is_symlink() and path.is_dir():
            return path, _LINKED
        try:
            if not path.resolve().is_relative_to(inside):
                return path, _LEADS_OUT
            check_readable(path)
        except FileNotFoundError:
            continue
        except (OSError, RuntimeError) as error:  # links in a circle
            return path, f"cannot be read ({getattr(error, 'strerror', None) or error}): put the file itself there"
    return None


def _identity(path: Path) -> tuple[int, int] | None:
    """Return device and inode, which are the same under every name of a folder."""
    try:
        facts = path.stat()
    except OSError:
        return None
    return facts.st_dev, facts.st_ino


def _exists(path: Path) -> bool:
    """Return whether a file exists; a name that is too long, as NAME.toml may be where NAME.ts is not, does not."""
    try:
        return path.exists()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return False
        raise


def _named_or_beside(source: Path, clip: Path | None) -> Iterator[Path]:
    """Yield what decides a clip's result besides the clip: the files that its clip.toml names, and its plate."""
    try:
        known = read_clip(clip) if clip else Clip()
        plate = plate_beside(resolve_source(source, clip)[0]) if known.background is None else None
    except (InputError, OSError):  # it is told when the clip's turn comes
        return
    if known.background is not None and known.background not in BACKGROUND_WORDS:
        plate = Path(known.background)
    yield from (one for one in (known.camera.calibration, known.person.track, plate) if one is not None)


def _told_apart(same: Sequence[ClipPlace], result: Path) -> Iterator[ClipPlace]:
    """Resolve clips of one name: one keeps the name and thus the result's folder; the others get impossible names.

    An existing result stays its clip's, whatever is added beside that clip; otherwise the first clip gets the name.
    """
    if len(same) == 1:  # nothing to tell, nothing to read
        yield same[0]
        return
    keeps = next((one for one in same if _made_of(result, one.source)), same[0])
    for one in same:
        yield one if one is keeps else replace(one, name=f"./{one.source.name}", twin=keeps.source)


def _made_of(result: Path, source: Path) -> bool:
    """Return whether a folder holds a video's result; unknown for a folder of images, which would have to be hashed."""
    try:
        sha256 = read_result_content(result.parent, result.name)["inputs"]["video"]
        FileHandle(path=source, sha256=sha256).check()
    except (OSError, ValueError, TypeError, KeyError, RecursionError, StaleFile):
        return False
    return True


def resolve_source(source: Path, clip: Path | None) -> tuple[tuple[Path, ...], Path | None]:
    """Return the files of a clip's images, in order, and its clip.toml.

    Args:
        source: a video, a folder of images, a clip.toml that names its video, or a folder that holds a clip.toml.
        clip: a clip.toml that the user names; it overrides one that is found.

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
    """Return the background image that belongs to a clip by its name, in any letter case.

    NAME_plate, background or plate beside the video NAME; background or plate in the folder of images, another image
    named like a plate there, or background or plate one folder up.

    Args:
        files: the video, or the images.
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
    """Return the first of these names that an image has; the exact spelling precedes other letter cases."""
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
    """Return the one video of a folder, or its images in natural order (those of ``frames/`` where there is one)."""
    videos = sorted(path for path in folder.iterdir() if path.suffix.lower() in VIDEOS and not is_hidden(path))
    if len(videos) == 1:
        return (videos[0],)
    if videos:
        raise InputError(f"{folder} holds {len(videos)} videos: name one, or write `video = ...` into its {CLIP_FILE}")
    place = folder / FRAMES_FOLDER if (folder / FRAMES_FOLDER).is_dir() else folder
    frames = tuple(path for path in pictures_in(place) if not is_plate(path))
    if not frames:
        for other in others_in(place):
            from hfb.io.media.images.image_access import no_picture

            raise no_picture(other)
        raise InputError(f"{folder} holds neither a video nor pictures: give a video, or a folder of frames")
    return frames
