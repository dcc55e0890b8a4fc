"""Recognition of a result file's system by its content, and choice of a person."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.interop.readers.image_names import ClipPictures, by_pictures
from hfb.interop.readers.joining import JOINT, joined
from hfb.interop.readers.pose_track import PoseTrack, tidy
from hfb.interop.readers.systems import (
    amass,
    gvhmr,
    hybrik,
    joint_files,
    keypoints,
    nlf,
    own,
    phalp,
    pymaf,
    sam3d,
    tram,
    wham,
)
from hfb.io.safe.contents import named, read_contents

_ANY_CLIP = ClipPictures()
Reader = Callable[[Any, tuple[int, int], dict[str, Any]], list[PoseTrack] | None]
_SYSTEMS = (own, wham, pymaf, hybrik, phalp, tram, gvhmr, sam3d, nlf, amass, joint_files, keypoints)
_READERS: tuple[Reader, ...] = tuple(system.read for system in _SYSTEMS)
SYSTEMS = (
    "PyMAF",
    "HybrIK",
    "PHALP / 4D-Humans",
    "WHAM",
    "TRAM",
    "GVHMR",
    "SAM 3D Body",
    "NLF",
    "AMASS",
    "3D joints",
    "2D keypoints",
    "hfb",
)


def read_tracks(
    files: Sequence[Path], height: int, width: int, clip: ClipPictures = _ANY_CLIP
) -> tuple[PoseTrack, ...]:
    """Read all people of a result.

    Args:
        files: the result, then what lies beside it (`hfb.interop.readers.beside.companions`).
        height: height of the images [px], for systems that do not state it.
        width: width of the images [px], for systems that do not state it.
        clip: the names of the images, for systems that go by names.

    Raises:
        InputError: damaged, a pickle that names code, unknown, or about other images.
    """
    path, *others = files
    content = read_contents(path)
    beside = {other.name: read_contents(other) for other in others}
    try:
        for read in _READERS:
            tracks = read(content, (height, width), beside)
            if tracks is not None:
                return tuple(track.at_size(height, width) for track in joined(_usable(by_pictures(tracks, clip))))
        if _holds_nothing(content):
            raise InputError("it holds nobody")
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from error
    except Exception as error:  # what a damaged or hostile file combines is not foreseeable
        reason = repr(error)[:120]
        raise InputError(f"{path} cannot be used: it is damaged, or of an unknown version ({reason})") from error
    held = ", ".join(list(named(content))[:12])[:120] or type(content).__name__
    raise InputError(
        f"{path} is no result that hfb knows (it holds {held}); known are {', '.join(SYSTEMS)}; of any other system "
        "give an .npz with its 3D joints in metres as `joints` (frames, 24, 3)"
    )


def _usable(tracks: Sequence[PoseTrack]) -> list[PoseTrack]:
    """Return all people with rows from which a body can be made."""
    if not any(len(track) for track in tracks):
        raise InputError("it holds nobody")
    usable = [track for track in map(tidy, tracks) if len(track)]
    if not usable:
        raise InputError("nobody is left: its numbers are not finite, its joints too few, or behind the camera")
    return usable


def _holds_nothing(content: Any) -> bool:
    """Return whether a value is an empty list or dictionary, as systems write without a detection."""
    parts = content.values() if isinstance(content, dict) else content if isinstance(content, list) else (content,)
    return all(isinstance(part, dict | list) and not part for part in parts)


def choose_person(
    tracks: Sequence[PoseTrack], person: str | None, shown: Callable[[PoseTrack], float] | None = None
) -> PoseTrack:
    """Return the named person, else the one with the largest `shown`, else the one seen in most frames.

    Args:
        tracks: tracks of one result.
        person: name, or None.
        shown: measure of how much of a person the images show.

    Raises:
        InputError: there is no person, or none of that name.
    """
    if not tracks:
        raise InputError("the result holds nobody")
    if person is None:
        return max(tracks, key=lambda track: (0.0 if shown is None else shown(track), len(track)))
    chosen = next((track for track in tracks if person in (track.person, *track.person.split(JOINT))), None)
    if chosen is None:
        known = ", ".join(track.person for track in tracks[:20])
        raise InputError(f"the {tracks[0].system} result has no person {person}; it has {known}")
    return chosen
