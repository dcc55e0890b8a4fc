"""The clean background of footage: an image of the empty scene or one made from the footage, and its checks."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from hfb.errors import InputError
from hfb.io.media.footage import Footage
from hfb.io.media.images.image_decoding import decode_picture, doubt_depths
from hfb.io.media.plate_colours import COMPARED_FRAMES, in_colours_of
from hfb.io.media.video.video_pixels import square_size, stretched
from hfb.typing import Array, Bool, Float, Shaped

OnProgress = Callable[[int, int], None]

HOLDS_PERSON = (
    "the background still holds the person: somebody stands in it where the frames show the empty scene; give a plate "
    "of the empty scene"
)

_MOST_FRAMES, _FEWEST_FRAMES = 41, 3
_MEMORY_BYTES, _BAND = 256 << 20, 32
_LOOK_PX, _LOOKS = 160, 15
_STILL_SHARE, _SHORTEST_STILL, _MOST_SPANS = 5e-4, 5, 5
_LEAST_CHANGE = 0.06
_MOST_CHANGED = 0.6
_LEAST_EDGES_KEPT = 0.5
_GHOST_RATE, _GHOST_SHARE, _CLEARLY = 0.3, 0.25, 1.5
_CONSTANT, _CONSTANT_SHARE = 0.05, 0.6
_SURE_FROM = _LOOKS
"""Frames from which an image of the user's is refused: before bricks or stripes a plainly dressed figure that has
hardly moved looks like a ghost (49 of 240 such empty plates over two frames, 20 over eight, 7 over fifteen)."""


def find_plate(
    footage: Footage, how: Path | Literal["median", "still"], on_progress: OnProgress | None = None
) -> tuple[Float[Array, "H W 3"], str]:
    """Return the background as the footage stores images, in [0, 1], and a sentence on its source.

    Args:
        footage: the clip's footage.
        how: an image's file; ``median``: each pixel's median over frames spread over the footage; ``still``: that of
            the longest stretch without movement and without a person.
        on_progress: called with (frames looked at, of how many).

    Raises:
        InputError: the image cannot be read, nothing is ever still, or see `check_plate`.
    """
    if isinstance(how, Path):
        picture = decode_picture(how, footage.stored)
        stored = _in_square_pixels(picture.pixels, footage)
        _check_size(stored, footage)
        plate, remark = _in_colours_of(footage.developed(stored), footage)
        doubts = doubt_depths([(how, picture.seems_bits)], footage.stored)
        told = "; ".join((f"background: {how.name}", *picture.remarks, *doubts, *([remark] if remark else [])))
        if footage.count < _SURE_FROM:
            doubt = check_plate(plate, footage, sure=False)
            return plate, f"{told}; {doubt}" if doubt else told
    elif how == "median":
        chosen = _spread_over(footage.count, _count_in_memory(footage))
        plate = _median(footage, chosen, on_progress)
        told = f"background: the median of {len(chosen)} frames"
    else:
        return _best_still(footage, on_progress)
    check_plate(plate, footage)
    return plate, told


def _in_colours_of(plate: Float[Array, "H W 3"], footage: Footage) -> tuple[Float[Array, "H W 3"], str | None]:
    """Return a plate from an image in the colours of a video, and a remark where it was converted."""
    if footage.index is None or footage.stored != "srgb" or plate.shape[:2] != (footage.height, footage.width):
        return plate, None
    return in_colours_of(plate, list(footage.chosen(_spread_over(footage.count, COMPARED_FRAMES).tolist())))


def _in_square_pixels(stored: Float[Array, "h w 3"], footage: Footage) -> Float[Array, "H W 3"]:
    """Stretch an image from a video of non-square pixels like its frames; it may be turned already."""
    height, width = stored.shape[:2]
    aspect = footage.index.aspect if footage.index else 1.0
    if aspect != 1 and (footage.height, footage.width) in (
        square_size(height, width, aspect),
        square_size(height, width, 1 / aspect),
    ):
        return stretched(stored, footage.height, footage.width).clip(0, 1)
    return stored


def _best_still(footage: Footage, on_progress: OnProgress | None) -> tuple[Float[Array, "H W 3"], str]:
    """Return the longest still stretch that shows the empty scene: a person may stand still in the longest of all."""
    refused: InputError | None = None
    for first, last in _still_spans(footage, on_progress)[:_MOST_SPANS]:
        plate = _median(footage, first + _spread_over(last + 1 - first, _count_in_memory(footage)), None)
        try:
            check_plate(plate, footage)
        except InputError as error:
            refused = refused or error
        else:
            return plate, f"background: frames {first} to {last}, in which nothing moves"
    assert refused is not None
    raise refused


def check_plate(plate: Float[Array, "h w 3"], footage: Footage, sure: bool = True) -> str | None:
    """Check that a plate belongs to the footage, and that the scene is empty in it.

    Args:
        plate: encoded like the frames.
        footage: the clip's footage.
        sure: refuse it where it seems to hold a person; else that is returned as a doubt.

    Raises:
        InputError: another size, another camera or another light, or it holds a person who is elsewhere in the frames.
    """
    _check_size(plate, footage)
    empty = _small(plate)
    looks = np.stack([_small(one) for one in footage.chosen(_spread_over(footage.count, _LOOKS).tolist())])
    changed = changed_pixels(looks, empty)
    if float(np.median(changed.mean((1, 2)))) > _MOST_CHANGED or _edges_kept(looks, empty) < _LEAST_EDGES_KEPT:
        raise InputError(
            f"{footage.source.name} differs from its background plate nearly everywhere: give a plate of the same "
            "scene and light from the same camera, which must stand still."
        )
    if not _holds_person(looks, empty, changed):
        return None
    if sure:
        raise InputError(f"{HOLDS_PERSON}, or another time range of the video.")
    return f"it seems that {HOLDS_PERSON}"


def seems_to_hold_person(frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]) -> bool:
    """Return whether a plate seems to hold a person, judged by one frame: only for a warning.

    One frame cannot show that an area always differs in the same way. Of 80 plates with somebody beside the person 56
    were recognised; of 200 empty ones none was mistaken, of 400 behind a smeared figure (bricks, stripes, noise) four.

    Args:
        frame: sRGB.
        plate: sRGB.
    """
    empty, looks = _small(plate), _small(frame)[None]
    return _holds_person(looks, empty, changed_pixels(looks, empty), least=1)


def _check_size(plate: Float[Array, "h w 3"], footage: Footage) -> None:
    if plate.shape[:2] != (footage.height, footage.width):
        raise InputError(
            f"the frames have {footage.width} x {footage.height} pixels and the background plate {plate.shape[1]} x "
            f"{plate.shape[0]}; give a plate from the same camera in the same size."
        )


def changed_pixels(looks: Float[Array, "n h w 3"], empty: Float[Array, "h w 3"]) -> Bool[Array, "n h w"]:
    """Return where reduced frames clearly differ from the reduced plate.

    Args:
        looks: reduced frames.
        empty: reduced plate.
    """
    difference = np.abs(looks - empty).max(-1)
    usual = np.median(difference, axis=(1, 2), keepdims=True)
    smooth = np.stack([cv2.blur(one, (3, 3)) for one in difference.astype(np.float32)])
    return smooth > np.maximum(_LEAST_CHANGE, 3 * usual)


def _holds_person(
    looks: Float[Array, "n h w 3"], empty: Float[Array, "h w 3"], changed: Bool[Array, "n h w"], least: int = 2
) -> bool:
    """Return whether a ghost of a person's size is found: it always differs in the same way, its edge is in the plate.

    Where a plate holds a person, frames show the constant background, without an edge along the person's outline; where
    a person stands in the frames, it is the frames that have the edge.

    Args:
        looks: reduced frames.
        empty: reduced plate.
        changed: by `changed_pixels`.
        least: fewest frames that have to show it.
    """
    ghost = _constant(looks, changed, max(least, _GHOST_RATE * len(looks)))
    person = float(np.median([size for size in map(_largest_area, changed) if size] or [0]))
    number, labels = cv2.connectedComponents(ghost)
    for label in range(1, number):
        area = labels == label
        shown = [look for look, one in zip(looks, changed, strict=True) if one[area].mean() > 0.6]
        if not person or area.sum() < _GHOST_SHARE * person or len(shown) < least:
            continue
        grown, shrunk = (how(area.astype(np.uint8), np.ones((3, 3), np.uint8)) for how in (cv2.dilate, cv2.erode))
        outline = (grown > 0) & (shrunk == 0)
        in_plate, in_frames = (_slope(one.mean(-1))[outline].mean() for one in (empty, np.median(shown, axis=0)))
        if in_plate > _CLEARLY * in_frames:
            return True
    return False


def constant_changes(looks: Float[Array, "n h w 3"], empty: Float[Array, "h w 3"], share: float) -> Bool[Array, "h w"]:
    """Return where reduced frames always differ from the reduced plate in the same way.

    Args:
        looks: reduced frames.
        empty: reduced plate.
        share: least share of the frames.
    """
    return _constant(looks, changed_pixels(looks, empty), share * len(looks)).astype(bool)


def _constant(looks: Float[Array, "n h w 3"], changed: Bool[Array, "n h w"], least: float) -> Shaped[Array, "h w"]:
    """Return 1 where enough frames differ, most of them in the same way, except specks; 0 elsewhere."""
    count = changed.sum(0)
    often = count >= least
    usual = np.nanmedian(np.where((changed & often)[..., None], looks, np.where(often, np.nan, 0)[..., None]), axis=0)
    same = changed & (np.abs(looks - usual).max(-1) < _CONSTANT)
    constant = (often & (same.sum(0) >= _CONSTANT_SHARE * count)).astype(np.uint8)
    return cv2.morphologyEx(constant, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))


def _largest_area(mask: Bool[Array, "h w"]) -> int:
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))


def _slope(gray: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Return an image's gradient magnitude [per pixel]."""
    gray = np.asarray(gray, np.float32)
    return np.hypot(cv2.Sobel(gray, -1, 1, 0), cv2.Sobel(gray, -1, 0, 1)) / 8


