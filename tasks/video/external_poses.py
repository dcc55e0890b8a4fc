"""First bodies from another system's result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hfb.config import Record
from hfb.errors import InputError
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle
from hfb.tasks.core.video_handles import BodyFound, FootageHandle, SeenFrameCall
from hfb.tasks.task import task

_MOST_LOOKS = 8


class ResultHandle(FileHandle):
    """One person of another system's result, in hfb's conventions (`hfb.interop.readers.pose_track`).

    Attributes:
        system: that made the result.
        frames: numbers of the frames in which it has the person.
        person: the system's name of the person.
        others: the system's names of all others.
        rate_hz: of a motion with a clock of its own, see `PoseTrack`.
    """

    system: str
    frames: tuple[int, ...]
    person: str = "0"
    others: tuple[str, ...] = ()
    rate_hz: float | None = None

    def remark(self) -> str | None:
        """Return a sentence on which of several people it is; None where there is one."""
        if not self.others:
            return None
        count, shown = len(self.others), ", ".join(self.others[:8])
        return (
            f"the {self.system} result has {count + 1} people; taken is {self.person}, another one by --init.person "
            f"({shown}{' ...' if count > 8 else ''})"
        )

    def number_in_clip(
        self, number: int, first: int | None, *, began: int, average: int, video_hz: float | None = None
    ) -> int:
        """Return which frame of the result a clip's frame is.

        One of hfb's motions counts the clip's frames, one with a clock of its own the rows of its time, all others the
        video's frames.

        Args:
            number: of the frame in the clip.
            first: number of the result's first frame, where the user gave it.
            began: first frame of the clip in the video.
            average: number of video frames averaged into one frame of the clip.
            video_hz: frames per second of the video, before averaging.
        """
        from hfb.interop.readers.systems import own

        if self.system == own.SYSTEM:
            return (first or 0) + number
        # The middle one of the frames that are averaged: there the body is nearest to the middle of the motion.
        middle = number * average + average // 2
        if self.rate_hz is None or video_hz is None:
            return (began if first is None else first) + middle
        rows_per_frame = self.rate_hz / video_hz
        return round((began + middle) * rows_per_frame) if first is None else first + round(middle * rows_per_frame)

    def numbers_of(self, count: int, first: int | None) -> tuple[int, ...]:
        """Return which frames of the result the given images are.

        Args:
            count: number of images.
            first: number of the first image's frame; None where the user gave none.

        Raises:
            InputError: the frames cannot be determined.
        """
        if first is not None:
            return tuple(range(first, first + count))
        if len(self.frames) == count:
            return self.frames
        raise InputError(
            f"the {self.system} result has {len(self.frames)} frames and {count} are fitted: say with --init.frame "
            "which of its frames the first picture is, counted from 0"
        )


class Look(Record):
    """An image's matte and the number of its frame in a result; None where only the order identifies it."""

    matte: FileHandle
    frame: int | None


