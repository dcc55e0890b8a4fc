"""Whose result a file is, told by what is in it, and the person it is to be about."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.initialize.readers import amass, gvhmr, hybrik, joints, own, phalp, pymaf, sam3d, tram, wham
from hfb.initialize.readers.contents import named, read_contents
from hfb.initialize.readers.pose_track import PoseTrack, tidy

Reader = Callable[[Any, tuple[int, int], dict[str, Any]], list[PoseTrack] | None]
_READERS: tuple[Reader, ...] = (
    own.read, wham.read, pymaf.read, hybrik.read, phalp.read, tram.read, gvhmr.read, sam3d.read, amass.read,
    joints.read,
)  # fmt: skip
SYSTEMS = ("PyMAF", "HybrIK", "PHALP / 4D-Humans", "WHAM", "TRAM", "GVHMR", "SAM 3D Body", "AMASS", "3D joints", "hfb")


def read_tracks(files: Sequence[Path], height: int, width: int) -> tuple[PoseTrack, ...]:
    """Everybody in a result.

    Args:
        files: the result, then what lies beside it (`hfb.initialize.readers.beside.companions`).
        height, width: of the pictures [px], for systems that do not say.

    Raises:
        InputError: damaged, a pickle that names code, unknown, or about other pictures.
    """
    path, *others = files
    content = read_contents(path)
    beside = {other.name: read_contents(other) for other in others}
    try:
        for read in _READERS:
            tracks = read(content, (height, width), beside)
            if tracks is not None:
                return tuple(tidy(track).at_size(height, width) for track in tracks if len(track))
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from error
    except Exception as error:  # what a damaged or hostile file combines is not foreseeable
        reason = repr(error)[:120]
        raise InputError(f"{path} cannot be used: it is damaged, or of an unknown version ({reason})") from error
    held = ", ".join(list(named(content))[:12])[:120] or type(content).__name__
    raise InputError(f"{path} is no result that hfb knows (it holds {held}); known are {', '.join(SYSTEMS)}")


def choose_person(tracks: Sequence[PoseTrack], person: str | None) -> PoseTrack:
    """The named one, else the one seen in most frames.

    Raises:
        InputError: nobody, or nobody of that name.
    """
    if not tracks:
        raise InputError("the result holds nobody")
    if person is None:
        return max(tracks, key=len)
    chosen = next((track for track in tracks if track.person == person), None)
    if chosen is None:
        known = ", ".join(track.person for track in tracks[:20])
        raise InputError(f"the {tracks[0].system} result has no person {person}; it has {known}")
    return chosen
