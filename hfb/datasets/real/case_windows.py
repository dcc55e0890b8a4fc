"""Windows of videos from which cases can be made, and an order that spreads over all of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hfb.datasets.real.inspection import Inspection, inspect, joint_shift
from hfb.datasets.real.markers import body_columns
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.real.source_videos import Footage, find_footage
from hfb.datasets.real.video_assets import Recording, find_recording
from hfb.errors import InputError


@dataclass(frozen=True)
class RealWindow:
    """T * K consecutive frames of a video.

    Attributes:
        first: number of its first frame in the video.
        remarks: remarks on the recording for readers of the results.
    """

    recording: Recording
    first: int
    remarks: tuple[str, ...] = ()


def real_windows(spec: RealSpec) -> tuple[list[RealWindow], dict[str, str]]:
    """Return every window of every usable video, by path and time, and by relative path why a video is not used.

    A window has no dropped frame and, where joints were measured, a row of them for each of its frames.

    Args:
        spec: specification of the set.

    Raises:
        InputError: the folder is missing or holds no video.

    Raises:
        InputError: the folder is missing or holds no video.
    """
    footages, refused = find_footage(spec.videos)
    seen: list[tuple[Footage, Inspection, list[str]]] = []
    windows: list[RealWindow] = []

    def refuse(footage: Footage, error: InputError) -> None:
        refused[footage.path.relative_to(spec.videos).as_posix()] = str(error)

    for footage in footages:
        try:
            recording, remarks = find_recording(footage)
            seen.append((footage, inspect(recording, footage), remarks))
        except InputError as error:
            refuse(footage, error)
    for footage, inspection, remarks in seen:
        joints = inspection.recording.joints
        # Cameras that share their joints were triangulated together, so one shift holds for all of them.
        shift = joint_shift([other for _, other, _ in seen if joints and other.recording.joints == joints])
        recording = replace(inspection.recording, shift=shift)
        if shift:
            remarks = [*remarks, f"{joints.name if joints else ''} lay {shift:+d} frames off the pictures: corrected"]
        try:
            starts = _starts(recording, footage, spec.average * spec.frames)
        except InputError as error:
            refuse(footage, error)
        else:
            windows += [RealWindow(recording, first, tuple(remarks)) for first in starts]
    return windows, refused


def choose(windows: Sequence[RealWindow], count: int, seed: int) -> list[RealWindow]:
    """Choose up to `count` windows, spread evenly over videos and, within a video, over time.

    The videos take turns. Within one the windows come in bit-reversed order (van der Corput), rotated by the seed:
    every prefix is spread out, and a longer choice begins with the shorter one.

    Args:
        windows: windows to choose from.
        count: largest number of chosen windows.
        seed: rotates the order.
    """
    rng = np.random.default_rng(seed)
    videos: dict[object, list[RealWindow]] = {}
    for window in windows:
        videos.setdefault(window.recording.video, []).append(window)
    orders = []
    for own in videos.values():
        shift = int(rng.integers(len(own)))
        orders.append([own[(index + shift) % len(own)] for index in _bit_reversed(len(own))])
    orders = [orders[index] for index in rng.permutation(len(orders))]
    longest = max((len(order) for order in orders), default=0)
    turns = [order[turn] for turn in range(longest) for order in orders if turn < len(order)]
    return turns[: max(count, 0)]


def _bit_reversed(count: int) -> list[int]:
    """Return 0 .. count - 1, each far from those before it: count times 0, 1/2, 1/4, 3/4, 1/8, ... rounded down."""
    bits = max(count - 1, 1).bit_length()
    reversed_bits = (int(f"{index:0{bits}b}"[::-1], 2) for index in range(1 << bits))
    return list(dict.fromkeys(count * index >> bits for index in reversed_bits))


def _starts(recording: Recording, footage: Footage, length: int) -> list[int]:
    """Return first frames of all windows of a length.

    Raises:
        InputError: the video is shorter, or joints and time stamps leave no whole window.
    """
    if footage.count < length:
        raise InputError(f"{footage.path}: has {footage.count} frames and a case needs {length}; average fewer.")
    broken = np.concatenate([[0], np.cumsum(~footage.steady)])  # before frame i
    good = broken[length - 1 :] == broken[: footage.count - length + 1]
    markers = recording.markers()
    if markers is not None:
        columns, _ = body_columns(markers.names)
        rows = markers.rows(recording.row_of(0), footage.count)[:, columns]
        known = np.isfinite(rows).all(-1).sum(1) >= len(columns) / 2
        lacking = np.concatenate([[0], np.cumsum(~known)])
        good &= lacking[length:] == lacking[: footage.count - length + 1]
    starts = [int(first) for first in np.flatnonzero(good)]
    if not starts:
        raise InputError(
            f"{footage.path}: no {length} frames in a row have regular time stamps"
            + (f" and joints in {recording.joints}" if markers is not None else "")
            + "; average fewer."
        )
    return starts
