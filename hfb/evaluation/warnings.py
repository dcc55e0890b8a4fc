"""Checks of a finished result for signs of errors, each with a remedy.

Every check compares the images with the fit; none needs the truth. Bounds are well outside of the values of clean
recordings (tests/evaluation/test_warnings.py).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from hfb.config import Record
from hfb.fitting.front_choice import ANOTHER_FRONT_DEG
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.media.plate import constant_changes
from hfb.matting.matting_protocol import shrink
from hfb.motion.footing import floor_fault
from hfb.motion.limits import fastest_ends, fastest_hinges, fastest_turns
from hfb.motion.sampled import SampledMotion
from hfb.photometry import srgb_to_linear
from hfb.typing import Array, Bool, Float

LEAST_MATTE_IOU = 0.7
_SPIN_DEG, _SPIN_DEG_PER_S = 75.0, 600.0
"""Largest turn of the trunk between the middles of neighbouring frames. A pirouette has 700 degrees/s: 23 per frame at
30 fps."""
_TURN_M_S, _TURN_WITHIN_S = 1.2, 1 / 15
"""Slowest speed from which, and longest exposure within which, no limb turns around and is as fast again the other way.
Of windows of 1/15 s of recorded motions 0.1 % do (docs/experiments)."""
_END_M_S = 25.0
"""Feet reach about 22 m/s in instep kicks (Kellis and Katis, J. Sports Sci. Med. 6:154, 2007), CMU's recordings 12."""
_HINGE_DEG_PER_S = 2500.0
"""Elbows reach about 2,400 degrees/s in professional pitches (Fleisig et al., J. Biomech. 32:1371, 1999), CMU's
recordings 1,350."""
_MOST_LEFT_OVER = 0.08
"""Largest share of the matte's area in one piece that the fitted body does not touch."""
_LIGHT_PX = 48
_LIGHT_RATIO, _LIGHT_SRGB, _LIGHT_SHARE = 0.12, 0.03, 0.15
"""Logarithm and step of brightness in one place of the scene, and the share of the places that have it: at most 0.04 in
clean recordings, 0.26 and more with a third in light shade or an exposure that is longer by a quarter."""
_STATIC_LOOKS, _STATIC_SHARE, _STATIC_PX = 5, 0.8, 160
_LEAST_STATIC = 0.12
"""Share of the person's area: reflections and soft shadows of clean recordings have up to 0.06."""
_AWAY, _STAYS = 0.3, 0.5
_NEVER_LEFT_SHARE = 0.3
_NAMED = 8


class ResultWarning(Record):
    """One problem of a result.

    Attributes:
        code: for programs, such as ``"trunk_spin"``.
        value: the figure that is out of bounds.
        frames: numbers of the frames; empty for the whole input.
        message: problem and remedy, one sentence.
    """

    code: str
    value: float
    frames: tuple[int, ...]
    message: str


_SURE_FRONT = 0.8


@dataclass(frozen=True, eq=False)
class Look:
    """One frame with its matte and the fitted body's silhouette.

    Attributes:
        matte: matte of the person.
        alpha: the fitted body's share of each pixel, None where it was not drawn.
    """

    number: int
    frame_srgb: Float[Array, "H W 3"]
    matte: Float[Array, "H W"]
    alpha: Float[Array, "H W"] | None = None


def find_warnings(
    looks: Sequence[Look], plate_srgb: Float[Array, "H W 3"], motion: SampledMotion, matte_iou: Mapping[int, float]
) -> tuple[ResultWarning, ...]:
    """Run all checks on one result.

    Args:
        looks: frames of it, a few spread over a long clip; a few hundred pixels are enough.
        plate_srgb: background plate in the looks' size.
        motion: motion of the result, camera coordinates.
        matte_iou: per frame, of the fitted body.
    """
    found = (
        check_matte_iou(matte_iou),
        check_spin(motion),
        check_floor(motion),
        *check_limits(motion),
        check_left_over(looks),
        check_light(looks, plate_srgb),
        check_static(looks, plate_srgb),
    )
    return tuple(one for one in found if one is not None)


