"""clip.toml: facts about a recording besides its images.

    transfer = "srgb"              # how the files store light: "srgb" (default), "linear", "bt709" or "gamma22"
    video = "walk.mp4"             # or a folder of images, beside this file
    scan = "progressive"           # its frames are whole images, although they are flagged as interlaced
    start_s = 1.5                  # time range of the video [s], or in frames: start = 45, stop = 90 (exclusive)
    stop_s = 3.0
    background = "plate.png"       # or "median" (over time), or "still" (a span in which nobody moves)

    [camera]
    focal_px = 1460.0              # or the whole matrix:
    K = [[1460, 0, 640], [0, 1460, 360], [0, 0, 1]]
    calibration = "Calib.toml"     # or a file: Pose2Sim's, OpenCV's, ROS', Kalibr's
    name = "cam01"                 # which of its cameras
    rotation = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]   # world to camera, as OpenCV has it, for exports
    translation = [0, 1.2, 4]      # world to camera [m]
    world_up = "z"                 # axis of that world that points up (default), or "-z", "y", "-y"
    tilt_deg = 12.0                # or the camera's direction alone: it looks down by so much
    roll_deg = 0.0                 # what stands upright leans to the right in the image by so much
    floor = [0, 0, 1, 0.02]        # a plane's normal and height [m] in that world, else in the camera's; or "estimate"

    [exposure]
    fps = 30.0
    seconds = 0.02                 # or shutter_fraction = 0.6, or shutter_angle = 216, or auto = true (from metadata)
    position = "start"             # where the exposure lies in the frame's interval: "start", "middle", "end"
    readout_s = 0.012              # rolling shutter: from the first row's exposure to the last row's [s]
    readout_to = "down"            # where the last row lies in the picture as shown; "left" or "right" of a phone
                                   # that is held upright

    [person]
    box = [310, 80, 420, 400]      # left, top, right, bottom [px] in frame `frame`; or which = "largest" (default)
    frame = 0
    track = "tracks.csv"           # or a track of another system's file, with its id
    id = 3
    height_m = 1.82                # soles to crown, where it is known: no image shows it

Every entry may be left out. Files are named relative to this one and lie in its folder, or below: a clip that somebody
hands over must not be able to show what lies elsewhere.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator

from hfb.config import (
    ExposureSeconds,
    Floor,
    FocalPx,
    FramesPerS,
    HeightM,
    ReadoutSeconds,
    ReadoutTo,
    Record,
    RollDeg,
    TiltDeg,
    WorldUp,
    within,
)
from hfb.errors import InputError
from hfb.geometry.world import Row, Rows, rotation_fault
from hfb.io.toml_file import read_toml, to_record

BACKGROUND_WORDS = ("median", "still")
"""Backgrounds that are made from the clip itself."""

_MOST_FRAMES, _LONGEST_S, _LARGEST_PX = 10**9, 1e10, 1e7


class _ClipRecord(Record):
    """A record whose numbers are finite."""

    model_config = ConfigDict(allow_inf_nan=False)


class ClipCamera(_ClipRecord):
    """A calibration of the full image [px]; the centre of pixel (0, 0) is at (0.5, 0.5).

    Attributes:
        rotation: world to camera, x = R X + t; it wins over that of the calibration file.
        translation: world to camera [m].
    """

    focal_px: FocalPx | None = None
    K: Rows | None = None
    calibration: Path | None = None
    name: str | None = None
    rotation: Rows | None = None
    translation: Row | None = None
    world_up: WorldUp | None = None
    tilt_deg: TiltDeg | None = None
    roll_deg: RollDeg | None = None
    floor: Floor | None = None

    @property
    def has_lens(self) -> bool:
        """Whether a focal length is known."""
        return self.focal_px is not None or self.K is not None or self.calibration is not None

    @model_validator(mode="after")
    def _one_pose(self) -> "ClipCamera":
        if (self.rotation is None) != (self.translation is None):
            raise ValueError("give rotation and translation of the camera, or neither")
        if self.rotation is None:
            return self
        if self.tilt_deg is not None or self.roll_deg is not None:
            raise ValueError("give rotation and translation, or tilt_deg and roll_deg, not both")
        if fault := rotation_fault(self.rotation):
            raise ValueError(f"rotation {fault}")
        return self

    @model_validator(mode="after")
    def _one_calibration(self) -> "ClipCamera":
        if self.calibration is not None and (self.K is not None or self.focal_px is not None):
            raise ValueError("give focal_px, K or a calibration file, not several")
        if self.name is not None and self.calibration is None:
            raise ValueError("name chooses a camera of a calibration file: give calibration too")
        if self.K is None:
            return self
        if self.focal_px is not None:
            raise ValueError("give focal_px or K, not both")
        (fx, skew, _), (zero, fy, _), last = self.K
        if max(map(abs, (*self.K[0], *self.K[1]))) > _LARGEST_PX:
            raise ValueError(f"K must have no number above {_LARGEST_PX:g}: it is in pixels")
        if fx <= 0 or fy <= 0 or skew != 0 or zero != 0 or list(last) != [0, 0, 1]:
            raise ValueError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0: undistort the pictures")
        return self


class ClipExposure(_ClipRecord):
    """The exposure. At most one of the three lengths, or ``auto``, which reads the footage's metadata."""

    fps: FramesPerS | None = None
    seconds: ExposureSeconds | None = None
    shutter_fraction: Annotated[float, Field(gt=0, le=1), within(1e-4, 1)] | None = None
    shutter_angle: Annotated[float, Field(gt=0, le=360), within(0.036, 360)] | None = None
    auto: bool = False
    position: Literal["start", "middle", "end"] = "start"
    readout_s: ReadoutSeconds | None = None
    readout_to: ReadoutTo | None = None

    @model_validator(mode="after")
    def _one_length(self) -> "ClipExposure":
        if sum(length is not None for length in (self.seconds, self.shutter_fraction, self.shutter_angle)) > 1:
            raise ValueError("give one of seconds, shutter_fraction and shutter_angle, not several")
        if self.auto and (self.seconds or self.shutter_fraction or self.shutter_angle):
            raise ValueError("auto and a length exclude each other: give one of them")
        return self

    def exposure_s(self, interval_s: float) -> float | None:
        """Return the exposure [s] for a frame interval; None where the file does not state one.

        Args:
            interval_s: time from frame to frame.
        """
        if self.shutter_fraction is not None:
            return self.shutter_fraction * interval_s
        if self.shutter_angle is not None:
            return self.shutter_angle / 360 * interval_s
        return self.seconds


