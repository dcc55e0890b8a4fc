"""The protocol of matting, the default method, and common steps."""

from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from hfb.errors import InputError
from hfb.matting.alignment import aligned_plate
from hfb.matting.camera_noise import exposure_gain
from hfb.matting.known_background import gather_evidence, main_change, solve_matte
from hfb.typing import Array, Bool, Float, Tensor

Picture = Float[Tensor, "H W 3"] | Float[Array, "H W 3"]
Plate = Float[Tensor, "h w 3"] | Float[Array, "h w 3"]  # another size is the user's mistake, reported in one sentence

_DETECTION_PX = 480
_SOLUTION_PX = 640
_SEEN = 8.0  # in hundredths of alpha: pixels that certainly belong to a person
LEAST_SHARE = 2e-4
"""Smallest share of the image's area that is a person."""
MOST_SHARE = 0.75
"""Share of the image's area; where more changed the plate is another one."""


@runtime_checkable
class Matting(Protocol):
    """Estimates alpha of eq. (1): the share of the exposure in which a pixel shows the person."""

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """Return the matte in [0, 1].

        Args:
            frame_linear: blurred frame, linear light.
            plate_linear: background plate, linear light, in the frame's size.

        Raises:
            InputError: frame and plate do not match, or no person is found.
        """
        ...


class KnownBackground:
    """Colour and texture against the plate (see known_background.py): offline, no network, about a second."""

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """Find the person at a small size, solve around them at up to 640 px, put the matte into the whole frame."""
        frame, plate = (np.clip(np.asarray(picture, np.float32), 0, None) for picture in (frame_linear, plate_linear))
        check_sizes(frame, plate)
        plate = aligned_plate(frame, plate)
        small_frame, small_plate = shrink(frame, _DETECTION_PX), shrink(plate, _DETECTION_PX)
        gain = exposure_gain(small_frame, small_plate)
        found = gather_evidence(small_frame, np.clip(small_plate * gain, 0, 1))
        if found.body.mean() < LEAST_SHARE:
            raise nobody_found()
        if (found.change > 6).mean() > MOST_SHARE:
            raise another_scene()
        height, width = frame.shape[:2]
        scale = np.array([height, width]) / found.body.shape
        top, left, bottom, right = scaled_box(
            matte_region(found.body.astype(np.float32), margin=0.3), scale, height, width
        )
        inner = (slice(top, bottom), slice(left, right))
        near_frame = shrink(frame[inner], _SOLUTION_PX)
        near_plate = np.clip(shrink(plate[inner], _SOLUTION_PX) * gain, 0, 1)
        empty = _empty_around(found.body, scale, inner, near_frame.shape[:2])
        alpha = clean(solve_matte(gather_evidence(near_frame, near_plate, empty)))
        matte = np.zeros((height, width), np.float32)
        size = (right - left, bottom - top)
        matte[inner] = cv2.resize(alpha, size, interpolation=cv2.INTER_LINEAR)
        if matte.sum() < LEAST_SHARE * matte.size:
            raise nobody_found()
        return matte


def check_sizes(frame: Float[Array, "..."], plate: Float[Array, "..."]) -> None:
    """Check that the plate has the frame's size.

    Args:
        frame: (H, W, ...).
        plate: (H, W, ...).

    Raises:
        InputError: it has another one.
    """
    if frame.shape != plate.shape:
        (h, w), (ph, pw) = frame.shape[:2], plate.shape[:2]
        raise InputError(
            f"the frame has {w} x {h} pixels and the background plate {pw} x {ph}; "
            "give a plate from the same camera in the same size."
        )


def matte_region(matte: Float[Array, "H W"], margin: float = 0.1, threshold: float = 0.1) -> tuple[int, int, int, int]:
    """Return (top, left, bottom, right) of the box around the matte, ends exclusive, inside the image.

    Args:
        matte: alpha in [0, 1].
        margin: added on each side, as a share of the box's longer side.
        threshold: alpha above which a pixel counts.

    Raises:
        InputError: nothing is above the threshold.
    """
    rows, columns = np.flatnonzero((matte > threshold).any(1)), np.flatnonzero((matte > threshold).any(0))
    if not rows.size:
        raise nobody_found()
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    extra = round(margin * max(bottom - top, right - left))
    height, width = matte.shape
    return (
        max(0, int(top) - extra),
        max(0, int(left) - extra),
        min(height, int(bottom) + extra),
        min(width, int(right) + extra),
    )


def clean(alpha: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Remove specks and haze apart from the body, and values below 0.02.

    Args:
        alpha: matte in [0, 1].
    """
    keep = main_change(100 * alpha, threshold=_SEEN)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(keep.astype(np.uint8))
    if count > 2:
        largest = 1 + int(boxes[1:, cv2.CC_STAT_AREA].argmax())
        clear = np.unique(labels[keep & (alpha > 0.6)])  # a shoe cut off by dark trousers, not a patch of shade
        keep = np.isin(labels, [*clear, largest])
    # As far again as the faint end of a ramp over a tenth of the image reaches below what counts as seen.
    reach = 2 * max(1, round(0.02 * max(alpha.shape))) + 1
    near = cv2.dilate(keep.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    alpha = np.clip(alpha, 0, 1) * cv2.blur(near.astype(np.float32), (3, 3))
    return np.where(alpha < 0.02, 0, alpha).astype(np.float32)


def shrink(picture: Float[Array, "H W *c"], longer_px: int) -> Float[Array, "h w *c"]:
    """Reduce an image by area averaging to at most `longer_px` on the longer side; smaller images stay.

    Args:
        picture: image in any light.
        longer_px: largest length of the longer side [px].
    """
    height, width = picture.shape[:2]
    scale = longer_px / max(height, width)
    if scale >= 1:
        return np.asarray(picture, np.float32)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA)


def another_scene() -> InputError:
    """Build the error for a frame that differs from its plate nearly everywhere."""
    return InputError(
        "the frame differs from the background plate nearly everywhere; "
        "check that the plate is of the same scene, camera position and exposure."
    )


def nobody_found() -> InputError:
    """Build the error for a frame that equals its plate but for noise."""
    return InputError(
        "no person was found: the frame does not differ from the background plate; "
        "give a plate without the person, and a frame with them."
    )


def scaled_box(
    box: tuple[int, int, int, int], scale: Float[Array, "2"], height: int, width: int
) -> tuple[int, int, int, int]:
    """Return a box of a reduced image, (top, left, bottom, right), in the full image.

    Args:
        box: (top, left, bottom, right) in the reduced image [px].
        scale: scale of full to reduced size, down and across.
        height: height of the full image [px].
        width: width of the full image [px].
    """
    top, left, bottom, right = box
    return (
        int(top * scale[0]),
        int(left * scale[1]),
        min(height, int(np.ceil(bottom * scale[0]))),
        min(width, int(np.ceil(right * scale[1]))),
    )


def _empty_around(
    body: Bool[Array, "h w"],
    scale: Float[Array, "2"],
    inner: tuple[slice, slice],
    size: tuple[int, int],
) -> Bool[Array, "a b"]:
    """Return the detection's empty pixels, cropped and scaled to the solution's grid."""
    away = cv2.distanceTransform(1 - body.astype(np.uint8), cv2.DIST_L2, 3) > 0.03 * max(body.shape)
    indices = [
        ((cut.start + (np.arange(count) + 0.5) * (cut.stop - cut.start) / count) / ratio).astype(int).clip(0, limit - 1)
        for cut, count, ratio, limit in zip(inner, size, scale, body.shape, strict=True)
    ]
    return away[np.ix_(*indices)]
