"""What travels between the tasks of a clip; see tasks/core/handles.py."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from hfb.config import Record
from hfb.io.clip import PersonChoice
from hfb.tasks.core.handles import Call, ClipHandle, FileHandle, FirstBodyHandle

_Row = tuple[float, float, float]


class FootageHandle(FileHandle):
    """What there is to know about a clip without its pictures: footage and timing, as a JSON file.

    Attributes:
        count: frames that can be decoded, after averaging.
        bits: how its frames are stored as pictures.
        remarks: what a person should know about it, one sentence each.
    """

    count: int
    height: int
    width: int
    K: tuple[_Row, _Row, _Row]
    exposure_s: float
    interval_s: float
    transfer: Literal["srgb", "linear"]
    light: Literal["srgb", "linear"]
    bits: Literal[8, 16]
    remarks: tuple[str, ...]

    def clip(self, frames: tuple[FileHandle, ...], background: FileHandle) -> ClipHandle:
        """Some frames as a clip of their own."""
        return ClipHandle(
            frames=frames,
            background=background,
            height=self.height,
            width=self.width,
            K=self.K,
            exposure_s=self.exposure_s,
            interval_s=self.interval_s,
            transfer=self.transfer,
            light=self.light,
        )

    def still(self, frame: FileHandle, background: FileHandle, camera: bool = False) -> ClipHandle:
        """One frame for steps that know no time, nor the camera unless they ask: they are not redone for another."""
        nowhere = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        alone = self.clip((frame,), background)
        return alone.model_copy(update={"exposure_s": 1.0, "interval_s": 1.0, **({} if camera else {"K": nowhere})})


class FramesHandle(Record):
    """Some of a clip's frames as pictures."""

    files: tuple[FileHandle, ...]


class PlateHandle(FileHandle):
    """The background, in the footage's own values; ``source`` says where it comes from."""

    source: str


class TrackHandle(Record):
    """Where the person is in every frame.

    Attributes:
        boxes: left, top, right, bottom [px]; None where the person is not seen.
        others: how many more people are seen.
    """

    name: str
    boxes: tuple[tuple[float, float, float, float] | None, ...]
    others: int = 0


class PersonSeen(Record):
    """One of several people: how to choose that one, and in how many frames they are seen."""

    name: str
    choice: PersonChoice
    frames: int


class PeopleHandle(Record):
    """Everyone in a clip, in the order of appearance."""

    people: tuple[PersonSeen, ...]


class MatteHandle(Record):
    """The person's share of each pixel of a frame; no file, but a reason, where nobody is seen.

    Attributes:
        area_px: the matte's sum.
    """

    file: FileHandle | None
    area_px: float = 0.0
    reason: str = ""


class FrameCall(Call):
    """One frame of a clip.

    Attributes:
        still: the frame as a clip of its own.
        number: of the frame in the clip.
        folder: where the result goes.
    """

    still: ClipHandle
    number: int
    folder: Path


class SeenFrameCall(FrameCall):
    """One frame in which the person is seen.

    Attributes:
        matte: of the frame.
        body: the user's body model; None for the embedded one.
    """

    matte: FileHandle
    body: FileHandle | None


class BodyFound(Record):
    """The first body of a frame; none, but a reason, where it was not found."""

    first: FirstBodyHandle | None
    reason: str = ""


class ClipBodiesHandle(Record):
    """First bodies of a whole clip.

    Attributes:
        firsts: one per frame; None in a gap.
        filled: frames whose body was made from their neighbours'.
        usable: frames that can be fitted.
    """

    firsts: tuple[FirstBodyHandle | None, ...]
    filled: tuple[bool, ...]
    usable: tuple[bool, ...]


class WindowHandle(FileHandle):
    """The fit of a window (see `hfb.fitting.clip.windows.WindowFit`)."""

    frames: tuple[int, ...]
    segment: int
    loss: float


class JoinedHandle(Record):
    """The motion of the whole clip.

    Attributes:
        edges: a JSON file of what happened at every window edge.
        gaps: first and last frame of every stretch without a pose.
        bridged: frames without anybody whose poses were made from their neighbours'.
        worst_jump_mm: the largest at any edge; None without edges.
        worst_velocity_share: the largest at any edge; None without edges.
    """

    motion: FileHandle
    edges: FileHandle
    gaps: tuple[tuple[int, int], ...]
    bridged: tuple[int, ...]
    rows: int
    worst_jump_mm: float | None
    worst_velocity_share: float | None


class FrameScoresHandle(Record):
    """How well the joined motion explains some frames, by name, in the order of ``frames``."""

    frames: tuple[int, ...]
    scores: dict[str, tuple[float, ...]]
