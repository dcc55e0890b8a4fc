"""A person's motion and all that its exports need."""

from dataclasses import dataclass

from hfb.body.model import BetasSpace, Body
from hfb.config import AmassRate, CsvFrame, ExportConfig
from hfb.motion.sampled import SampledMotion


@dataclass(frozen=True)
class Exported:
    """A person's motion and the data that exports need.

    Attributes:
        motion: camera coordinates.
        betas_space: space of the motion's shape coefficients.
        body: the model it was fitted with; None is enough for formats without a surface.
        texture_png: the person's texture as an sRGB image; a plain colour, or none, without it.
        amass_rate: poses per second in amass.npz.
        csv_frame: coordinates in joints.csv.
        fps: frames per second of the program that opens files with a camera.
        plate: name of the background's file beside it.
    """

    motion: SampledMotion
    betas_space: BetasSpace
    body: Body | None = None
    texture_png: bytes | None = None
    amass_rate: AmassRate = 120
    csv_frame: CsvFrame = "camera"
    fps: float = ExportConfig().fps
    plate: str | None = None

    @property
    def surface(self) -> Body:
        """The body of formats with a surface. Raises ValueError where it is not given."""
        if self.body is None:
            raise ValueError("a format with a surface needs the body model")
        return self.body
