"""Tracking of people in a clip, as the areas that differ from the background.

The tracking is cheap: a small image per frame, one pass, only boxes are kept. Another system's tracks can replace it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hfb.errors import InputError
from hfb.io.clip import PersonChoice
from hfb.io.media.plate import changed_pixels
from hfb.matting.matting_protocol import nobody_found
from hfb.tracking.person_pieces import Alpha, Person, join_pieces, matting_look
from hfb.tracking.track_rows import read_rows
from hfb.typing import Array, Bool, Float

_LOOK_PX = 240
_LEAST_SHARE = 0.0015
"""Share of the image's area; a smaller change is no person."""
_LEAST_OF_LARGEST = 0.15
"""Share of the frame's largest change; less is a part of a person, a shadow or a reflection."""
_FARTHEST, _LONGEST_ABSENCE = 0.4, 30
"""Largest step of a lost person per frame, in their own height, and the number of frames of the search."""
_SHORTEST = 2
_LEAST_SEEN = 4
"""Shortest track in frames; shorter ones are shadows or people at the image's edge."""
_MARGIN, _AROUND = 0.12, 0.3


@dataclass(frozen=True, eq=False)
class Track:
    """One person's boxes in a clip.

    Attributes:
        name: for messages.
        boxes: left, top, right, bottom [px]; NaN where not visible.
        areas: areas of the visible person [px]; the box's own where nothing better is known.
    """

    name: str
    boxes: Float[Array, "T 4"]
    areas: Float[Array, "T"]

    @property
    def present(self) -> Bool[Array, "T"]:
        """Frames in which the person is seen."""
        return np.isfinite(self.boxes).all(1)


@dataclass(frozen=True)
class ClipFrames:
    """The correspondence of a clip's images to a video's frames, which other systems' tracks count.

    Attributes:
        count: T.
        first: first of the video's frames.
        average: number of them in each image.
        height: height of the images [px]; boxes outside of them are dropped.
        width: width of the images [px]; boxes outside of them are dropped.
    """

    count: int
    first: int = 0
    average: int = 1
    height: float = np.inf
    width: float = np.inf

    def place(self, frame: int, box: Float[Array, "4"]) -> int | None:
        """Return the number of the clip's image that shows this box; None where none does.

        Args:
            frame: number in the video.
            box: left, top, right, bottom [px].
        """
        left, top, right, bottom = box
        in_view = max(left, 0) < min(right, self.width) and max(top, 0) < min(bottom, self.height)
        number = (frame - self.first) // self.average
        return number if np.isfinite(box).all() and in_view and 0 <= number < self.count else None


def find_tracks(
    frames: Iterable[Float[Array, "H W 3"]],
    plate: Float[Array, "H W 3"],
    on_progress: Callable[[int], None] | None = None,
    alpha: Alpha | None = None,
) -> tuple[Track, ...]:
    """Find everyone seen, in the order of appearance.

    People who cross are distinguished by the agreement of their boxes.

    Args:
        frames: one after another, encoded like the plate.
        plate: encoded like the frames, same size.
        on_progress: called after every frame with the number of frames done.
        alpha: distinguishes pieces of one person from two people, see `join_pieces`; the shipped network's by default.
    """
    alpha = alpha or matting_look
    scale = min(1.0, _LOOK_PX / max(plate.shape[:2]))
    empty = _small(plate, scale)
    open_tracks: list[dict[int, Person]] = []
    done = 0
    for done, frame in enumerate(frames, 1):
        changed = changed_pixels(_small(frame, scale)[None], empty)[0]
        pieces = join_pieces(_pieces(changed, scale), frame, plate, alpha)
        people = [one for one in pieces if one[4] >= _LEAST_OF_LARGEST * pieces[0][4]]
        _follow(open_tracks, people, done - 1)
        if on_progress:
            on_progress(done)
    kept = [track for track in open_tracks if len(track) >= min(_SHORTEST, done)]
    return tuple(_as_track(f"person {number}", track, done) for number, track in enumerate(kept, 1))


def choose_track(tracks: Sequence[Track], choice: PersonChoice) -> Track:
    """Return the person who is meant: in the given box of the given frame, else the one of whom most is seen.

    Without a box, a track during that person's absence counts as the same person, who left and came back.

    Args:
        tracks: tracks of everyone in the clip.
        choice: a box in a frame, or none.

    Raises:
        InputError: no person was found, or none in the box.
    """
    if not tracks:
        raise InputError(
            "nobody was seen in any frame: nothing differs from the background; check that the plate shows the empty "
            "scene and that the person moves."
        )
    if choice.box is None:
        return _with_returns(sorted(tracks, key=lambda track: -float(np.nansum(track.areas))))
    if choice.frame >= len(tracks[0].boxes):
        raise InputError(f"person.frame {choice.frame} lies past the clip's last frame {len(tracks[0].boxes) - 1}.")
    box = np.array(choice.box)
    shared = [agreement(track.boxes[choice.frame], box) for track in tracks]
    if max(shared) <= 0:
        seen = [track.name for track in tracks if track.present[choice.frame]]
        raise InputError(
            f"nobody was seen in the box of frame {choice.frame}"
            + (f"; seen there: {', '.join(seen)}" if seen else "; give a frame in which the person is seen")
            + "."
        )
    return tracks[int(np.argmax(shared))]


