"""Alignment of a plate that is shifted by some pixels.

Where a tripod was touched, a plate is of another take, or a phone's crop follows the lens, every edge of the background
would look like a person's. The movement (shift, turn, scale) is found by Gauss-Newton on gray images, coarse to fine
(Lucas and Kanade 1981), with weights that exclude the person (Geman and McClure), together with exposure gain and
offset. Both search and result interpolate with B-splines: OpenCV's cubic kernel (a = -0.75) is up to 0.05 px off, its
Lanczos kernel rounds positions to 1/32 px, and linear interpolation blurs, which biases the search.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

_LEVELS_PX = (160, 320, 640)
_ROUNDS = 8
_SETTLED_PX = 0.001
_DEGREE, _FINEST_DEGREE = 3, 5  # of splines
_LEAST_PX = 0.04
"""Smallest movement that is mended, in an image of 640 px; half of that size tells it to a hundredth of a pixel."""
MOST_PX = 4.0
"""Largest movement of a plate, in an image of 640 px."""
_LEAST_GAIN = 0.04  # by which the differences at edges must fall
_EDGE_SHARE = 0.3
_LEAST_EDGE = 0.004  # a plain wall does not determine it


@dataclass(frozen=True)
class Movement:
    """A small similarity from the frame's pixels to the plate's, about the image's middle.

    Attributes:
        shift: right and down, as a share of the image's longer side.
        scale: x' = x + scale x - turn y, y' = y + turn x + scale y.
        turn: x' = x + scale x - turn y, y' = y + turn x + scale y.
    """

    shift: Float[Array, "2"]
    scale: float
    turn: float

    def matrix(self, height: int, width: int) -> Float[Array, "2 3"]:
        """Return the affine map from pixel indices of the frame to pixel indices of the plate.

        Args:
            height: height of the image [px].
            width: width of the image [px].
        """
        turned = np.array([[1 + self.scale, -self.turn], [self.turn, 1 + self.scale]])
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        offset = middle + self.shift * max(height, width) - turned @ middle
        return np.concatenate([turned, offset[:, None]], 1)

    def farthest_px(self, height: int, width: int) -> float:
        """Return how far the image's corners move [px].

        Args:
            height: height of the image [px].
            width: width of the image [px].
        """
        half = np.hypot(height, width) / 2
        return float(np.hypot(*self.shift) * max(height, width) + half * np.hypot(self.scale, self.turn))


_NONE = Movement(np.zeros(2), 0.0, 0.0)


def aligned_plate(frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    """Move the plate onto the frame.

    The plate is returned as it is where it already lies there, or where no small movement explains the difference.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], from the same camera in the same size.
    """
    movement = find_movement(frame_linear, plate_linear)
    return plate_linear if movement is None else moved_plate(plate_linear, movement)


def moved_plate(plate_linear: Float[Array, "H W 3"], movement: Movement) -> Float[Array, "H W 3"]:
    """Resample the plate where the frame's pixels lie; its border is extended.

    Args:
        plate_linear: linear light in [0, 1], from the same camera in the same size.
        movement: movement from frame to plate, by `find_movement`.
    """
    # large images are shrunk before a matte is found, which removes what the higher degree keeps
    degree = _FINEST_DEGREE if max(plate_linear.shape[:2]) <= _LEVELS_PX[-1] else _DEGREE
    channels = np.moveaxis(plate_linear, -1, 0)
    moved = [_moved(_spline(channel, degree), movement, degree) for channel in channels]
    return np.maximum(np.stack(moved, -1), 0)


def find_movement(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], most_px: float = MOST_PX
) -> Movement | None:
    """Find the small movement between frame and plate; None where there is none to speak of, or none that helps.

    Accurate to a hundredth of a pixel where the background has edges.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], from the same camera in the same size.
        most_px: largest displacement of a corner that counts as small, at the finest level of 640 px.
    """
    movement = _NONE
    frame, plate = _gray(frame_linear), _gray(plate_linear)
    for longer_px in _LEVELS_PX:
        if longer_px == _LEVELS_PX[-1] and movement.farthest_px(*frame.shape) < _LEAST_PX:
            return None
        small = [_shrunk(one, longer_px) for one in (frame, plate)]
        if longer_px == _LEVELS_PX[0] or max(frame.shape) > longer_px / 2:
            movement = _improved(movement, small[0], small[1], most_px)
    height, width = small[0].shape
    if not _LEAST_PX <= movement.farthest_px(height, width) <= most_px:
        return None
    before, after = (_edge_difference(one, *small) for one in (_NONE, movement))
    return movement if after < (1 - _LEAST_GAIN) * before else None


def _gray(picture_linear: Float[Array, "H W 3"]) -> Float[Array, "h w"]:
    """Return the mean of the sRGB channels, no larger than the finest level."""
    height, width = picture_linear.shape[:2]
    scale = min(1.0, _LEVELS_PX[-1] / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(np.asarray(picture_linear, np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(linear_to_srgb(np.clip(small, 0, 1)).mean(-1), np.float32)


def _shrunk(picture: Float[Array, "H W"], longer_px: int) -> Float[Array, "h w"]:
    scale = min(1.0, longer_px / max(picture.shape))
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if scale < 1 else picture
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 0.8), np.float32)


def _spline(picture: Float[Array, "h w"], degree: int = _DEGREE) -> Float[Array, "h w"]:
    """Return the coefficients of the B-spline through the pixels."""
    pixels = np.asarray(picture, np.float32)
    return np.asarray(ndimage.spline_filter(pixels, degree, output=np.float32, mode="nearest"))


def _moved(spline: Float[Array, "h w"], movement: Movement, degree: int = _DEGREE) -> Float[Array, "h w"]:
    """Resample a plate, given as its spline, at the frame's pixels."""
    matrix = movement.matrix(*spline.shape)
    turn_yx, offset_yx = matrix[::-1, 1::-1], matrix[::-1, 2]
    moved = ndimage.affine_transform(
        spline, turn_yx, offset_yx, output=np.float32, order=degree, mode="nearest", prefilter=False
    )
    return np.asarray(moved)


