"""The window of a case on its video: around the person, undistorted, at the case's size."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from hfb.datasets.real.source_videos import Footage
from hfb.datasets.real.video_assets import Recording
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.io.media.lens.camera_files import CalibratedCamera
from hfb.matting.camera_noise import exposure_gain
from hfb.matting.known_background import gather_evidence, main_change
from hfb.matting.matting_protocol import shrink
from hfb.typing import Array, Bool, Float

_DETECTION_PX = 480
_MARGIN = 0.12  # of the person's longer side: matting needs some background
_REACH = 0.12  # of the joints' longer side: hands, feet and hair reach beyond the joints
_LEAST_PX = 48  # limbs of a smaller person are not visible


@dataclass(frozen=True)
class Box:
    """left, top, right, bottom in pixels of the full image, spanning [0, W] x [0, H]."""

    left: float
    top: float
    right: float
    bottom: float

    def grown(self, share: float) -> "Box":
        """Widen the box on each side by a share of the longer side.

        Args:
            share: share of the longer side.
        """
        pad = share * max(self.right - self.left, self.bottom - self.top)
        return Box(self.left - pad, self.top - pad, self.right + pad, self.bottom + pad)


@dataclass(frozen=True)
class View:
    """A window of the full image at another size; all images of a case show it.

    Attributes:
        left: left edge of the window in the undistorted full image [px].
        top: top edge [px].
        width: width [px].
        height: height [px].
        camera: the pinhole of the case's images, in this project's pixel convention.
        source: for each pixel of the window where its light lies in the stored image; None without distortion.
        body: possible region of the chosen person, in the case's images.
    """

    footage: Footage
    left: int
    top: int
    width: int
    height: int
    camera: PinholeCamera
    source: Float[Array, "2 h w"] | None = None
    body: Bool[Array, "a b"] | None = None

    def see(self, stored: Float[Array, "H W 3"]) -> Float[Array, "h w 3"]:
        """Return a stored full image through the window, in linear light; every pixel the mean of what it covers.

        Args:
            stored: full image as stored in [0, 1].
        """
        if self.source is None:
            window = stored[self.top : self.top + self.height, self.left : self.left + self.width]
            linear = self.footage.to_linear(np.ascontiguousarray(window))
        else:
            x, y = self.source
            height, width = stored.shape[:2]
            left, top = (max(0, int(np.floor(axis.min())) - 1) for axis in (x, y))
            right, bottom = min(width, int(np.ceil(x.max())) + 2), min(height, int(np.ceil(y.max())) + 2)
            near = self.footage.to_linear(np.ascontiguousarray(stored[top:bottom, left:right]))
            linear = cv2.remap(near, x - left, y - top, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        size = (self.camera.width, self.camera.height)
        return np.asarray(cv2.resize(linear, size, interpolation=cv2.INTER_AREA), np.float32)


def make_view(
    footage: Footage,
    box: Box,
    full: PinholeCamera,
    calibrated: CalibratedCamera | None,
    size_px: int,
    body: Bool[Array, "h w"] | None = None,
) -> View:
    """Build the window around a person's box.

    Args:
        footage: the video.
        box: box of the person in all frames of the case.
        full: the camera of the undistorted full image.
        calibrated: the lens, or None.
        size_px: longer side of the case's images; a smaller window is not enlarged.
        body: possible region of the person, in a reduced full image; None for everywhere.

    Raises:
        InputError: the person is too small.
    """
    wide = box.grown(_MARGIN)
    left, top = max(0, int(np.floor(wide.left))), max(0, int(np.floor(wide.top)))
    right, bottom = min(full.width, int(np.ceil(wide.right))), min(full.height, int(np.ceil(wide.bottom)))
    width, height = right - left, bottom - top
    if max(width, height) < _LEAST_PX or min(width, height) < 8:
        raise InputError(f"{footage.path}: the person is {width} x {height} px, too small to show a motion.")
    scale = min(1.0, size_px / max(width, height))
    camera = full.crop(left, top, width, height).resize(max(8, round(height * scale)), max(8, round(width * scale)))
    bent = calibrated is not None and calibrated.bends
    source = calibrated.undistortion(left, top, width, height) if calibrated and bent else None
    view = View(footage, left, top, width, height, camera, source)
    return view if body is None else replace(view, body=_seen_region(view, body, full))


def box_of_joints(pixels: Float[Array, "*n 2"]) -> Box:
    """Return the box around projected joints, with a margin for the body's surface.

    Args:
        pixels: projected joints [px], NaN where unknown.

    Raises:
        InputError: none is known.
    """
    known = pixels[np.isfinite(pixels).all(-1)]
    if not len(known):
        raise InputError("no joint is known in this window; choose another one.")
    (left, top), (right, bottom) = known.min(0), known.max(0)
    return Box(float(left), float(top), float(right), float(bottom)).grown(_REACH)


def box_of_change(recording: Recording, footage: Footage, first: int, count: int) -> tuple[Box, Bool[Array, "h w"]]:
    """Return the box of the largest thing that moved in some frames, and its region in a small image.

    Args:
        recording: the video with its plate.
        footage: the video.
        first: number of the first frame.
        count: number of frames.

    Raises:
        InputError: nothing differs from the plate.
    """
    plate = footage.to_linear(shrink(recording.stored_plate(), _DETECTION_PX))
    most = np.zeros(plate.shape[:2], np.float32)
    full = (0, 0)
    for stored in footage.stored_frames(first, first + count):
        full = stored.shape[0], stored.shape[1]
        frame = footage.to_linear(shrink(stored, _DETECTION_PX))
        found = gather_evidence(frame, np.clip(plate * exposure_gain(frame, plate), 0, 1))
        most = np.maximum(most, np.where(found.change > 6, found.change, 0))
    body = main_change(most)
    rows, columns = np.flatnonzero(body.any(1)), np.flatnonzero(body.any(0))
    if not rows.size:
        raise InputError(f"{footage.path}: nobody moves in frames {first} to {first + count - 1}.")
    right, down = full[1] / body.shape[1], full[0] / body.shape[0]
    box = Box(columns[0] * right, rows[0] * down, (columns[-1] + 1) * right, (rows[-1] + 1) * down)
    return Box(*(float(side) for side in (box.left, box.top, box.right, box.bottom))), body


def _seen_region(view: View, body: Bool[Array, "h w"], full: PinholeCamera) -> Bool[Array, "H W"]:
    """Return a region of a small full image, a little widened, in the case's images."""
    reach = 2 * max(2, round(0.015 * max(body.shape))) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    near = cv2.dilate(body.astype(np.uint8), disc)
    # Centres of the case's pixels in the small image's pixels: nearest neighbour.
    rows = view.top + (np.arange(view.camera.height) + 0.5) * view.height / view.camera.height
    columns = view.left + (np.arange(view.camera.width) + 0.5) * view.width / view.camera.width
    at_rows = (rows * body.shape[0] / full.height).astype(int).clip(0, body.shape[0] - 1)
    at_columns = (columns * body.shape[1] / full.width).astype(int).clip(0, body.shape[1] - 1)
    return near[np.ix_(at_rows, at_columns)] > 0
