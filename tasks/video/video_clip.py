"""The tasks of a clip as a whole: its description, its background, and its people."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hfb.config import CameraConfig, ExposureConfig
from hfb.io.atomic import write_bytes_atomic
from hfb.io.clip import PersonChoice
from hfb.tasks.core.handles import FileHandle, verify_unchanged
from hfb.tasks.core.video_handles import FootageHandle, PeopleHandle, PersonSeen, PlateHandle, TrackHandle
from hfb.tasks.image.prepare import calibration
from hfb.tasks.inputs.inputs import find_readout
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.task import task

if TYPE_CHECKING:
    from hfb.io.media.footage import Footage
    from hfb.io.media.timing import Timing
    from hfb.tracking.tracks import ClipFrames


@task("video", where="worker")
def look_at_clip(
    *, inputs: VideoInputs, average: int, camera: CameraConfig, exposure: ExposureConfig, folder: Path
) -> FootageHandle:
    """Decode everything once: number of frames, when and how they were taken, and their defects.

    Args:
        inputs: of the run.
        average: number of video frames averaged into one frame of the clip.
        camera: options of the camera.
        exposure: options of the exposure.
        folder: where the description goes.

    Raises:
        InputError: no frame can be decoded, or clip.toml or an option does not fit the clip.
    """
    from hfb.geometry.placement import with_floor
    from hfb.io.media.footage import open_footage
    from hfb.io.media.lens.camera_pose import clip_world, pose_remarks
    from hfb.io.media.lens.clip_lens import check_pinhole, clip_lens
    from hfb.io.media.timing import settle_timing

    clip = inputs.clip
    paths = [file.path for file in inputs.video]
    footage = open_footage(
        paths[0] if len(paths) == 1 else paths,
        start=clip.start or 0,
        stop=clip.stop,
        start_s=clip.start_s,
        stop_s=clip.stop_s,
        average=average,
        transfer=clip.transfer,
        fps=exposure.fps or clip.exposure.fps,
        scan=clip.scan,
    )
    given = clip.camera.model_copy(update={"calibration": inputs.calibration.path if inputs.calibration else None})
    lens = clip_lens(given, paths[0].name, footage.height, footage.width)
    footage = footage.through(lens)
    timing = settle_timing(footage, clip.exposure, exposure)
    given_files = [file.model_dump(mode="json") for file in inputs.video]
    content = {"footage": _plain(footage), "timing": _plain(timing), "given": given_files}
    path, size = folder / "footage.json", (footage.height, footage.width)
    K = lens.pinhole() if lens and camera.focal_px is None else calibration(camera, clip, *size)
    write_bytes_atomic(path, json.dumps(content).encode())
    return FootageHandle.of(
        path,
        count=footage.count,
        height=footage.height,
        width=footage.width,
        K=K,
        exposure_s=timing.exposure_s,
        interval_s=timing.interval_s,
        transfer=footage.transfer,
        light=exposure.light,
        bits=footage.bits,
        remarks=(*footage.remarks, timing.source, *check_pinhole(K, *size), *pose_remarks(given, paths[0].name)),
        world=with_floor(clip_world(camera, given, paths[0].name), camera.floor or given.floor),
        readout=find_readout(clip.exposure, exposure),
    )


@task("background", where="worker")
def find_background(
    footage: FootageHandle, how: Literal["file", "median", "still"], given: FileHandle | None, folder: Path
) -> PlateHandle:
    """Find the view without the person.

    Args:
        footage: the clip.
        how: origin of the plate.
        given: the user's plate.
        folder: where it goes.

    Raises:
        InputError: there is no section without motion, or the plate contains the person, or is of another
            camera or size.
    """
    from hfb.io.media.images.image_io import write_png
    from hfb.io.media.plate import find_plate

    if given is not None:
        where: Path | Literal["median", "still"] = given.path
    else:
        where = "still" if how == "still" else "median"
    with reading(footage) as pictures:
        picture, source = find_plate(pictures, where)
    path = folder / "plate.png"
    write_png(path, picture, bits=footage.bits)
    return PlateHandle.of(path, source=source)


@task("person's track", where="worker")
def find_person(
    footage: FootageHandle, plate: PlateHandle, choice: PersonChoice, track: FileHandle | None
) -> TrackHandle:
    """Find the position of the chosen person in every frame.

    Args:
        footage: the clip.
        plate: its background.
        choice: which person.
        track: the user's own file of tracks.

    Raises:
        InputError: the chosen person is not in the clip.
    """
    from hfb.io.media.images.image_io import read_picture_srgb
    from hfb.tracking.gap_looks import look_into_gaps
    from hfb.tracking.tracks import choose_track, find_tracks, read_track, read_track_names

    if track is not None:
        frames = _clip_frames(footage)
        found = read_track(track.path, choice.id, frames)
        others = len(read_track_names(track.path, frames)) - 1
    else:
        empty = read_picture_srgb(plate.path)
        with reading(footage) as pictures:
            tracks = find_tracks(pictures.frames(), empty)
            chosen = choose_track(tracks, choice)
            rest = [one for one in tracks if one.name != chosen.name]
            found = look_into_gaps(chosen, rest, lambda number: next(pictures.frames(number, number + 1)), empty)
        others = len(tracks) - 1
    boxes = [tuple(float(side) for side in box) if np.isfinite(box).all() else None for box in found.boxes]
    return TrackHandle(name=found.name, boxes=tuple(boxes), others=others)


@task("everyone's tracks", where="worker")
def find_everyone(footage: FootageHandle, plate: PlateHandle, track: FileHandle | None) -> PeopleHandle:
    """Find all people of the clip, each with the option that selects them.

    Args:
        footage: the clip.
        plate: its background.
        track: the user's own file of tracks.

    Raises:
        InputError: there is no person.
    """
    from hfb.io.media.images.image_io import read_picture_srgb
    from hfb.tracking.tracks import choose_everyone, find_tracks, read_track, read_track_names

    if track is not None:
        named = PersonChoice(track=Path(track.path.name))
        frames = _clip_frames(footage)
        chosen = [
            (read_track(track.path, name, frames), named.model_copy(update={"id": name}))
            for name in read_track_names(track.path, frames)
        ]
    else:
        with reading(footage) as pictures:
            seen = find_tracks(pictures.frames(), read_picture_srgb(plate.path))
        chosen = list(choose_everyone(seen))
    people = (PersonSeen(name=one.name, choice=choice, frames=int(one.present.sum())) for one, choice in chosen)
    return PeopleHandle(people=tuple(people))


def load_footage(handle: FootageHandle) -> Footage:
    """Return the reader of a clip's images.

    Args:
        handle: the clip.
    """
    return _described(handle.path, handle.sha256)[0]


@contextmanager
def reading(handle: FootageHandle, start: int = 0, stop: int | None = None) -> Iterator[Footage]:
    """Provide the reader of a clip's images inside the block.

    Args:
        handle: the clip.
        start: first frame that will be read.
        stop: end of the frames that will be read; None for the clip's end.

    Raises:
        StaleFile: the video, or an image of these frames, is no longer what it was, or was replaced meanwhile.
    """
    footage, _, given = _described(handle.path, handle.sha256)
    if len(given) > 1:
        last = footage.count if stop is None else stop
        given = given[footage.first + start * footage.average : footage.first + last * footage.average]
    with verify_unchanged(given):
        yield footage


def load_timing(handle: FootageHandle) -> Timing:
    """Return the times of a clip's frames.

    Args:
        handle: the clip.
    """
    return _described(handle.path, handle.sha256)[1]


@functools.lru_cache(maxsize=1)
def _described(path: Path, sha256: str) -> tuple[Footage, Timing, tuple[FileHandle, ...]]:
    """Read footage.json, cached: for a folder of ten thousand images it has megabytes and is read for every chunk."""
    from hfb.io.media.footage import Footage
    from hfb.io.media.timing import Timing

    content = json.loads(path.read_bytes())
    given = tuple(FileHandle(**one) for one in content["given"])
    return Footage(**_numbers(content["footage"])), Timing(**_numbers(content["timing"])), given


def _clip_frames(footage: FootageHandle) -> ClipFrames:
    """Return the numbers of the clip's frames in the video."""
    from hfb.tracking.tracks import ClipFrames

    known = load_footage(footage)
    return ClipFrames(known.count, known.first, known.average, known.height, known.width)


def _plain(record: Any) -> dict[str, Any]:
    """Return a frozen record of paths, numbers and rows of numbers as JSON."""
    return {field.name: _as_json(getattr(record, field.name)) for field in fields(record)}


def _as_json(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"rows": value.tolist(), "dtype": str(value.dtype)}
    if is_dataclass(value):
        return {type(value).__name__: _plain(value)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, tuple):
        return {"tuple": [_as_json(one) for one in value]}
    return value.item() if isinstance(value, np.generic) else value


def _numbers(content: dict[str, Any]) -> dict[str, Any]:
    return {name: _from_json(value) for name, value in content.items()}


def _from_json(value: Any) -> Any:
    from hfb.io.media.lens.lens import Lens
    from hfb.io.media.video.video_index import VideoIndex

    if not isinstance(value, dict):
        return value
    ((kind, content), *_) = value.items()
    if kind == "rows":
        return np.array(content, dtype=value["dtype"])
    if kind in ("VideoIndex", "Lens"):
        return (VideoIndex if kind == "VideoIndex" else Lens)(**_numbers(content))
    return Path(content) if kind == "path" else tuple(_from_json(one) for one in content)
