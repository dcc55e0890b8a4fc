"""Handles that the tasks of a clip exchange; see `hfb.tasks.core.handles`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hfb.config import Record
from hfb.geometry.world import Rows, World
from hfb.io.clip import PersonChoice
from hfb.tasks.core.handles import Call, ClipHandle, FileHandle, FirstBodyHandle, FrameHandle, ReadoutRecord


class FootageHandle(FileHandle):
    """Everything known about a clip but its images: footage and timing, as a JSON file.

    Attributes:
        count: frames that can be decoded, after averaging.
        bits: of the images that its frames are stored as.
        remarks: sentences for the user.
        world: of exports; None where nothing is known of it. Fits depend on its stated floor alone.
        readout: see `ClipHandle`.
    """

    count: int
    height: int
    width: int
    K: Rows
    exposure_s: float
    interval_s: float
    transfer: Literal["srgb", "linear"]
    light: Literal["srgb", "linear"]
    bits: Literal[8, 16]
    remarks: tuple[str, ...]
    world: World | None = None
    readout: ReadoutRecord | None = None

    def clip(self, frames: tuple[FrameHandle, ...], background: FileHandle) -> ClipHandle:
        """Return some frames as a clip of their own.

        Args:
            frames: image files.
            background: the plate.
        """
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
            world=self.world if self.world and self.world.floor else None,
            readout=self.readout,
        )

    def still(self, frame: FrameHandle, background: FileHandle, camera: bool = False) -> ClipHandle:
        """Return one frame without times, so that steps that use none keep their cached results when the times change.

        Args:
            frame: an image file.
            background: the plate.
            camera: whether to keep K; otherwise it is the identity.
        """
        nowhere = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        alone = self.clip((frame,), background)
        update = {
            "exposure_s": 1.0,
            "interval_s": 1.0,
            "readout": None,
            "world": None,
            **({} if camera else {"K": nowhere}),
        }
        return alone.model_copy(update=update)


class FramesHandle(Record):
    """Some of a clip's frames as image files.

    Attributes:
        beside_px: how far the first and the last of them lie beside the plate [px].
    """

    files: tuple[FrameHandle, ...]
    beside_px: tuple[float, ...] = ()


class PlateHandle(FileHandle):
    """The background in the footage's own values; ``source`` names its origin."""

    source: str


class TrackHandle(Record):
    """Position of the person in every frame.

    Attributes:
        boxes: left, top, right, bottom [px]; None where the person is not visible.
        others: number of further people.
    """

    name: str
    boxes: tuple[tuple[float, float, float, float] | None, ...]
    others: int = 0


class PersonSeen(Record):
    """One of several people: the option that selects them, and the number of frames in which they are visible."""

    name: str
    choice: PersonChoice
    frames: int


class PeopleHandle(Record):
    """All people of a clip, in the order of appearance."""

    people: tuple[PersonSeen, ...]


class MatteHandle(Record):
    """The person's share of each pixel of a frame; a reason instead of a file where no person is visible.

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
    """One frame in which the person is visible.

    Attributes:
        matte: of the frame.
        body: the user's body model; None for the embedded one.
    """

    matte: FileHandle
    body: FileHandle | None


class BodyFound(Record):
    """The first body of a frame; a reason instead where none was found."""

    first: FirstBodyHandle | None
    reason: str = ""


class ClipBodiesHandle(Record):
    """First bodies of a whole clip.

    Attributes:
        firsts: one per frame; None in a gap.
        filled: frames whose body was interpolated from their neighbours'.
        usable: frames that can be fitted.
        reasons: frame -> why no body was found in it.
    """

    firsts: tuple[FirstBodyHandle | None, ...]
    filled: tuple[bool, ...]
    usable: tuple[bool, ...]
    reasons: dict[int, str] = Field(default_factory=dict)


class WindowHandle(FileHandle):
    """The fit of a window (see `hfb.fitting.clip.windows.WindowFit`)."""

    frames: tuple[int, ...]
    segment: int
    loss: float
    mirrored: bool = False
    front_log_odds: float = 0.0
    front_turn_deg: float = 0.0


class JoinedHandle(Record):
    """The motion of the whole clip.

    Attributes:
        edges: a JSON file of the jumps at every window edge.
        gaps: first and last frame of every stretch without a pose.
        bridged: frames without a visible person whose poses were interpolated.
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
    """Scores of the joined motion by name, one value per frame in the order of ``frames``."""

    frames: tuple[int, ...]
    scores: dict[str, tuple[float, ...]]
