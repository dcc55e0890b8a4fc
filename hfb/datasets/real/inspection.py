"""Checks of a video: a static camera, and measured joints that match the person in place and time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from hfb.datasets.real.markers import body_columns
from hfb.datasets.real.source_videos import Footage
from hfb.datasets.real.video_assets import Recording, changed
from hfb.errors import InputError
from hfb.typing import Array, Float

MOST_SHIFT = 4
"""Largest shift of joints and images [frames] that is corrected."""

_LOOK_PX = 240
_LOOK_FRAMES = 240
_LOOKS = 7
_LEAST_KEPT = 0.5  # of the edges; static footage keeps 0.8 to 1
_ON_PERSON = 0.4  # least share of the joints that must fall on something that moved
_LIMB_PX = 4.0  # half a limb's width at this size: deeper inside counts no more
_LIMBS = ((4, 7), (5, 8), (18, 20), (19, 21))  # shanks and forearms, as SMPL joints: thin and fast
_ALONG = (0.4, 0.6, 0.8, 1.0)
_CLEARLY_BETTER = 1.05


@dataclass(frozen=True)
class Inspection:
    """Result of `inspect`.

    Attributes:
        recording: with the up axis of its joints settled.
        depths: for each shift of the joints by -MOST_SHIFT .. MOST_SHIFT frames, how deep inside what moved the
            limbs lie, summed over frames and weighted by their speed in the image; zeros without joints.
    """

    recording: Recording
    depths: Float[Array, "9"]


def inspect(recording: Recording, footage: Footage) -> Inspection:
    """Check the beginning of a video, a few seconds at most.

    Args:
        recording: the video with its plate, camera and joints.
        footage: the video's footage.

    Raises:
        InputError: the camera moves, or the joints do not lie on the person.
    """
    last = min(footage.count, _LOOK_FRAMES)
    chosen = sorted({int(index) for index in np.linspace(0, last - 1, _LOOKS).round()})
    wanted = set(range(last)) if recording.joints else set(chosen)
    looks: dict[int, Float[Array, "h w 3"]] = {}
    scale = 1.0
    for index, frame in enumerate(footage.stored_frames(0, last)):
        if index in wanted:
            scale = min(1.0, _LOOK_PX / max(frame.shape[:2]))
            looks[index] = _small(frame, scale)
    few = {index: looks[index] for index in chosen}
    empty = _small(recording.stored_plate(), scale) if recording.plate else np.median([*few.values()], axis=0)
    empty = empty.astype(np.float32)
    if camera_moves([*few.values()], empty):
        raise InputError(f"{footage.path}: the camera moves or the plate shows another view; give static footage.")
    if recording.joints is None:
        return Inspection(recording, np.zeros(2 * MOST_SHIFT + 1))
    options = [recording]
    if recording.joints.suffix.lower() == ".trc":
        options.append(replace(recording, y_up=True))
    shares = [_share_on_person(option, few, empty, scale) for option in options]
    if max(shares) < _ON_PERSON:
        raise InputError(
            f"{recording.joints}: only {100 * max(shares):.0f} % of its joints fall on the person in "
            f"{footage.path.name}; check that joints, calibration and first frame belong to this video."
        )
    settled = options[int(np.argmax(shares))]
    return Inspection(settled, _depths(settled, looks, empty, scale))


def joint_shift(inspections: Sequence[Inspection]) -> int:
    """Estimate by how many frames the rows of the joints are early (negative) or late.

    Rows that are numbered from another frame than the video's are off by a frame or two, which at 60 frames per second
    is some centimetres at the hands. The shift with which the limbs are deepest inside the moving region is used where
    it is clearly better than none.

    Args:
        inspections: inspections of the videos that share the joints.
    """
    total = np.sum([inspection.depths for inspection in inspections], axis=0)
    if not inspections or not total.any():
        return 0
    best = int(np.argmax(total)) - MOST_SHIFT
    # At the end of the range it is no peak: something else is wrong, or nothing moves.
    clear = abs(best) < MOST_SHIFT and total.max() > _CLEARLY_BETTER * total[MOST_SHIFT]
    return best if clear else 0


def camera_moves(looks: Sequence[Float[Array, "h w 3"]], empty: Float[Array, "h w 3"]) -> bool:
    """Return whether most edges of most frames are elsewhere in the plate; a person covers fewer.

    Args:
        looks: reduced frames, sRGB.
        empty: reduced plate, sRGB.
    """
    gray_empty = empty.mean(-1)
    kept = []
    for look in looks:
        gray = look.mean(-1)
        slope = np.hypot(cv2.Sobel(gray, -1, 1, 0), cv2.Sobel(gray, -1, 0, 1)) / 8  # per pixel
        edges = slope >= max(0.02, float(np.quantile(slope, 0.85)))
        difference = gray - gray_empty
        difference = difference - np.median(difference)
        if edges.sum() >= 50:
            kept.append(float((np.abs(difference) < 0.5 * slope + 0.02)[edges].mean()))
    return bool(kept) and float(np.median(kept)) < _LEAST_KEPT


def _share_on_person(
    recording: Recording, looks: dict[int, Float[Array, "h w 3"]], empty: Float[Array, "h w 3"], scale: float
) -> float:
    """Share of the known joints that fall on something that differs from the plate."""
    camera, markers = recording.camera(), recording.markers()
    if camera is None or markers is None:
        return 0.0
    columns, _ = body_columns(markers.names)
    hits, known = 0.0, 0
    for index, look in looks.items():
        points = markers.rows(recording.row_of(index), 1)[0, columns]
        moved = cv2.dilate(changed(look, empty).astype(np.float32), np.ones((7, 7), np.uint8))
        hits += float(_at(moved, camera.to_stored_pixels(points) * scale).sum())
        known += int(np.isfinite(points).all(1).sum())
    return hits / known if known else 0.0


def _depths(
    recording: Recording, looks: dict[int, Float[Array, "h w 3"]], empty: Float[Array, "h w 3"], scale: float
) -> Float[Array, "9"]:
    """See `Inspection.depths`; `looks` are all frames from the first on."""
    camera, markers = recording.camera(), recording.markers()
    total = np.zeros(2 * MOST_SHIFT + 1)
    if camera is None or markers is None:
        return total
    column_of = dict(zip(*body_columns(markers.names)[::-1], strict=True))
    rows = markers.rows(recording.row_of(0) - MOST_SHIFT, len(looks) + 2 * MOST_SHIFT)
    limbs = [(column_of[a], column_of[b]) for a, b in _LIMBS if a in column_of and b in column_of]
    points = np.stack([(1 - t) * rows[:, a] + t * rows[:, b] for a, b in limbs for t in _ALONG], 1) if limbs else None
    if points is None:
        return total
    pixels = np.stack([camera.to_stored_pixels(row) for row in points]) * scale
    speed = np.nan_to_num(np.linalg.norm(np.gradient(pixels, axis=0), axis=-1))
    for index, look in looks.items():
        near = slice(index, index + 2 * MOST_SHIFT + 1)
        if not np.isfinite(pixels[near]).all():
            continue  # every shift is judged by the same frames
        depth = cv2.distanceTransform(changed(look, empty).astype(np.uint8), cv2.DIST_L2, 5)
        depth = np.minimum(depth, _LIMB_PX).astype(np.float32)
        total += [
            float((_at(depth, row) * weight).sum() / max(weight.sum(), 1e-6)) * float(speed[index + MOST_SHIFT].mean())
            for row, weight in zip(pixels[near], speed[near], strict=True)
        ]
    return total


def _at(values: Float[Array, "h w"], pixels: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Return the values at pixels (x, y); 0 outside and where unknown."""
    x, y = np.floor(np.nan_to_num(pixels, nan=-1.0).clip(-1, 1e6)).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < values.shape[1]) & (y < values.shape[0])
    found = np.zeros(len(pixels), values.dtype)
    found[inside] = values[y[inside], x[inside]]
    return found


def _small(picture: Float[Array, "H W 3"], scale: float) -> Float[Array, "h w 3"]:
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
