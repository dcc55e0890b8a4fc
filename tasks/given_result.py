"""First bodies out of another system's result."""

from __future__ import annotations

from pathlib import Path

from hfb.errors import InputError
from tasks.handles import ClipHandle, FileHandle, FirstBodyHandle
from tasks.task import task
from tasks.video_handles import BodyFound, FootageHandle
from tasks.workers import compute


class ResultHandle(FileHandle):
    """One person of another system's result, in hfb's conventions (`hfb.initialize.readers.pose_track`).

    Attributes:
        system: whose result it is. frames: numbers of the frames in which it saw the person.
    """

    system: str
    frames: tuple[int, ...]

    def number_in_clip(self, number: int, first: int | None, began: int, average: int) -> int:
        """Which frame of the result a clip's frame is; a motion of our own counts the clip's, all others the video's.

        Args:
            first: of the result, where it is told. began, average: of the clip, see `hfb.media.footage.Footage`.
        """
        from hfb.initialize.readers import own

        if self.system == own.SYSTEM:
            return (first or 0) + number
        # The middle one of the frames that are averaged: there the body is nearest to the middle of the motion.
        return (began if first is None else first) + number * average + average // 2

    def numbers_of(self, count: int, first: int | None) -> tuple[int, ...]:
        """Which frames of the result the given pictures are.

        Raises:
            InputError: it cannot be told.
        """
        if first is not None:
            return tuple(range(first, first + count))
        if len(self.frames) == count:
            return self.frames
        raise InputError(
            f"the {self.system} result has {len(self.frames)} frames and {count} are fitted: say with --init.frame "
            "which of its frames the first picture is, counted from 0"
        )


@task("other system's result")
def read_result(
    files: tuple[FileHandle, ...], height: int, width: int, person: str | None, body: FileHandle | None, folder: Path
) -> ResultHandle:
    """Everything about one person, as a file that has only numbers in it.

    Args:
        files: the result, then what lies beside it.
        person: the system's name; the one who is seen longest where it is None.

    Raises:
        InputError: it cannot be read, is about other pictures, or has no such person.
    """
    return compute(_read_result, files, height, width, person, body, folder)


@task("first body of the result")
def body_of_result(
    clip: ClipHandle,
    index: int,
    number: int,
    mattes: tuple[FileHandle, ...],
    result: ResultHandle,
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    """The body of one frame, laid onto its matte; none where the system saw nobody.

    Args:
        index: of the frame in the clip. number: of the frame in the result.
    """
    return compute(_body_of_result, clip, index, number, mattes, result, body, folder)


@task("first bodies of the result")
def find_given_body(
    footage: FootageHandle,
    still: ClipHandle,
    number: int,
    matte: FileHandle,
    result: ResultHandle,
    first: int | None,
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    """As `body_of_result`, of one frame of a clip.

    Args:
        number: of the frame in the clip. first: number in the result of the clip's first frame; the result's are the
            video's own where it is None.
    """
    return compute(_find_given_body, footage, still, number, matte, result, first, body, folder)


def needed(found: BodyFound) -> FirstBodyHandle:
    """The body that a fit without neighbours cannot do without.

    Raises:
        InputError: there is none.
    """
    if found.first is None:
        raise InputError(f"{found.reason}; give another result, or leave --init out")
    return found.first


def _read_result(
    files: tuple[FileHandle, ...], height: int, width: int, person: str | None, body: FileHandle | None, folder: Path
) -> ResultHandle:
    from hfb.initialize.readers.pose_track import save_track
    from hfb.initialize.readers.sniff import choose_person, read_tracks
    from hfb.initialize.track_bodies import with_poses
    from tasks.scene import load_chosen_body

    chosen = choose_person(read_tracks([file.path for file in files], height, width), person)
    track = with_poses(chosen, load_chosen_body(body))
    path = folder / "init_result.npz"
    save_track(path, track)
    return ResultHandle.of(path, system=track.system, frames=tuple(int(frame) for frame in track.frames))


def _body_of_result(
    clip: ClipHandle,
    index: int,
    number: int,
    mattes: tuple[FileHandle, ...],
    result: ResultHandle,
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    from hfb.initialize.first_body import save_first_body
    from hfb.initialize.readers.pose_track import load_track
    from hfb.initialize.track_bodies import body_at, on_matte
    from hfb.render.rasterizer import make_rasterizer
    from tasks.scene import load_chosen_body, load_observation

    track, model = load_track(result.path), load_chosen_body(body)
    seen = load_observation(clip, mattes)
    first = body_at(track, number, seen.camera, model)
    if first is None:
        return BodyFound(first=None, reason=f"the {result.system} result has nobody in frame {number}")
    try:
        matte = seen.mattes[index].numpy()
        first = on_matte(first, track.turn_is_known, matte, seen.camera, model, make_rasterizer("coverage"))
    except InputError as error:
        return BodyFound(first=None, reason=str(error))
    path = folder / f"given_body_{number:06d}_{index}.npz"
    save_first_body(path, first)
    return BodyFound(first=FirstBodyHandle.of(path, source=first.source))


def _find_given_body(
    footage: FootageHandle,
    still: ClipHandle,
    number: int,
    matte: FileHandle,
    result: ResultHandle,
    first: int | None,
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    from tasks.video_clip import load_footage

    known = load_footage(footage)
    at = result.number_in_clip(number, first, known.first, known.average)
    return _body_of_result(still, 0, at, (matte,), result, body, folder)
