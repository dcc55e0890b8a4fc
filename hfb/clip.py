"""clip.toml: what is known about a recording besides its pictures.

    transfer = "srgb"              # how the files store light: "srgb" (default) or "linear"

    [camera]
    focal_px = 1460.0              # or the whole matrix:
    K = [[1460, 0, 640], [0, 1460, 360], [0, 0, 1]]

    [exposure]
    fps = 30.0
    seconds = 0.02                 # or shutter_fraction = 0.6, or shutter_angle = 216

Every entry may be left out.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from hfb.config import Record
from hfb.toml_file import read_toml, to_record

_Row = tuple[float, float, float]


class ClipCamera(Record):
    """A calibration of the full picture [px]; pixel (0, 0)'s centre lies at (0.5, 0.5)."""

    focal_px: Annotated[float, Field(gt=0)] | None = None
    K: tuple[_Row, _Row, _Row] | None = None

    @model_validator(mode="after")
    def _one_calibration(self) -> "ClipCamera":
        if self.K is None:
            return self
        if self.focal_px is not None:
            raise ValueError("give focal_px or K, not both")
        (fx, skew, _), (zero, fy, _), last = self.K
        if fx <= 0 or fy <= 0 or skew != 0 or zero != 0 or list(last) != [0, 0, 1]:
            raise ValueError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0: undistort the pictures")
        return self


class ClipExposure(Record):
    """When the shutter was open. At most one of the three lengths."""

    fps: Annotated[float, Field(gt=0)] | None = None
    seconds: Annotated[float, Field(gt=0)] | None = None
    shutter_fraction: Annotated[float, Field(gt=0, le=1)] | None = None
    shutter_angle: Annotated[float, Field(gt=0, le=360)] | None = None

    @model_validator(mode="after")
    def _one_length(self) -> "ClipExposure":
        if sum(length is not None for length in (self.seconds, self.shutter_fraction, self.shutter_angle)) > 1:
            raise ValueError("give one of seconds, shutter_fraction and shutter_angle, not several")
        return self

    def exposure_s(self, interval_s: float) -> float | None:
        """The exposure [s] for a frame interval [s]; None where the file does not say."""
        if self.shutter_fraction is not None:
            return self.shutter_fraction * interval_s
        if self.shutter_angle is not None:
            return self.shutter_angle / 360 * interval_s
        return self.seconds


class Clip(Record):
    """The content of a clip.toml; ``Clip()`` knows nothing."""

    transfer: Literal["srgb", "linear"] = "srgb"
    camera: ClipCamera = ClipCamera()
    exposure: ClipExposure = ClipExposure()


def read_clip(path: Path) -> Clip:
    """Read a clip.toml.

    Raises:
        InputError: the file is missing, no TOML, or holds an entry that is unknown or impossible.
    """
    return to_record(Clip, read_toml(path), str(path))