class PersonChoice(_ClipRecord):
    """The person to follow where several are seen: the largest, the one in a box, or another system's track.

    `everyone` follows each of them in turn, as if each had been chosen.

    Attributes:
        height_m: the person's height, where it is known.
    """

    which: Literal["largest", "everyone"] = "largest"
    box: tuple[float, float, float, float] | None = None
    frame: Annotated[int, Field(ge=0)] = 0
    track: Path | None = None
    id: int | str | None = None
    height_m: HeightM | None = None

    @model_validator(mode="after")
    def _one_choice(self) -> "PersonChoice":
        if self.box is not None and self.track is not None:
            raise ValueError("give a box or a track, not both")
        if self.id is not None and self.track is None:
            raise ValueError("id is a person's in a file of tracks: give track too")
        if self.which == "everyone" and (self.box is not None or self.id is not None):
            raise ValueError("everyone excludes a box and an id: give one of them")
        if self.which == "everyone" and self.height_m is not None:
            raise ValueError("height_m is one person's: it does not go with everyone")
        if self.box is not None and not (self.box[0] < self.box[2] and self.box[1] < self.box[3]):
            raise ValueError("box must be [left, top, right, bottom] with left < right and top < bottom")
        return self


class Clip(_ClipRecord):
    """The content of a clip.toml; ``Clip()`` states nothing."""

    transfer: Literal["srgb", "linear", "bt709", "gamma22"] = "srgb"
    video: Path | None = None
    scan: Literal["auto", "progressive"] = "auto"
    start: Annotated[int, Field(ge=0, le=_MOST_FRAMES)] | None = None
    stop: Annotated[int, Field(gt=0, le=_MOST_FRAMES)] | None = None
    start_s: Annotated[float, Field(ge=0, le=_LONGEST_S)] | None = None
    stop_s: Annotated[float, Field(gt=0, le=_LONGEST_S)] | None = None
    background: str | None = None
    camera: ClipCamera = ClipCamera()
    exposure: ClipExposure = ClipExposure()
    person: PersonChoice = PersonChoice()

    @model_validator(mode="after")
    def _one_range(self) -> "Clip":
        if (self.start is not None and self.start_s is not None) or (self.stop is not None and self.stop_s is not None):
            raise ValueError("give the range in frames (start, stop) or in seconds (start_s, stop_s), not both")
        for first, last in ((self.start, self.stop), (self.start_s, self.stop_s)):
            if first is not None and last is not None and first >= last:
                raise ValueError("the range is empty: its start must lie before its stop")
        return self


def read_clip(path: Path) -> Clip:
    """Read a clip.toml; its paths become relative to the working folder.

    Args:
        path: the clip.toml.

    Raises:
        InputError: the file is missing, no TOML, holds an entry that is unknown or impossible, or names a file that
            does not lie in its folder.
    """
    clip = to_record(Clip, read_toml(path), str(path))
    camera, person, background = clip.camera, clip.person, clip.background
    if camera.calibration is not None:
        camera = camera.model_copy(update={"calibration": _beside(path, camera.calibration)})
    if person.track is not None:
        person = person.model_copy(update={"track": _beside(path, person.track)})
    if background is not None and background not in BACKGROUND_WORDS:
        background = str(_beside(path, Path(background)))
    video = _beside(path, clip.video) if clip.video is not None else None
    return clip.model_copy(update={"camera": camera, "person": person, "background": background, "video": video})


def _beside(clip: Path, name: Path) -> Path:
    """Resolve a file that a clip.toml names. Raises InputError where it, or a link's target, is elsewhere."""
    place = clip.parent / name
    try:
        place.exists()  # a name that is too long is found out here
        inside = place.resolve().is_relative_to(clip.parent.resolve())
    except (OSError, ValueError, RuntimeError):  # a name that no file can have, or links in a circle
        inside = False
    if not inside:
        raise InputError(
            f"{clip}: names {str(name)[:200]!r}, which does not lie in its folder: put the file beside it, or give it "
            "on the command line"
        )
    return place
