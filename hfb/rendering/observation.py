"""The input of a fit: blurred frames of one static camera, their background plate and mattes."""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
import torch

from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera, RowClock
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.typing import Float, Tensor


@dataclass(frozen=True)
class Observation:
    """T frames with everything that a fit uses of them.

    Attributes:
        frames_linear: the blurred images, in the light in which blur is an average.
        plate_linear: the clean background.
        mattes: the person's share of each pixel, alpha_in.
        exposure_s: length of each exposure.
        interval_s: time from one opening of the shutter to the next.
        light: which light ``_linear`` means here; ``"srgb"`` for sets whose blur was averaged in sRGB.
    """

    frames_linear: Float[Tensor, "T H W 3"]
    plate_linear: Float[Tensor, "H W 3"]
    mattes: Float[Tensor, "T H W"]
    camera: PinholeCamera
    exposure_s: float
    interval_s: float
    light: Literal["linear", "srgb"] = "linear"

    @property
    def timing(self) -> tuple[float, float, RowClock | None]:
        """Exposure and interval [s], and the clock of the rows: what fits in one batch share."""
        return self.exposure_s, self.interval_s, self.camera.row_clock

    def to_srgb(self, picture: Float[Tensor, "*t H W 3"]) -> Float[Tensor, "*t H W 3"]:
        """Encode an image in this observation's light as sRGB, as a file stores it.

        Args:
            picture: in the light of `light`.
        """
        return linear_to_srgb(picture.clamp(0, 1)) if self.light == "linear" else picture.clamp(0, 1)

    def to_linear(self, picture: Float[Tensor, "*t H W 3"]) -> Float[Tensor, "*t H W 3"]:
        """Convert an image in this observation's light to linear light.

        Args:
            picture: in the light of `light`.
        """
        return picture if self.light == "linear" else srgb_to_linear(picture.clamp(0, 1))

    def region(self, margin: float = 0.15, threshold: float = 0.05, square: bool = False) -> tuple[int, int, int, int]:
        """Return left, top, width, height [px] of the box around all mattes, widened by a share of its size.

        The box may reach outside the image, as the body may.

        Args:
            margin: added on each side, as a share of the longer side.
            threshold: alpha above which a pixel counts.
            square: make the shorter sides as long as the others, about the same middle.

        Raises:
            InputError: no pixel of any matte reaches the threshold.
        """
        rows, columns = np.nonzero((self.mattes.amax(0) > threshold).numpy())
        if rows.size == 0:
            raise InputError("the matte is empty: no person differs from the background; check the plate")
        left, right, top, bottom = columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
        pad = max(2, round(margin * max(right - left, bottom - top)))
        width, height = int(right - left + 2 * pad), int(bottom - top + 2 * pad)
        across, down = ((max(width, height) - one) // 2 if square else 0 for one in (width, height))
        wide, high = (max(width, height),) * 2 if square else (width, height)
        return int(left - pad) - across, int(top - pad) - down, wide, high

    def cropped(self, left: int, top: int, width: int, height: int) -> "Observation":
        """Return the scene through a window; outside the image its border is repeated, without a person.

        Args:
            left: left edge of the window [px], may be negative.
            top: top edge of the window [px], may be negative.
            width: width of the window [px].
            height: height of the window [px].
        """
        full_height, full_width = self.mattes.shape[1:]
        window = (
            slice(max(top, 0), min(top + height, full_height)),
            slice(max(left, 0), min(left + width, full_width)),
        )
        pads = (max(-top, 0), max(top + height - full_height, 0), max(-left, 0), max(left + width - full_width, 0))

        def cut(picture: Tensor, border: int) -> Tensor:
            inside = np.ascontiguousarray(picture[window].numpy())
            return torch.from_numpy(cv2.copyMakeBorder(inside, *pads, border, value=0))

        return replace(
            self,
            frames_linear=torch.stack([cut(frame, cv2.BORDER_REPLICATE) for frame in self.frames_linear]),
            plate_linear=cut(self.plate_linear, cv2.BORDER_REPLICATE),
            mattes=torch.stack([cut(matte, cv2.BORDER_CONSTANT) for matte in self.mattes]),
            camera=self.camera.crop(left, top, width, height),
        )

    def resized(self, longer_side_px: int) -> "Observation":
        """Return the scene at another scale, every new pixel the mean of what it covers (as of a coarser sensor).

        Args:
            longer_side_px: longer side of the new images.
        """
        height, width = self.mattes.shape[1:]
        scale = longer_side_px / max(height, width)
        new_height, new_width = max(round(height * scale), 8), max(round(width * scale), 8)
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR

        def shrink(picture: Tensor) -> Tensor:
            return torch.from_numpy(cv2.resize(picture.numpy(), (new_width, new_height), interpolation=interpolation))

        return replace(
            self,
            frames_linear=torch.stack([shrink(frame) for frame in self.frames_linear]),
            plate_linear=shrink(self.plate_linear),
            mattes=torch.stack([shrink(matte) for matte in self.mattes]),
            camera=self.camera.resize(new_height, new_width),
        )