def check_matte_iou(matte_iou: Mapping[int, float]) -> ResultWarning | None:
    """Check that the body covers the matte.

    Args:
        matte_iou: soft IoU of the fitted body, by frame.
    """
    low = {frame: value for frame, value in sorted(matte_iou.items()) if value < LEAST_MATTE_IOU}
    if not low:
        return None
    worst = min(low.values())
    return _warning(
        "matte_iou",
        worst,
        low,
        f"the body does not cover what the matte shows (IoU {worst:.2f}, below {LEAST_MATTE_IOU}) in {_frames(low)}, "
        "so its pose there is unreliable; look at strip.png: where the matte is wrong give a better background plate, "
        "where it is right a better start (`hfb models fetch`, or another system's result with --init FILE)",
    )


def check_floor(motion: SampledMotion) -> ResultWarning | None:
    """Check that the floor does not contradict the feet and gravity.

    Args:
        motion: motion of the result, camera coordinates.
    """
    fault = floor_fault(motion)
    return None if fault is None else _warning("floor", 1.0, (), fault)


def check_spin(motion: SampledMotion) -> ResultWarning | None:
    """Check that the trunk does not turn faster between neighbouring frames than a person can.

    Args:
        motion: motion of the result, camera coordinates.
    """
    numbers = np.unique(motion.frame_index)
    middles = [motion.rows_of(int(number)) for number in numbers]
    rows = np.array([one[len(one) // 2] for one in middles])
    roots = _rotations(motion.poses[rows, :3])
    relative = np.einsum("nji,njk->nik", roots[:-1], roots[1:])
    angle = np.rad2deg(np.arccos(np.clip((np.trace(relative, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    seconds = np.maximum(np.diff(motion.times_s[rows]), 1e-6)
    spins = (np.diff(numbers) == 1) & (angle > _SPIN_DEG) & (angle / seconds > _SPIN_DEG_PER_S)
    if not spins.any():
        return None
    worst = float(angle[spins].max())
    where = tuple(int(number) for number in numbers[1:][spins])
    return _warning(
        "trunk_spin",
        worst,
        where,
        f"the trunk turns by {worst:.0f} degrees from one frame to the next, faster than a person can, before "
        f"{_frames(where)}: front and back were probably mistaken; give a better start (`hfb models fetch`, or another "
        "system's result with --init FILE), or leave the frames out",
    )


def check_limits(motion: SampledMotion) -> list[ResultWarning]:
    """Check that no limb moves as no person can; see `hfb.motion.limits`.

    Args:
        motion: motion of the result, camera coordinates.
    """
    shown = "look at the motion in 3D, and do not quote its speeds; a better start (--init FILE), a known height "
    shown += "(--fit.height-m) or a second frame may mend it"
    turns, ends, hinges = fastest_turns(motion, _TURN_WITHIN_S), fastest_ends(motion), fastest_hinges(motion)
    said = (
        ("limb_turn", turns, _TURN_M_S, "stops and turns around within one exposure, at {:.1f} m/s before and after"),
        ("limb_speed", ends, _END_M_S, "moves at {:.0f} m/s, faster than the fastest kicks and throws"),
        ("joint_speed", hinges, _HINGE_DEG_PER_S, "bends at {:.0f} degrees/s, faster than a professional pitcher's"),
    )
    found = []
    for code, figures, most, words in said:
        high = {frame: value for frame, value in figures.items() if value[0] > most}
        if high:
            worst, name = max(high.values())
            message = f"the motion is implausible in {_frames(list(high))}: the {name} {words.format(worst)}; {shown}"
            found.append(_warning(code, worst, high, message))
    return found


def check_front(probability: Mapping[int, float], turn_deg: Mapping[int, float]) -> ResultWarning | None:
    """Return a warning where two fits, one per way the person may face, explain the frames about as well.

    Args:
        probability: of the front that was kept, by frame; of frames whose front was never in doubt none.
        turn_deg: angle between both fronts, of the same frames; a small one is no other front.
    """
    low = {
        frame: value
        for frame, value in sorted(probability.items())
        if value < _SURE_FRONT and turn_deg[frame] > ANOTHER_FRONT_DEG
    }
    if not low:
        return None
    worst = min(low.values())
    return _warning(
        "front",
        worst,
        low,
        f"which way the person faces is unsure ({100 * worst:.0f} % for the way shown) in {_frames(low)}: give a "
        "better start (`hfb models fetch`, or another system's result with --init FILE), or a frame with less blur",
    )


def check_left_over(looks: Sequence[Look]) -> ResultWarning | None:
    """Check that no large piece of the matte is far from the fitted body.

    Args:
        looks: some frames with their mattes and the fitted silhouettes.
    """
    shares = {look.number: _left_over_share(look.matte, look.alpha) for look in looks if look.alpha is not None}
    high = {frame: share for frame, share in shares.items() if share > _MOST_LEFT_OVER}
    if not high:
        return None
    worst = max(high.values())
    return _warning(
        "matte_left_over",
        worst,
        high,
        f"a part of the matte ({worst:.0%} of it) is no part of the body in {_frames(high)}: something that was moved "
        "since the plate was taken, a shadow or another person; give a new plate, or a crop with the person alone",
    )


def check_light(looks: Sequence[Look], plate_srgb: Float[Array, "H W 3"]) -> ResultWarning | None:
    """Check that the scene is as bright as its plate, except where the person is.

    Args:
        looks: some frames with their mattes and the fitted silhouettes.
        plate_srgb: background plate in the looks' size.
    """
    plate = _places(plate_srgb)
    shares: dict[int, float] = {}
    for look in looks:
        frame = _places(look.frame_srgb)
        away = cv2.dilate(_places(look.matte), np.ones((5, 5), np.uint8)) < 0.02
        ratio = np.log((srgb_to_linear(frame) + 1e-3) / (srgb_to_linear(plate) + 1e-3))
        step = frame - plate
        for sign in (1, -1):
            other = away & (sign * ratio > _LIGHT_RATIO) & (sign * step > _LIGHT_SRGB)
            if away.any():
                shares[look.number] = max(shares.get(look.number, 0.0), _largest(other) / int(away.sum()))
    high = {frame: share for frame, share in shares.items() if share > _LIGHT_SHARE}
    if not high:
        return None
    worst = max(high.values())
    return _warning(
        "light",
        worst,
        high,
        f"the light is not the plate's in {_frames(high)} ({worst:.0%} of the scene is brighter or darker: shade, a "
        "lamp or automatic exposure), and the body follows such steps; lock the exposure, and give a plate taken in "
        "the same light",
    )


def check_static(looks: Sequence[Look], plate_srgb: Float[Array, "H W 3"]) -> ResultWarning | None:
    """Check that nothing but the person differs from the plate in all frames without moving.

    Args:
        looks: some frames with their mattes and the fitted silhouettes.
        plate_srgb: background plate in the looks' size.
    """
    if len(looks) < _STATIC_LOOKS:
        return None
    empty = shrink(plate_srgb, _STATIC_PX)
    frames = np.stack([shrink(look.frame_srgb, _STATIC_PX) for look in looks])
    mattes = np.stack([shrink(look.matte, _STATIC_PX) for look in looks])
    areas = [float(matte.sum()) for matte in mattes if matte.sum() > 0]
    number, labels = cv2.connectedComponents(constant_changes(frames, empty, _STATIC_SHARE).astype(np.uint8))
    regions = [labels == label for label in range(1, number)]
    regions = [one for one in regions if areas and one.sum() > _LEAST_STATIC * float(np.median(areas))]
    regions = [one for one in regions if _is_thing(one, mattes)]
    if not regions:
        return None
    largest = max(regions, key=lambda one: int(one.sum()))
    y, x = ((np.argwhere(largest) + 0.5) / empty.shape[:2]).mean(0).tolist()
    share = float(largest.sum()) / float(np.median(areas))
    return _warning(
        "static_change",
        share,
        (),
        f"something (at {x:.0%} of the width, {y:.0%} of the height) differs from the plate in nearly all frames and "
        "does not move: a thing that was moved since the plate was taken becomes body where the person is near; give a "
        "new plate of the scene as it is, or --background median",
    )


def check_never_left(boxes: Sequence[tuple[float, ...] | None]) -> ResultWarning | None:
    """Check that the person does not stay in one place for half of a clip whose background is its own median.

    Args:
        boxes: left, top, right, bottom of the person per frame; None where they are not seen.
    """
    seen = np.array([box for box in boxes if box is not None])
    if not len(seen):
        return None
    left, top, right, bottom = seen[:, 0].min(), seen[:, 1].min(), seen[:, 2].max(), seen[:, 3].max()
    xs, ys = (np.linspace(low, high, 65)[:-1] for low, high in ((left, right), (top, bottom)))
    inside = np.zeros((len(ys), len(xs)), np.int64)
    for box in seen:
        inside += np.outer((ys >= box[1]) & (ys < box[3]), (xs >= box[0]) & (xs < box[2]))
    cell = (right - left) * (bottom - top) / 64**2
    area = float(np.median((seen[:, 2] - seen[:, 0]) * (seen[:, 3] - seen[:, 1])))
    share = float((inside > len(boxes) / 2).sum() * cell / max(area, 1e-9))
    if share <= _NEVER_LEFT_SHARE:
        return None
    return _warning(
        "plate_holds_person",
        share,
        (),
        "the background is the median of a clip whose person stays in one place for more than half of it, so that it "
        "holds the person and the matte only what moves: give a plate of the empty scene (--background PLATE), or "
        "a longer range of the video in which the person walks away",
    )


def _warning(code: str, value: float, frames: Iterable[int], message: str) -> ResultWarning:
    return ResultWarning(code=code, value=round(value, 4), frames=tuple(frames), message=message)


def _left_over_share(matte: Float[Array, "H W"], alpha: Float[Array, "H W"]) -> float:
    seen = (matte > 0.5).astype(np.uint8)
    near = cv2.dilate((alpha > 0.05).astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    number, labels = cv2.connectedComponents(seen)
    sizes = np.bincount(labels.ravel(), minlength=number)
    touched = np.bincount(labels[near].ravel(), minlength=number)
    apart = [int(size) for size, near_px in zip(sizes[1:], touched[1:], strict=True) if near_px < 0.1 * size]
    return max(apart, default=0) / max(int(seen.sum()), 1)


def _is_thing(region: Bool[Array, "h w"], mattes: Float[Array, "n h w"]) -> bool:
    """Return whether a region is not the person: they are elsewhere in many frames, or move while it does not."""
    within = mattes[:, region].mean(1)
    if (within < _AWAY).mean() > 1 / 3:
        return True
    if (within > _STAYS).mean() < 0.5:
        return False
    rows, columns = np.mgrid[: region.shape[0], : region.shape[1]]
    rest = np.where(region, 0, mattes)
    weight = rest.sum((1, 2))
    if (weight < 1).any():
        return False
    y, x = ((rest * axis).sum((1, 2)) / weight for axis in (rows, columns))
    spans = [int(np.ptp(np.flatnonzero(region.any(axis)))) + 1 for axis in (0, 1)]
    return bool(math.hypot(float(np.ptp(x)), float(np.ptp(y))) > max(spans))


def _places(picture: Float[Array, "H W *c"]) -> Float[Array, "h w"]:
    """Return the brightness, or the matte, of a few places: smaller areas are no shade over a scene."""
    small = shrink(picture, _LIGHT_PX)
    return np.asarray(small.mean(-1) if small.ndim == 3 else small, np.float32)


def _largest(mask: Bool[Array, "h w"]) -> int:
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))


def _rotations(axis_angle: Float[Array, "n 3"]) -> Float[Array, "n 3 3"]:
    import torch

    return np.asarray(axis_angle_to_matrix(torch.from_numpy(np.ascontiguousarray(axis_angle))).numpy(), np.float64)


def _frames(numbers: Sequence[int] | Mapping[int, float]) -> str:
    """Return frames in words: "frame 3", "frames 3, 4 and 12 more"."""
    listed = list(numbers)
    shown = ", ".join(map(str, listed[:_NAMED]))
    more = f" and {len(listed) - _NAMED} more" if len(listed) > _NAMED else ""
    return f"frame{'s' if len(listed) > 1 else ''} {shown}{more}"