def _edges_kept(looks: Float[Array, "n h w 3"], empty: Float[Array, "h w 3"]) -> float:
    """Share of the plate's edges that most looks have in the same place; 1 for a plate without edges."""
    gray = empty.mean(-1)
    slope = _slope(gray)
    edges = slope >= max(0.02, float(np.quantile(slope, 0.85)))
    if edges.sum() < 50:
        return 1.0
    apart = looks.mean(-1) - gray
    apart = apart - np.median(apart, axis=(1, 2), keepdims=True)
    return float(np.median([(np.abs(one) < 0.5 * slope + 0.02)[edges].mean() for one in apart]))


def _small(picture: Float[Array, "H W 3"]) -> Float[Array, "h w 3"]:
    scale = min(1.0, _LOOK_PX / max(picture.shape[:2]))
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    return np.asarray(cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _count_in_memory(footage: Footage) -> int:
    """Return how many frames a median may hold at once."""
    frame_bytes = footage.height * footage.width * 3 * (footage.bits // 8)
    return int(np.clip(_MEMORY_BYTES // frame_bytes, _FEWEST_FRAMES, _MOST_FRAMES))


def _spread_over(count: int, most: int) -> Array:
    """Return an odd number of frames (the median is then one of the values), evenly spread; both of only two."""
    wanted = min(most, count)
    wanted -= 1 - wanted % 2 if wanted > 2 else 0
    return np.unique(np.linspace(0, count - 1, wanted).round().astype(np.int64))


def _median(footage: Footage, chosen: Array, on_progress: OnProgress | None) -> Float[Array, "H W 3"]:
    full, kind = (255, np.uint8) if footage.bits == 8 else (65535, np.uint16)
    stack: list[Shaped[Array, "H W 3"]] = []
    for frame in footage.chosen(chosen.tolist()):
        stack.append(np.round(frame * full).astype(kind))
        if on_progress:
            on_progress(len(stack), len(chosen))
    low, high = (len(stack) - 1) // 2, len(stack) // 2
    plate = np.empty((footage.height, footage.width, 3), np.float32)
    for top in range(0, footage.height, _BAND):
        band = slice(top, top + _BAND)
        # Sorted as 16 bits along the last axis: many times faster than a median across images of 8 bits.
        levels = np.sort(np.stack([one[band] for one in stack], -1).astype(np.uint16), axis=-1)
        plate[band] = (levels[..., low].astype(np.float32) + levels[..., high]) / (2 * full)
    return plate


def _still_spans(footage: Footage, on_progress: OnProgress | None) -> list[tuple[int, int]]:
    """Return (first, last) of every stretch in which no frame differs from its first one, the longest first."""
    spans: list[tuple[int, int]] = []
    first, reference = 0, None
    for number, frame in enumerate(footage.frames()):
        small = cv2.GaussianBlur(_small(frame), (0, 0), 1.0)
        if reference is None or _moved(small, reference):
            spans.append((first, number - 1))
            first, reference = number, small
        if on_progress:
            on_progress(number + 1, footage.count)
    spans.append((first, footage.count - 1))
    spans = [(first, last) for first, last in spans if last + 1 - first >= _SHORTEST_STILL]
    if not spans:
        raise InputError(
            f"{footage.source.name}: something moves all the time, so no still span can be the background; give a "
            "plate (--background PLATE) or --background median."
        )
    return sorted(spans, key=lambda span: (span[0] - span[1], span[0]))


def _moved(small: Float[Array, "h w 3"], reference: Float[Array, "h w 3"]) -> bool:
    difference = np.abs(small - reference).max(-1)
    return float((difference > max(0.03, 4 * float(np.median(difference)))).mean()) > _STILL_SHARE
