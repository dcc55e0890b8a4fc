"""Joining of several tracks of one person, since trackers lose people and give them a new number."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hfb.interop.readers.pose_track import OPTIONAL, PoseTrack
from hfb.typing import Array, Float

JOINT = "+"
"""Between the names of joined tracks."""
_LONGEST_GAP = 30
_NEAR, _PER_FRAME, _FARTHEST = 0.4, 0.05, 1.0
"""Largest distance of the end of a track from the beginning of the next, in heights of the person: from one frame to
the next, per further frame, and in all."""
_HEIGHT_M = 1.7
_log = logging.getLogger(__name__)


def joined(tracks: Sequence[PoseTrack]) -> list[PoseTrack]:
    """Join tracks that never share a frame and continue one another, named after all of them, with a remark.

    Args:
        tracks: in the order of time each, every frame once.
    """
    people: list[PoseTrack] = []
    for track in sorted(tracks, key=lambda one: int(one.frames[0])):
        ways = [(way, number) for number, one in enumerate(people) if (way := _way(one, track)) is not None]
        if ways:
            _, number = min(ways)
            people[number] = _both(people[number], track)
        else:
            people.append(track)
    for one in people:
        if one.person not in {track.person for track in tracks}:
            _log.warning(
                "%s: persons %s never share a frame and continue one another: taken for one",
                one.system,
                ", ".join(one.person.split(JOINT)),
            )
    order = {track.person: number for number, track in enumerate(tracks)}
    return sorted(people, key=lambda one: order[one.person.split(JOINT)[0]])


def _way(one: PoseTrack, other: PoseTrack) -> float | None:
    """Return the distance of two tracks where they meet, in heights; None where they cannot be one person's."""
    same = all((getattr(one, name) is None) == (getattr(other, name) is None) for name in OPTIONAL)
    if one.rate_hz is not None or not same or (one.size, one.betas_space) != (other.size, other.betas_space):
        return None
    if np.intersect1d(one.frames, other.frames).size:
        return None
    frames = np.concatenate([one.frames, other.frames])
    owner = np.repeat([0, 1], [len(one), len(other)])
    order = np.argsort(frames)
    places = _places(one), _places(other)
    if places[0] is None or places[1] is None:
        return None
    where, gaps = np.concatenate([places[0], places[1]])[order], np.diff(frames[order])
    switches = np.flatnonzero((np.diff(owner[order]) != 0) & (gaps <= _LONGEST_GAP))
    if not switches.size:
        return None
    before, after = where[switches], where[switches + 1]
    size = np.maximum(before[:, 2], after[:, 2])
    ways = np.linalg.norm((after - before)[:, :2], axis=1) / size + np.abs(np.log(after[:, 2] / before[:, 2]))
    allowed = np.minimum(_NEAR + _PER_FRAME * (gaps[switches] - 1), _FARTHEST)
    return float(ways.max()) if (ways < allowed).all() else None


def _places(track: PoseTrack) -> Float[Array, "R 3"] | None:
    """Return the person's position and height in the images [px]; None where the system does not state them."""
    if track.pixels is not None:
        spread = np.nanmax(track.pixels, 1) - np.nanmin(track.pixels, 1)
        return np.column_stack([np.nanmedian(track.pixels, 1), np.maximum(spread.max(1), 1.0)])
    place = track.pelvis if track.pelvis is not None else track.trans
    if place is None and track.joints is not None:
        place = np.nanmedian(track.joints, 1)
    if place is None or track.K is None:
        return None
    focal, centre = track.K[:, [0, 1], [0, 1]], track.K[:, [0, 1], [2, 2]]
    return np.column_stack([focal * place[:, :2] / place[:, 2:] + centre, _HEIGHT_M * focal[:, 1] / place[:, 2]])


def _both(one: PoseTrack, other: PoseTrack) -> PoseTrack:
    order = np.argsort(np.concatenate([one.frames, other.frames]))
    arrays: dict[str, Any] = {
        name: np.concatenate([mine, getattr(other, name)])[order]
        for name in OPTIONAL
        if (mine := getattr(one, name)) is not None
    }
    frames = np.concatenate([one.frames, other.frames])[order]
    return replace(one, person=f"{one.person}{JOINT}{other.person}", frames=frames, images=None, **arrays)