def _slopes(picture: Float[Array, "h w"]) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    across, down = (cv2.Sobel(picture, cv2.CV_32F, *axis, ksize=3) / 8 for axis in ((1, 0), (0, 1)))
    return across, down


def _edges(across: Float[Array, "h w"], down: Float[Array, "h w"]) -> Array:
    """Return indices of the steepest pixels, without those at the border."""
    steep = np.hypot(across, down)
    steep[:4], steep[-4:], steep[:, :4], steep[:, -4:] = 0, 0, 0, 0
    return np.flatnonzero(steep.ravel() > max(_LEAST_EDGE, float(np.quantile(steep, 1 - _EDGE_SHARE))))


def _improved(movement: Movement, frame: Float[Array, "h w"], plate: Float[Array, "h w"], most_px: float) -> Movement:
    """Run Gauss-Newton at one size; unchanged where there are no edges."""
    height, width = frame.shape
    longer, spline = max(height, width), _spline(plate)
    for _ in range(_ROUNDS):
        moved = _moved(spline, movement)
        across, down = _slopes(moved)
        chosen = _edges(across, down)
        if len(chosen) < 50:
            return movement
        rows, columns = np.divmod(chosen, width)
        x, y = columns - (width - 1) / 2, rows - (height - 1) / 2
        gx, gy = (one.ravel()[chosen].astype(np.float64) for one in (across, down))
        value, seen = (one.ravel()[chosen].astype(np.float64) for one in (moved, frame))
        # how the moved plate changes: with shift, scale and turn, then with gain and offset
        slopes = np.stack([gx * longer, gy * longer, gx * x + gy * y, gy * x - gx * y, value, np.ones_like(x)], 1)
        weights = np.ones(len(chosen))
        step = np.zeros(6)
        for _ in range(3):
            weighted = slopes * weights[:, None]
            step = np.linalg.solve(weighted.T @ slopes + 1e-9 * np.eye(6), weighted.T @ (seen - value))
            rest = seen - value - slopes @ step
            usual = 1.5 * 1.4826 * float(np.median(np.abs(rest))) + 1e-4
            weights = 1 / (1 + (rest / usual) ** 2) ** 2
        moving = Movement(step[:2], float(step[2]), float(step[3]))
        movement = Movement(movement.shift + moving.shift, movement.scale + moving.scale, movement.turn + moving.turn)
        if movement.farthest_px(height, width) > 2 * most_px:
            return _NONE
        if moving.farthest_px(height, width) < _SETTLED_PX:
            break
    return movement


def _edge_difference(movement: Movement, frame: Float[Array, "h w"], plate: Float[Array, "h w"]) -> float:
    """Return the median difference at edges, after removing the exposure."""
    moved = _moved(_spline(plate), movement)
    chosen = _edges(*_slopes(moved))
    if len(chosen) < 50:
        return 0.0
    apart = (frame - moved).ravel()[chosen]
    return float(np.median(np.abs(apart - np.median(apart))))
