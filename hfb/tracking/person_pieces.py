"""Merging of a person's pieces where clothes look like the background; two people stay two.

A small image shows one area above another in both cases. Between the pieces of one person the matting network finds the
faint rest of a body, between two people nothing.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from hfb.matting.matting_protocol import shrink
from hfb.photometry import srgb_to_linear
from hfb.typing import Array, Float

Person = tuple[float, ...]
"""left, top, right, bottom [px], area [px]."""
Alpha = Callable[[Float[Array, "h w 3"], Float[Array, "h w 3"]], Float[Array, "h w"]]
"""The person's share of each pixel, from a frame and its plate, both linear."""

_LOOK_PX = 256
_AROUND = 0.15
_LEAST_ABOVE_EACH_OTHER = 0.5
"""Share of the narrower piece's width that lies above or below the other piece."""
_WIDEST_GAP = 0.35
"""Rows between two pieces, of the height of both together: more is no waist, nor a thigh."""
_LEAST_BRIDGE = 0.04
"""Width of what the network sees in every row between two pieces, of the narrower piece's width: at most 0.016 between
two people and above a reflection, 0.05 to 0.7 across hips that hardly differ from a hedge."""
_FAINT = 0.1
_SMALLEST_PIECE = 0.06
"""Share of the larger piece's area: a smaller piece does not change the box."""


def join_pieces(
    pieces: Sequence[Person], frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"], alpha: Alpha
) -> list[Person]:
    """Merge the areas of one frame that belong to one person; the largest first.

    Args:
        pieces: boxes with their areas.
        frame: encoded as sRGB, in full size.
        plate: encoded as sRGB, in full size.
        alpha: matting function, called only where two areas might be one person's.
    """
    joined = sorted(pieces, key=lambda one: -one[4])
    index = 0
    while index < len(joined):
        one = joined[index]
        mate = next(
            (
                other
                for other in joined[index + 1 :]
                if _might_be_one(one, other) and _bridged(one, other, frame, plate, alpha)
            ),
            None,
        )
        if mate is None:
            index += 1
            continue
        joined.remove(mate)
        joined[index] = _together(one, mate)
    return sorted(joined, key=lambda one: -one[4])


def matting_look(frame_linear: Float[Array, "h w 3"], plate_linear: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    """Return the shipped matting network's alpha at the images' own size.

    Args:
        frame_linear: linear light.
        plate_linear: linear light.
    """
    from hfb.matting.network import NetworkMatting  # imports torch, which is needed only here

    return NetworkMatting().look(frame_linear, plate_linear)


def _might_be_one(one: Person, other: Person) -> bool:
    """Return whether two areas are above each other, and near enough."""
    shared = min(one[2], other[2]) - max(one[0], other[0])
    gap = max(one[1], other[1]) - min(one[3], other[3])
    height = max(one[3], other[3]) - min(one[1], other[1])
    narrower = min(one[2] - one[0], other[2] - other[0])
    return (
        shared >= _LEAST_ABOVE_EACH_OTHER * narrower
        and gap <= _WIDEST_GAP * height
        and other[4] >= _SMALLEST_PIECE * one[4]
    )


def _bridged(
    one: Person, other: Person, frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"], alpha: Alpha
) -> bool:
    """Return whether every row between the pieces holds a part of a body; overlapping boxes must be one area."""
    left, top, right, bottom, _ = _together(one, other)
    extra = _AROUND * max(right - left, bottom - top)
    height, width = frame.shape[:2]
    rows = slice(int(max(0, top - extra)), int(min(height, bottom + extra) + 0.5))
    columns = slice(int(max(0, left - extra)), int(min(width, right + extra) + 0.5))
    crops = (srgb_to_linear(np.ascontiguousarray(picture[rows, columns])) for picture in (frame, plate))
    seen = alpha(*(shrink(crop, _LOOK_PX) for crop in crops))
    scale = seen.shape[0] / (rows.stop - rows.start)
    upper, lower = sorted((one, other), key=lambda piece: piece[1] + piece[3])
    edges = sorted((upper[3], lower[1]))
    first = int(np.clip((edges[0] - rows.start) * scale, 0, len(seen) - 1))
    last = int(np.clip((edges[1] - rows.start) * scale, first, len(seen) - 1))
    inner = slice(int(max(0, (left - columns.start) * scale)), int((right - columns.start) * scale) + 1)
    if upper[3] > lower[1]:  # hands beside thighs, or two people slantwise: every row holds something
        _, labels = cv2.connectedComponents((seen[:, inner] > _FAINT).astype(np.uint8))
        most = [int(np.bincount(part[part > 0], minlength=1).argmax()) for part in (labels[:first], labels[last + 1 :])]
        return most[0] == most[1] > 0
    narrower_px = min(one[2] - one[0], other[2] - other[0]) * scale
    profile = seen[first : last + 1, inner].sum(1) / narrower_px
    return bool(profile.min() >= _LEAST_BRIDGE)


def _together(one: Person, other: Person) -> Person:
    return (
        min(one[0], other[0]),
        min(one[1], other[1]),
        max(one[2], other[2]),
        max(one[3], other[3]),
        one[4] + other[4],
    )
