"""Check of a plate's alignment and exposure against the frame's background, after both are corrected.

A plate that is shifted farther than alignment.py corrects turns every edge into a person's outline; an exposure that
camera_noise.py does not correct turns the whole room into a person. Both are detected and reported before matting.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from hfb.matting.alignment import MOST_PX, Movement, find_movement, moved_plate
from hfb.matting.camera_noise import GAINS, exposure_gain
from hfb.matting.exposure_match import Gain
from hfb.matting.matting_protocol import clean, shrink
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Bool, Float

_ALIGNED_AT_PX, _JUDGED_AT_PX, _LOOKED_AT_PX = 640, 320, 128
_FOUND_PX = 9 * MOST_PX
"""Stabilisers move a crop so far; an edge farther off is no longer found near its own."""
_FOUND_GAINS = (0.2, 5.0)
"""Range of gains, wider than the matting's correction, so that the reported problem is certain."""
_AWAY_PX = 17
_LEAST_EMPTY = 0.1
_EDGE_SHARE, _LEAST_EDGE, _FEWEST_EDGES = 0.15, 0.02, 50
_MOST_OFF = 0.12
"""Share of the plate's edges that the frame may lack: at most 0.05 where both belong together (real clips, composites
over photographs with noise, gain, shadow, JPEG and small shifts), 0.24 and more where no movement is found."""
_MOST_GAIN = 0.05
"""Logarithm of the exposure that is left over; nothing where both belong together, 0.18 at a gain of 1.5."""


def find_plate_mismatch(frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> str | None:
    """Return what is wrong between a frame and its plate, one sentence; None where they belong together.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], in the frame's size.
    """
    frame, plate = (shrink(picture, _ALIGNED_AT_PX) for picture in (frame_linear, plate_linear))
    movement = find_movement(frame, plate, _FOUND_PX)
    apart_px = 0.0
    if movement is not None:
        apart_px = _beyond(movement, frame_linear)
        plate = moved_plate(plate, movement)
    frame, plate = (np.clip(shrink(picture, _JUDGED_AT_PX), 0, 1) for picture in (frame, plate))
    gain, off = exposure_gain(frame, plate, _FOUND_GAINS), 0.0
    empty = _where_nobody_is(frame, np.clip(plate * gain, 0, 1))
    if empty.mean() > _LEAST_EMPTY:
        gain = exposure_gain(frame[empty][None], plate[empty][None], _FOUND_GAINS)
        off = _edges_off(frame, np.clip(plate * gain, 0, 1), empty)
    left_over = float(np.abs(np.log(gain / np.clip(gain, *GAINS))).max())
    wrong, mend = [], []
    if apart_px or off > _MOST_OFF:
        wrong.append("do not lie on each other" + (f" (about {apart_px:.0f} px apart)" if apart_px else ""))
        mend.append("register the plate to the frame")
    if left_over > _MOST_GAIN:
        wrong.append(f"differ in exposure (by a factor of about {float(np.exp(np.log(gain).mean())):.2g})")
        mend.append("bring both to one exposure")
    if not wrong:
        return None
    return (
        f"the background plate and the frame {' and '.join(wrong)}, so that the matte will hold parts of the room: "
        f"{' and '.join(mend)}, or give a plate of the same clip, camera position and exposure (--background)"
    )


def plate_distance_px(frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> float:
    """Return how far a frame lies beside its plate [px]; 0 where the matting corrects it, or no movement is found.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], in the frame's size.
    """
    frame, plate = (shrink(picture, _ALIGNED_AT_PX) for picture in (frame_linear, plate_linear))
    movement = find_movement(frame, plate, _FOUND_PX)
    return 0.0 if movement is None else _beyond(movement, frame_linear)


def tell_distances(distances_px: Sequence[float]) -> str | None:
    """Return a sentence where some frames lie beside the plate; None where none does.

    Args:
        distances_px: of some frames, by `plate_distance_px`.
    """
    if not any(distances_px):
        return None
    return (
        f"the camera, or the crop of its stabiliser, moves against the plate (by about {max(distances_px):.0f} px), so "
        "that mattes will hold parts of the room and the motion holds the crop's: film with stabilisation switched "
        "off, or register the frames to the plate"
    )


def _beyond(movement: Movement, frame_linear: Float[Array, "H W 3"]) -> float:
    """Return a movement in the frame's own pixels; 0 where alignment.py corrects it."""
    longer = max(frame_linear.shape[:2])
    scale = min(1.0, _ALIGNED_AT_PX / longer)
    farthest_px = movement.farthest_px(round(scale * frame_linear.shape[0]), round(scale * frame_linear.shape[1]))
    return farthest_px / scale if farthest_px > MOST_PX else 0.0


def tell_exposures(gains: Sequence[Gain]) -> str | None:
    """What a user should know of exposures that were evened out; None where one is close to the plate's.

    Args:
        gains: of all frames over the plate.
    """
    apart = [float(np.abs(np.log(np.array(gain) / np.clip(gain, *GAINS))).max()) for gain in gains]
    if not gains or min(apart) <= _MOST_GAIN:
        return None
    factor = float(np.exp(np.log(gains[int(np.argmin(apart))]).mean()))
    return (
        f"the background plate and the frame differ in exposure (by a factor of about {factor:.2g}): this is evened "
        "out, but what is too bright or too dark in one of them is lost: bring both to one exposure, or give a plate "
        "of the same clip, camera position and exposure (--background)"
    )


def _where_nobody_is(frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]) -> Bool[Array, "H W"]:
    """Return pixels well outside of the first network's matte, not at the border, where a moved plate is extended."""
    from hfb.matting.network import NetworkMatting  # imports torch, which is needed only here

    matte = clean(NetworkMatting().look(shrink(frame, _LOOKED_AT_PX), shrink(plate, _LOOKED_AT_PX)))
    matte = cv2.resize(matte, frame.shape[1::-1])
    empty = cv2.dilate(matte, np.ones((_AWAY_PX, _AWAY_PX), np.uint8)) < 0.02
    rim = max(1, round(_FOUND_PX * max(empty.shape) / _ALIGNED_AT_PX))
    empty[:rim] = empty[-rim:] = empty[:, :rim] = empty[:, -rim:] = False
    return empty


def _edges_off(frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"], empty: Bool[Array, "H W"]) -> float:
    """Share of the plate's steepest edges that the frame does not have in the same place; 0 without edges."""
    seen, there = (
        cv2.GaussianBlur(linear_to_srgb(picture).mean(-1).astype(np.float32), (0, 0), 0.8) for picture in (frame, plate)
    )
    slope = np.hypot(cv2.Sobel(there, -1, 1, 0), cv2.Sobel(there, -1, 0, 1)) / 8
    steep = empty & (slope >= max(_LEAST_EDGE, float(np.quantile(slope[empty], 1 - _EDGE_SHARE))))
    if steep.sum() < _FEWEST_EDGES:
        return 0.0
    apart = seen - there
    apart -= np.median(apart[empty])
    return float((np.abs(apart) > 0.5 * slope + 0.02)[steep].mean())