def looks_at(footage: FootageHandle, mattes: Mapping[int, FileHandle], first: int | None) -> tuple[Look, ...]:
    """Select some of a clip's frames, which decide which of a result's people is meant.

    Args:
        footage: the clip.
        mattes: by the clip's numbers.
        first: see `ResultHandle.number_in_clip`; of our own motions there is one person.
    """
    from hfb.tasks.video.video_clip import load_footage

    known = load_footage(footage)
    middle = (known.first if first is None else first) + known.average // 2
    chosen = sorted(mattes)[:: -(-len(mattes) // _MOST_LOOKS)]
    return tuple(Look(matte=mattes[number], frame=middle + number * known.average) for number in chosen)


def pictures_of(
    footage: FootageHandle, files: tuple[FileHandle, ...], first: int | None
) -> tuple[tuple[str, ...], int]:
    """Return (names of a clip's images, frames of a video), by which a result's images are found in the clip.

    Args:
        footage: the clip.
        files: of the clip.
        first: number of the first frame, where the user gave it; names do not count then.
    """
    from hfb.tasks.video.video_clip import load_footage

    if first is not None:
        return (), 0
    if len(files) > 1:
        return tuple(file.path.name for file in files), 0
    known = load_footage(footage)
    return (), known.first + known.count * known.average


class GivenBodyCall(SeenFrameCall):
    """A frame whose body another system found.

    Attributes:
        footage: the clip.
        result: of the other system.
        first: number in the result of the clip's first frame; None where the result counts the video's frames.
    """

    footage: FootageHandle
    result: ResultHandle
    first: int | None


@task("other system's result", where="worker")
def read_result(
    *,
    files: tuple[FileHandle, ...],
    height: int,
    width: int,
    person: str | None,
    looks: tuple[Look, ...],
    body: FileHandle | None,
    pictures: tuple[str, ...],
    frames: int,
    folder: Path,
) -> ResultHandle:
    """Write everything about one person into a file of numbers only.

    Args:
        files: the result, then the files that belong to it.
        height: of the images [px].
        width: of the images [px].
        person: the system's name; None for the one in ``looks``, or the one with most frames.
        looks: mattes that decide which person is meant.
        body: the user's body model; None for the embedded one.
        pictures: names of the clip's files, in order; none of a video, or where --init.frame says the numbers.
        frames: of a video, 0 where images are given.
        folder: where the file goes.

    Raises:
        InputError: it cannot be read, is about other images, or has no such person.
    """
    from hfb.interop.readers.image_names import ClipPictures
    from hfb.interop.readers.pose_track import PoseTrack, save_track
    from hfb.interop.readers.sniff import choose_person, read_tracks
    from hfb.interop.track_bodies import share_on_matte, with_poses
    from hfb.tasks.core.scene import load_chosen_body, load_mattes

    model = load_chosen_body(body)
    tracks = read_tracks([file.path for file in files], height, width, ClipPictures(pictures, frames))
    several = len(tracks) > 1
    mattes = [load_mattes((look.matte,))[0].numpy() for look in looks if several]

    def shown(track: PoseTrack) -> float:
        in_order = track.frames if len(track) == len(looks) else [-1] * len(looks)
        numbers = [look.frame if look.frame is not None else int(in_order[at]) for at, look in enumerate(looks)]
        shares = [share_on_matte(track, number, matte, model) for number, matte in zip(numbers, mattes, strict=True)]
        return round(sum(shares), 3)  # who is seen longer decides between equals

    chosen = choose_person(tracks, person, shown if several else None)
    track = with_poses(chosen, model)
    path = folder / "init_result.npz"
    save_track(path, track)
    others = tuple(one.person for one in tracks if one is not chosen)
    numbers = tuple(int(frame) for frame in track.frames)
    return ResultHandle.of(
        path, system=track.system, frames=numbers, person=track.person, others=others, rate_hz=track.rate_hz
    )


@task("first body of the result", where="worker")
def body_of_result(
    *,
    clip: ClipHandle,
    index: int,
    number: int,
    mattes: tuple[FileHandle, ...],
    result: ResultHandle,
    body: FileHandle | None,
    folder: Path,
) -> BodyFound:
    """Align the body of one frame with its matte; None where the system has none.

    Args:
        clip: all frames.
        index: of the frame in the clip.
        number: of the frame in the result.
        mattes: of all frames.
        result: of the other system.
        body: the user's body model; None for the embedded one.
        folder: where the body goes.
    """
    from hfb.interop.readers.pose_track import load_track
    from hfb.interop.track_bodies import body_at, on_matte
    from hfb.motion.static_pose import save_first_body
    from hfb.rendering.backends import make_rasterizer
    from hfb.tasks.core.scene import load_chosen_body, load_observation

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


@task("first bodies of the result", where="worker")
def find_given_body(call: GivenBodyCall) -> BodyFound:
    """Find the body of one frame of a clip, as `body_of_result` does.

    Args:
        call: the frame.
    """
    from hfb.tasks.video.video_clip import load_footage

    known = load_footage(call.footage)
    at = call.result.number_in_clip(
        call.number, call.first, began=known.first, average=known.average, video_hz=known.average / known.interval_s
    )
    return body_of_result.fn(
        clip=call.still,
        index=0,
        number=at,
        mattes=(call.matte,),
        result=call.result,
        body=call.body,
        folder=call.folder,
    )


def require(found: BodyFound) -> FirstBodyHandle:
    """Return the body; a fit without neighbours cannot do without.

    Args:
        found: of the frame.

    Raises:
        InputError: there is none.
    """
    if found.first is None:
        raise InputError(f"{found.reason}; give another result, or leave --init out")
    return found.first