def choose_everyone(tracks: Sequence[Track]) -> tuple[tuple[Track, PersonChoice], ...]:
    """Return each person who is seen long enough, and the choice by which `choose_track` finds that one again.

    Args:
        tracks: tracks of everyone in the clip.

    Raises:
        InputError: no person was seen for long enough.
    """
    frames = len(tracks[0].boxes) if tracks else 0
    found = []
    for index, track in enumerate(tracks):
        if track.present.sum() < min(_LEAST_SEEN, frames):
            continue
        others = [other for number, other in enumerate(tracks) if number != index]
        seen = np.flatnonzero(track.present).tolist()  # seconds of an hour that was filmed
        hidden = {at: max((_overlap(other.boxes[at], track.boxes[at]) for other in others), default=0.0) for at in seen}
        clearest = min(hidden, key=hidden.__getitem__)
        left, top, right, bottom = (float(side) for side in track.boxes[clearest])
        found.append((track, PersonChoice(box=(left, top, right, bottom), frame=clearest)))
    if not found:
        raise InputError(
            f"nobody was seen in {_LEAST_SEEN} frames or more: check that the plate shows the empty scene."
        )
    return tuple(found)


def _with_returns(by_size: Sequence[Track]) -> Track:
    """Return the first track, with those of the others that never appear during it, or during one added before."""
    boxes, areas = by_size[0].boxes.copy(), by_size[0].areas.copy()
    for track in by_size[1:]:
        seen = track.present
        if not (seen & np.isfinite(boxes).all(1)).any():
            boxes[seen], areas[seen] = track.boxes[seen], track.areas[seen]
    return Track(by_size[0].name, boxes, areas)


