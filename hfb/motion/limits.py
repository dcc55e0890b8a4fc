"""Speeds of a motion per exposure, to be held against what people can do."""

from collections.abc import Mapping

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float

ENDS: Mapping[str, int] = {
    name.replace("_", " "): JOINT_NAMES.index(name)
    for name in ("left_wrist", "right_wrist", "left_ankle", "right_ankle", "head")
}
_HINGES = {
    name.replace("_", " "): tuple(map(JOINT_NAMES.index, (above, name, below)))
    for above, name, below in (
        ("left_shoulder", "left_elbow", "left_wrist"),
        ("right_shoulder", "right_elbow", "right_wrist"),
        ("left_hip", "left_knee", "left_ankle"),
        ("right_hip", "right_knee", "right_ankle"),
    )
}
_BACKWARDS = -0.5  # cosine of the angle between the first and the last direction: a turn by 120 degrees


def fastest_ends(motion: SampledMotion) -> dict[int, tuple[float, str]]:
    """Return each frame's largest speed of a wrist, an ankle or the head [m/s], and whose it is.

    Args:
        motion: camera coordinates.
    """
    return {frame: _largest(np.linalg.norm(v, axis=-1).max(0), ENDS) for frame, v, _ in _exposures(motion)}


def fastest_turns(motion: SampledMotion, longest_s: float) -> dict[int, tuple[float, str]]:
    """Return the speed [m/s] from which, and to which, a limb's end turned around within one exposure, and whose it is.

    It is the smaller of the first and the last speed where these directions differ by more than 120 degrees, else 0.

    Args:
        motion: camera coordinates.
        longest_s: longer exposures are left out: people do turn within them.
    """
    found = {}
    for frame, velocities, open_s in _exposures(motion):
        first, last = velocities[0], velocities[-1]
        speeds = np.minimum(np.linalg.norm(first, axis=-1), np.linalg.norm(last, axis=-1))
        product = np.linalg.norm(first, axis=-1) * np.linalg.norm(last, axis=-1)
        turns = (first * last).sum(-1) < _BACKWARDS * product
        if open_s <= longest_s:
            found[frame] = _largest(np.where(turns, speeds, 0.0), ENDS)
    return found


def fastest_hinges(motion: SampledMotion) -> dict[int, tuple[float, str]]:
    """Return each frame's largest rate at which an elbow or a knee bends or stretches [degrees/s], and whose it is.

    Args:
        motion: camera coordinates.
    """
    above, at, below = (motion.joints[:, [chain[place] for chain in _HINGES.values()]] for place in range(3))
    upper, lower = above - at, below - at
    lengths = np.linalg.norm(upper, axis=-1) * np.linalg.norm(lower, axis=-1)
    angle_deg = np.rad2deg(np.arccos(np.clip((upper * lower).sum(-1) / np.maximum(lengths, 1e-9), -1, 1)))
    found = {}
    for frame, rows, steps_s in _instants(motion):
        found[frame] = _largest((np.abs(np.diff(angle_deg[rows], axis=0)) / steps_s[:, None]).max(0), _HINGES)
    return found


def _instants(motion: SampledMotion) -> list[tuple[int, Array, Float[Array, "n"]]]:
    """Return every frame with its rows and the times between them [s]."""
    found = []
    for frame in np.unique(motion.frame_index).tolist():
        rows = motion.rows_of(frame)
        steps_s = np.diff(motion.times_s[rows])
        if len(steps_s) and (steps_s > 0).all():
            found.append((frame, rows, steps_s))
    return found


def _exposures(motion: SampledMotion) -> list[tuple[int, Float[Array, "n 5 3"], float]]:
    """Return every frame with the velocities of `ENDS` between its instants [m/s], and its length [s]."""
    ends = motion.joints[:, list(ENDS.values())]
    return [
        (frame, np.diff(ends[rows], axis=0) / steps_s[:, None, None], float(steps_s.sum()))
        for frame, rows, steps_s in _instants(motion)
    ]


def _largest(values: Float[Array, "n"], names: Mapping[str, object]) -> tuple[float, str]:
    at = int(values.argmax())
    return float(values[at]), list(names)[at]
