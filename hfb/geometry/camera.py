"""The pinhole camera: projection from metres to pixels.

Frame: OpenCV's (+x right, +y down, +z forward). The image spans [0, W] x [0, H] and the centre of pixel
(row 0, column 0) is at (0.5, 0.5), so that cropping shifts and resizing scales the matrix, nothing else.
"""

from dataclasses import dataclass, replace
from typing import Literal

import torch

from hfb.typing import Float, Tensor


@dataclass(frozen=True)
class RowClock:
    """A rolling shutter: how late a pixel is exposed after the middle of the whole image.

    delay = across * x / z + down * y / z + middle, in units of the exposure, where (x, y, z) is what the pixel shows in
    camera coordinates. In slopes of rays instead of pixels, a crop or another size of the image changes nothing.
    """

    across: float
    down: float
    middle: float


@dataclass(frozen=True)
class PinholeCamera:
    """Focal lengths and principal point [px] of an image of height x width pixels; no distortion.

    Attributes:
        row_clock: of a rolling shutter; None where all pixels are exposed at once.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    height: int
    width: int
    row_clock: RowClock | None = None

    def with_readout(self, exposures: float, to: Literal["down", "up", "left", "right"]) -> "PinholeCamera":
        """Return this camera of a whole image with a rolling shutter.

        Args:
            exposures: from the first row's exposure to the last row's, in exposures.
            to: where the last row lies in the image.
        """
        if exposures == 0:
            return replace(self, row_clock=None)
        late = -exposures if to in ("up", "left") else exposures
        if to in ("down", "up"):
            clock = RowClock(0.0, late * self.fy / self.height, late * (self.cy / self.height - 0.5))
        else:
            clock = RowClock(late * self.fx / self.width, 0.0, late * (self.cx / self.width - 0.5))
        return replace(self, row_clock=clock)

    @staticmethod
    def from_focal(focal_px: float, height: int, width: int) -> "PinholeCamera":
        """Return the camera of one focal length whose optical axis passes through the image's middle.

        Args:
            focal_px: focal length.
            height: height of the image [px].
            width: width of the image [px].
        """
        return PinholeCamera(float(focal_px), float(focal_px), width / 2, height / 2, int(height), int(width))

    @staticmethod
    def from_matrix(K: Float[Tensor, "3 3"], height: int, width: int) -> "PinholeCamera":
        """Return the camera of a calibration matrix; its skew, if any, is ignored.

        Args:
            K: calibration matrix [px].
            height: height of the image [px].
            width: width of the image [px].
        """
        fx, fy, cx, cy = (float(K[row, column]) for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return PinholeCamera(fx, fy, cx, cy, int(height), int(width))

    def matrix(self, dtype: torch.dtype = torch.float64) -> Float[Tensor, "3 3"]:
        """Return K, which maps a direction (x, y, 1) to homogeneous pixels.

        Args:
            dtype: precision of K.
        """
        return torch.tensor([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]], dtype=dtype)

    def project(self, points: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 2"]:
        """Return the pixels (x, y) of points in camera coordinates.

        Args:
            points: in front of the lens, z > 0 [m].
        """
        xy = points[..., :2] / points[..., 2:]
        return torch.stack([xy[..., 0] * self.fx + self.cx, xy[..., 1] * self.fy + self.cy], -1)

    def unproject(self, pixels: Float[Tensor, "*n 2"], depth: Float[Tensor, "*n"]) -> Float[Tensor, "*n 3"]:
        """Return the points [m] in camera coordinates at given pixels and depths.

        Args:
            pixels: (x, y) [px].
            depth: z [m].
        """
        x = (pixels[..., 0] - self.cx) / self.fx * depth
        y = (pixels[..., 1] - self.cy) / self.fy * depth
        return torch.stack([x, y, depth], -1)

    def crop(self, left: float, top: float, width: int, height: int) -> "PinholeCamera":
        """Return the camera of a window of this image; the window may reach outside it.

        Args:
            left: left edge of the window [px].
            top: top edge of the window [px].
            width: width of the window [px].
            height: height of the window [px].
        """
        return replace(self, cx=self.cx - left, cy=self.cy - top, height=int(height), width=int(width))

    def resize(self, height: int, width: int) -> "PinholeCamera":
        """Return the camera of the same view with another number of pixels.

        Args:
            height: height of the image [px].
            width: width of the image [px].
        """
        down, right = height / self.height, width / self.width
        return replace(
            self,
            fx=self.fx * right,
            fy=self.fy * down,
            cx=self.cx * right,
            cy=self.cy * down,
            height=int(height),
            width=int(width),
        )
