"""A second pass over frames without the tracked person, by the matting network at full size.

A frame in another exposure than its plate differs everywhere, so that no person stands out in a small image. The
network therefore sees the surroundings of the person's last position, in the frame's own exposure. A person counts only
in full view, about as large as before and after, within reach, and nearer than any other person.
"""

from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np

from hfb.matting.camera_noise import exposure_gain
from hfb.matting.matting_protocol import shrink
from hfb.photometry import srgb_to_linear
from hfb.tracking.person_pieces import Alpha, matting_look
from hfb.tracking.tracks import Track, agreement
from hfb.typing import Array, Float

_LOOK_PX = 256
_SEEN = 0.5
_AROUND = 0.6
"""Margin of the search around a box, relative to its longer side."""
_FARTHEST = 0.4
"""Largest step of a person per frame, in their own height."""
_ABOUT_AS_HIGH, _ABOUT_AS_LARGE = (0.6, 1.5), (0.35, 1.8)
_IN_VIEW = 0.01
"""Share of a side of the frame: a person nearer to its edge may be cut off by it."""
_MISSES = 2
"""Number of frames in a row after the last detection that are searched."""


def look_into_gaps(
    track: Track,
    others: Sequence[Track],
    picture: Callable[[int], Float[Array, "H W 3"]],
    plate: Float[Array, "H W 3"],
    alpha: Alpha = matting_look,
    on_progress: Callable[[int], None] | None = None,
) -> Track:
    """Add the boxes of frames in which the person is in full view although tracking missed them.

    Args:
        track: track of the person.
        others: everybody else in the clip.
        picture: a frame by its number, encoded like the plate.
        plate: encoded as sRGB, in full size.
        alpha: the shipped matting network's by default.
        on_progress: called after every look with their number.
    """
    boxes, areas, looks = track.boxes.copy(), track.areas.copy(), 0
    for frames in (range(len(boxes)), reversed(range(len(boxes)))):
        last, misses = None, 0
        for frame in frames:
            if np.isfinite(boxes[frame]).all():
                last, misses = frame, 0
            elif last is not None and misses < _MISSES:
                seen = _in_full_view(picture(frame), plate, boxes[last], areas[last], abs(frame - last), alpha)
                mine = (one for one in seen if not _is_of(others, one[0], frame, last, boxes[last]))
                found = min(mine, key=lambda one: _way(one[0], boxes[last]), default=None)
                misses += 1
                looks += 1
                if found is not None:
                    (boxes[frame], areas[frame]), last, misses = found, frame, 0
                if on_progress:
                    on_progress(looks)
    return Track(track.name, boxes, areas)


def _in_full_view(
    frame: Float[Array, "H W 3"],
    plate: Float[Array, "H W 3"],
    known: Float[Array, "4"],
    area_px: float,
    away: int,
    alpha: Alpha,
) -> Iterator[tuple[Float[Array, "4"], float]]:
    """Yield boxes and areas [px] that may be the person's, who was at ``known`` ``away`` frames before or after."""
    height, width = frame.shape[:2]
    rows, columns = _around(known, away, height, width)
    look, empty = (shrink(srgb_to_linear(np.ascontiguousarray(one[rows, columns])), _LOOK_PX) for one in (frame, plate))
    seen = alpha(look, empty * exposure_gain(look, empty))
    scale = (rows.stop - rows.start) / seen.shape[0]
    edge, high = _IN_VIEW * max(height, width), known[3] - known[1]
    _, _, stats, _ = cv2.connectedComponentsWithStats((seen > _SEEN).astype(np.uint8))
    for x, y, w, h, count in stats[1:].tolist():
        box = np.array([columns.start, rows.start] * 2) + scale * np.array([x, y, x + w, y + h])
        area = scale**2 * count
        if (
            (box[:2] >= edge).all()
            and (box[2:] <= np.array([width, height]) - edge).all()
            and _ABOUT_AS_HIGH[0] <= scale * h / high <= _ABOUT_AS_HIGH[1]
            and _ABOUT_AS_LARGE[0] <= area / area_px <= _ABOUT_AS_LARGE[1]
            and _way(box, known) <= _FARTHEST * high * away
        ):
            yield box, area


def _is_of(others: Sequence[Track], box: Float[Array, "4"], frame: int, last: int, known: Float[Array, "4"]) -> bool:
    """Return whether another person is nearer, in this frame or when the person was last seen."""
    nearest = _way(box, known)
    for other in others:
        here = other.boxes[frame]
        if np.isfinite(here).all() and agreement(here, box) > 0:
            return True
        if np.isfinite(other.boxes[last]).all() and _way(box, other.boxes[last]) < nearest:
            return True
    return False


def _way(one: Float[Array, "4"], other: Float[Array, "4"]) -> float:
    """Return distance of two boxes' centres [px]."""
    return float(np.hypot(*((one[:2] + one[2:]) - (other[:2] + other[2:])))) / 2


def _around(box: Float[Array, "4"], away: int, height: int, width: int) -> tuple[slice, slice]:
    extra = max(box[2] - box[0], box[3] - box[1]) * (_AROUND + _FARTHEST * away)
    (left, right), (top, bottom) = (
        (int(np.clip(box[low] - extra, 0, side)), int(np.clip(np.ceil(box[low + 2] + extra), 0, side)))
        for low, side in ((0, width), (1, height))
    )
    return slice(top, bottom), slice(left, right)
