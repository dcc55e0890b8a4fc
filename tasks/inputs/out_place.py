"""Check where results go: not where they would be read as frames, clips or motions. Light to import."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from hfb.errors import InputError
from hfb.io.media.footage_names import PICTURE_SUFFIXES, is_plate, pictures_in

CLIP_FILE = "clip.toml"
FRAMES_FOLDER = "frames"
VIDEOS = {
    ".mp4",
    ".mov",
    ".mkv",
    ".avi",
    ".webm",
    ".m4v",
    ".mts",
    ".m2ts",
    ".mpg",
    ".mpeg",
    ".ts",
    ".wmv",
    ".mxf",
    ".gif",
}
_WRITTEN = re.compile(r"intermediate|cases|methods|case_\d+")
_OF_A_RESULT = re.compile(r"strip|texture|matte_\d+|comparison")


def same_place(one: Path, other: Path) -> bool:
    """Return whether two names mean the same folder, however they are spelled, linked or mounted.

    Args:
        one: a path; it need not exist.
        other: a path; it need not exist.
    """
    try:
        return one.resolve() == other.resolve() or (one.exists() and other.exists() and one.samefile(other))
    except (OSError, RuntimeError):  # links in a circle
        return False


def lies_in(path: Path, folder: Path) -> bool:
    """Return whether a path is a folder or lies below it; it need not exist.

    Args:
        path: the path.
        folder: the folder.
    """
    try:
        whole = path.resolve()
    except (OSError, RuntimeError):
        return False
    return any(same_place(one, folder) for one in (whole, *whole.parents))


def check_no_clip(out: Path) -> None:
    """Raise InputError if ``out`` is the folder of a clip or of its frames: results would be read as frames.

    Args:
        out: where results go.
    """
    home = out.resolve().parent if out.resolve().name == FRAMES_FOLDER else out
    if (home / CLIP_FILE).exists() or (out / CLIP_FILE).exists():
        raise _refusal(out, f"the folder of a clip ({CLIP_FILE} lies there)", out)


def check_clip_out(source: Path, files: Sequence[Path], out: Path) -> None:
    """Check where the results of a clip go.

    Args:
        source: as the user named it: a video, a folder of images or with a clip.toml, or a clip.toml.
        files: the video, or the images.
        out: where results go.

    Raises:
        InputError: the next run would read results as frames, or as the video.
    """
    check_no_clip(out)
    home = files[0].parent
    named = source if source.is_dir() else source.parent if source.suffix.lower() == ".toml" else None
    places = [] if named is None else [named]
    if files[0].suffix.lower() in PICTURE_SUFFIXES:
        places += [home, home / FRAMES_FOLDER, *([home.parent] if home.resolve().name == FRAMES_FOLDER else [])]
    if any(same_place(out, place) for place in places):
        raise _refusal(out, "where the frames of this clip are looked for", source)
    is_named_like_one = out.suffix.lower() in PICTURE_SUFFIXES | VIDEOS
    if is_named_like_one and any(same_place(out.parent, place) for place in (*places, home)):
        raise _refusal(out, "named like a frame or a video, among those of this clip", source)


def check_pictures_out(frames: Sequence[Path], out: Path) -> None:
    """Raise InputError if results of single images would lie among the frames of a clip.

    Args:
        frames: blurred images.
        out: where results go.
    """
    check_no_clip(out)
    if not any(same_place(out, frame.parent) for frame in frames):
        return
    others = [path for path in pictures_in(out) if not is_plate(path) and not _OF_A_RESULT.fullmatch(path.stem)]
    if len(others) > 1 or out.resolve().name == FRAMES_FOLDER:
        raise _refusal(out, "a folder of frames", frames[0])


def check_batch_out(folder: Path, out: Path) -> None:
    """Raise InputError if results of a folder of clips would change these clips, or be read as clips.

    Args:
        folder: of the clips.
        out: where results go.
    """
    check_not_clips(folder, out)
    for clip in folder.iterdir() if folder.is_dir() else ():
        if clip.is_dir() and (clip / CLIP_FILE).exists() and lies_in(out, clip):
            raise _refusal(out, f"in the folder of the clip {clip.name}", folder)


def check_not_clips(folder: Path, out: Path) -> None:
    """Raise InputError if results would lie in the folder of clips itself.

    Args:
        folder: of the clips.
        out: where results go.
    """
    if same_place(folder, out):
        raise _refusal(out, "the folder of clips itself", folder)


def check_sources_out(sources: Iterable[Path | None], out: Path) -> None:
    """Raise InputError if results would lie in a folder that is searched for motions, images or videos.

    Args:
        sources: such folders; None is ignored.
        out: where results go.
    """
    for source in sources:
        if source is None or not source.is_dir():
            continue
        if lies_in(out, source):
            raise _refusal(out, f"in {source}, which is searched for inputs", source)
        here, whole = out.resolve(), source.resolve()
        if whole.is_relative_to(here) and whole != here and _WRITTEN.fullmatch(whole.relative_to(here).parts[0]):
            raise InputError(f"{source} is where results in {out} go: give another --out, such as --out {out}-again")


def default_out(source: Path) -> Path:
    """Return a folder in ``runs`` named after the source, and different from it.

    Args:
        source: a file or a folder.
    """
    out = Path("runs") / source.resolve().stem
    place = source if source.is_dir() else source.parent
    return out.with_name(f"{out.name}-result") if same_place(place, out) else out


def _refusal(out: Path, what: str, source: Path) -> InputError:
    return InputError(
        f"--out {out} is {what}, so results would be taken for inputs: give a folder of its own, such as "
        f"--out {Path('runs') / source.resolve().stem}-result"
    )
