"""Windows of videos from which cases can be made, and an order that spreads over all of them."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

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
        average: K, frames per exposure.
        place: the folder of the video, by the shortest unique end of its path; marked where no joints are measured.
        video: the video's name in results.
        remarks: remarks on the recording for readers of the results.
    """

    recording: Recording
    first: int
    average: int
    place: str = ""
    video: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Seen:
    """A usable video, its name among refused ones, and its inspection."""

    name: str
    footage: Footage
    inspection: Inspection
    remarks: list[str]


def real_windows(spec: RealSpec) -> tuple[list[RealWindow], dict[str, str]]:
    """Return every window of every usable video for every K, by path, K and time, and why a video is not used.

    A window has no dropped frame and, where joints were measured, a row of them for each of its frames.

    Args:
        spec: specification of the set.

    Raises:
        InputError: a folder is missing or holds no video.
    """
    found, refused = _find(spec.videos)
    seen: list[_Seen] = []
    windows: list[RealWindow] = []
    for name, footage in found:
        try:
            recording, remarks = find_recording(footage)
            seen.append(_Seen(name, footage, inspect(recording, footage), remarks))
        except InputError as error:
            refused[name] = str(error)
    places = place_names(one.footage.path.parent for one in seen)
    for one in seen:
        footage, joints = one.footage, one.inspection.recording.joints
        # Cameras that share their joints were triangulated together, so one shift holds for all of them.
        shift = joint_shift([o.inspection for o in seen if joints and o.inspection.recording.joints == joints])
        recording, remarks = replace(one.inspection.recording, shift=shift), one.remarks
        if shift:
            remarks = [*remarks, f"{joints.name if joints else ''} lay {shift:+d} frames off the pictures: corrected"]
        # An estimator's answers to sharp frames favour whoever starts from it: no reader may overlook that.
        mark = "" if joints else " (pseudo truth)"
        place = places[footage.path.parent] + mark
        video = one.name if spec.set == "b-aist" else f"{places[footage.path.parent]}/{footage.path.name}{mark}"
        for average in dict.fromkeys(spec.average):
            try:
                starts = _starts(recording, footage, average * spec.frames)
            except InputError as error:
                refused[one.name if len(spec.average) == 1 else f"{one.name} (K = {average})"] = str(error)
            else:
                windows += [RealWindow(recording, first, average, place, video, tuple(remarks)) for first in starts]
    return windows, refused


def place_names(folders: Iterable[Path]) -> dict[Path, str]:
    """Name each folder: the end of its path, as short as no other folder's path ends so.

    Args:
        folders: some may be named twice.
    """
    parts = {folder: folder.resolve().parts for folder in folders}

    def name(own: tuple[str, ...]) -> str:
        for length in range(1, len(own)):
            if sum(other[-length:] == own[-length:] for other in set(parts.values())) == 1:
                return "/".join(own[-length:])
        return Path(*own).as_posix()

    return {folder: name(own) for folder, own in parts.items()}


def choose(windows: Sequence[RealWindow], count: int, seed: int) -> list[RealWindow]:
    """Choose up to `count` windows, spread evenly over videos and K and, within both, over time.

    Every pair of a video and a K takes its turn before one has its second; within a round the next pair is of the
    video and the K that have had the fewest. Within a pair the windows come in bit-reversed order (van der Corput),
    rotated by the seed: every prefix is spread out, and a longer choice begins with the shorter one.

    Args:
        windows: windows to choose from.
        count: largest number of chosen windows.
        seed: rotates the order.
    """
    rng = np.random.default_rng(seed)
    cells: dict[tuple[Path, int], list[RealWindow]] = {}
    for window in windows:
        cells.setdefault((window.recording.video, window.average), []).append(window)
    orders = []
    for own in cells.values():
        shift = int(rng.integers(len(own)))
        orders.append([own[(index + shift) % len(own)] for index in _bit_reversed(len(own))])
    orders = [orders[index] for index in rng.permutation(len(orders))]
    had: Counter[Path | int] = Counter()
    chosen: list[RealWindow] = []
    for turn in range(max((len(order) for order in orders), default=0)):
        waiting = [order[turn] for order in orders if turn < len(order)]
        while waiting:
            window = min(waiting, key=lambda one: had[one.recording.video] + had[one.average])
            waiting.remove(window)
            had.update((window.recording.video, window.average))
            chosen.append(window)
    return chosen[: max(count, 0)]


def _find(folders: Sequence[Path]) -> tuple[list[tuple[str, Footage]], dict[str, str]]:
    """Return (name, video) of all folders, each video once, and by name why a video cannot be used.

    Raises:
        InputError: a folder is missing or holds no video.
    """
    found: dict[Path, tuple[str, Footage]] = {}
    refused: dict[str, str] = {}
    for folder in folders:
        footages, unusable = find_footage(folder)
        outer = "" if len(folders) == 1 else f"{folder.as_posix()}/"
        refused |= {f"{outer}{name}": reason for name, reason in unusable.items()}
        for footage in footages:
            name = f"{outer}{footage.path.relative_to(folder).as_posix()}"
            found.setdefault(footage.path.resolve(), (name, footage))
    return list(found.values()), refused


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