def keep_person(matte: Float[Array, "H W"], box: Float[Array, "4"]) -> Float[Array, "H W"]:
    """Remove the parts of a matte that lie mostly outside of a box.

    Args:
        matte: alpha in [0, 1].
        box: left, top, right, bottom [px].

    Raises:
        InputError: nothing is left.
    """
    number, labels = cv2.connectedComponents((matte > 0.1).astype(np.uint8))
    margin = _MARGIN * max(box[2] - box[0], box[3] - box[1])
    height, width = matte.shape
    left, top, right, bottom = (
        int(np.clip(value, 0, limit))
        for value, limit in zip(
            (box[0] - margin, box[1] - margin, box[2] + margin + 1, box[3] + margin + 1),
            (width, height, width, height),
            strict=True,
        )
    )
    sizes = np.bincount(labels.ravel(), minlength=number)
    inside = np.bincount(labels[top:bottom, left:right].ravel(), minlength=number)
    kept = inside >= 0.5 * sizes
    kept[0] = False
    if not kept.any():
        raise nobody_found()
    near = cv2.dilate(kept[labels].astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    others = cv2.dilate((~kept[labels] & (labels > 0)).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return np.where(near & ~(others & ~kept[labels]), matte, 0).astype(np.float32)


def surroundings(box: Float[Array, "4"], height: int, width: int) -> tuple[slice, slice]:
    """Return rows and columns of the box and enough of the background around it for a matte.

    Args:
        box: left, top, right, bottom [px].
        height: height of the image [px].
        width: width of the image [px].
    """
    extra = _AROUND * max(box[2] - box[0], box[3] - box[1])
    (left, right), (top, bottom) = (
        (int(np.clip(box[low] - extra, 0, side)), int(np.clip(np.ceil(box[low + 2] + extra), 0, side)))
        for low, side in ((0, width), (1, height))
    )
    return slice(top, bottom), slice(left, right)


def read_track(path: Path, track_id: int | str | None, frames: ClipFrames) -> Track:
    """Read one person's boxes from another system's file.

    A .csv names its columns: ``frame`` (from 0), ``id``, ``left``, ``top`` and ``right``, ``bottom`` or ``width``,
    ``height``; one without a header is MOTChallenge's, whose frames count from 1. A .npz has ``frame`` (N), ``id`` (N)
    and ``box`` (N, 4: left, top, right, bottom).

    An image that is the mean of several frames gets the box around all of theirs.

    Args:
        path: the other system's file.
        track_id: person's id; may be left out where the file has one person.
        frames: the clip's frames within the video.

    Raises:
        InputError: missing, damaged, no such track, or none of its frames lies within the clip.
    """
    rows = read_rows(path)
    known = sorted({name for _, name, _ in rows})
    listed = ", ".join(name[:40] for name in known[:12])
    if track_id is None and len(known) != 1:
        raise InputError(f"{path}: holds {len(known)} people; choose one with person.id: {listed}.")
    wanted = known[0] if track_id is None else str(track_id)
    if wanted not in known:
        raise InputError(f"{path}: has no track {wanted[:40]}; it has {listed}.")
    boxes = np.full((frames.count, 4), np.nan)
    for frame, name, box in rows:
        number = frames.place(frame, box) if name == wanted else None
        if number is not None:
            boxes[number, :2] = np.fmin(boxes[number, :2], box[:2])
            boxes[number, 2:] = np.fmax(boxes[number, 2:], box[2:])
    if not np.isfinite(boxes).any():
        raise InputError(
            f"{path}: track {wanted} has no box in the clip's {frames.count} frames"
            + (f" (from frame {frames.first} of the video on)." if frames.first else ".")
        )
    return Track(f"track {wanted}", boxes, (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]))


def read_track_names(path: Path, frames: ClipFrames) -> tuple[str, ...]:
    """Return the names of the people with boxes in the clip's frames, in order.

    Args:
        path: the other system's file.
        frames: the clip's frames within the video.

    Raises:
        InputError: missing, damaged, or without a box in the clip's frames.
    """
    here = {name for frame, name, box in read_rows(path) if frames.place(frame, box) is not None}
    if not here:
        raise InputError(f"{path}: has no box in the clip's {frames.count} frames.")
    return tuple(sorted(here, key=lambda name: (len(name), name)))


def _pieces(changed: Bool[Array, "h w"], scale: float) -> list[Person]:
    """Return every change that may be a person or a part of one, in full pixels."""
    closed = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(closed)
    return [
        (x / scale, y / scale, (x + w) / scale, (y + h) / scale, area / scale**2)
        for x, y, w, h, area in stats[1:].tolist()
        if area >= _LEAST_SHARE * changed.size
    ]


def _follow(tracks: list[dict[int, Person]], people: list[Person], frame: int) -> None:
    """Give every person of a frame to the track whose last box agrees most with theirs, or to a new one."""
    last = [track[max(track)] for track in tracks]
    pairs = sorted(
        (
            (-agreement(np.array(box[:4]), np.array(person[:4])), number, index)
            for number, box in enumerate(last)
            for index, person in enumerate(people)
        ),
    )
    taken: set[int] = set()
    given: set[int] = set()
    for shared, number, index in pairs:
        if shared < 0 and number not in taken and index not in given:
            tracks[number][frame] = people[index]
            taken.add(number)
            given.add(index)
    for index, person in enumerate(people):
        if index in given:
            continue
        near = [(_way(track, person, frame), number) for number, track in enumerate(tracks) if frame not in track]
        way, number = min(near, default=(np.inf, -1))
        if way <= _FARTHEST:
            tracks[number][frame] = person
        else:
            tracks.append({frame: person})


def _way(track: dict[int, Person], person: Person, frame: int) -> float:
    """Return a person's distance from a track's last box, in lengths of the larger box per frame that passed."""
    last = max(track)
    one, other = np.array(track[last][:4]), np.array(person[:4])
    sides = [float((box[2:] - box[:2]).max()) for box in (one, other)]
    if frame - last > _LONGEST_ABSENCE or max(sides) > 2 * min(sides):
        return np.inf
    return float(np.linalg.norm((one[:2] + one[2:] - other[:2] - other[2:]) / 2)) / max(sides) / (frame - last)


def _overlap(one: Float[Array, "4"], other: Float[Array, "4"]) -> float:
    """Return the shared area as a share of the smaller box; 0 for an unknown box."""
    return _shared_px(one, other) / max(min(_area_px(one), _area_px(other)), 1e-9)


def agreement(one: Float[Array, "4"], other: Float[Array, "4"]) -> float:
    """Return the intersection over union (IoU) of two boxes.

    Args:
        one: left, top, right, bottom [px].
        other: likewise.
    """
    shared = _shared_px(one, other)
    return shared / max(_area_px(one) + _area_px(other) - shared, 1e-9) if shared > 0 else 0.0


def _area_px(box: Float[Array, "4"]) -> float:
    return float((box[2:] - box[:2]).prod())


def _shared_px(one: Float[Array, "4"], other: Float[Array, "4"]) -> float:
    """Return the area in both boxes; 0 where one is unknown."""
    size = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    return float(size.prod()) if (size > 0).all() else 0.0


def _as_track(name: str, found: dict[int, Person], frames: int) -> Track:
    boxes, areas = np.full((frames, 4), np.nan), np.full(frames, np.nan)
    for frame, person in found.items():
        boxes[frame], areas[frame] = person[:4], person[4]
    return Track(name, boxes, areas)


def _small(picture: Float[Array, "H W 3"], scale: float) -> Float[Array, "h w 3"]:
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    return np.asarray(cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
