"""The videos of a result: what happened while the shutter was open."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from hfb.config import Film, FitConfig, RunConfig
from hfb.interop.writers.names import FILM_NAMES
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.core.task import task
from hfb.tasks.results.export_files import ExportsHandle
from hfb.tasks.telemetry import progress

if TYPE_CHECKING:
    from hfb.report.slow_motion import Shot
    from hfb.typing import Array, Float

_SAID_EVERY_S = 0.25


@task("films")
def make_films(
    clip: ClipHandle,
    motion: FileHandle,
    texture: FileHandle,
    body: FileHandle | None,
    films: tuple[Film, ...],
    config: FitConfig,
    folder: Path,
) -> ExportsHandle:
    """Draw the asked-for films; see `hfb.report.slow_motion`.

    Args:
        clip: all frames of the clip: the motion names them by their numbers.
        texture: an .npz with the ``texture`` of the person, in the clip's light.
    """
    return ExportsHandle(files=tuple(draw_film(film, clip, motion, texture, body, config, folder) for film in films))


def films_of(
    clip: ClipHandle, motion: FileHandle, texture: FileHandle, body: FileHandle | None, config: RunConfig, folder: Path
) -> ExportsHandle:
    """The films that the options ask for; no task where they ask for none. Arguments as in `make_films`."""
    films = tuple(dict.fromkeys(config.export.films))
    return make_films(clip, motion, texture, body, films, config.fit, folder) if films else ExportsHandle(files=())


def draw_film(
    film: Film,
    clip: ClipHandle,
    motion: FileHandle,
    texture: FileHandle,
    body: FileHandle | None,
    config: FitConfig,
    folder: Path,
) -> FileHandle:
    """Draw one film; arguments as in `make_films`."""
    return FileHandle.of(write_film(film, shot_of(clip, motion, texture, body, config), folder))


def write_film(film: Film, shot: Shot, folder: Path) -> Path:
    """Draw one film of a shot into a folder; says how far it is."""
    from hfb.io.media.video_writing import VideoWriter
    from hfb.report import slow_motion

    path = folder / FILM_NAMES[film]
    slow = slow_motion.film_slow_factor(shot.motion)
    rate = slow_motion.overlay_rate(shot.motion) if film == "overlay" else float(slow_motion.FILM_FPS)
    true_times = film == "exact"
    comment = (
        "one picture per sub-frame, shown at its true time" if true_times else f"hfb {film}, {slow:g} times slower"
    )
    with VideoWriter(path, None if true_times else rate, comment, to_look_at=True) as writer:
        for time_s, picture in watched(film, _pictures(film, shot), slow_motion.picture_count(shot.motion, film)):
            writer.write(picture, time_s)
    return path


def _pictures(film: Film, shot: Shot) -> Iterator[tuple[float | None, Float[Array, "Y X 3"]]]:
    from hfb.report import slow_motion

    if film == "exact":
        yield from slow_motion.exact_sub_frames(shot)
        return
    for picture in slow_motion.overlay(shot) if film == "overlay" else slow_motion.slow_motion(shot):
        yield None, picture


def watched(
    label: str, pictures: Iterator[tuple[float | None, Float[Array, "Y X 3"]]], total: int
) -> Iterator[tuple[float | None, Float[Array, "Y X 3"]]]:
    said = 0.0
    for number, picture in enumerate(pictures, 1):
        if time.monotonic() - said > _SAID_EVERY_S or number == total:
            said = time.monotonic()
            progress.advance(number, total, label)
        yield picture


def shot_of(
    clip: ClipHandle, motion: FileHandle, texture: FileHandle, body: FileHandle | None, config: FitConfig
) -> Shot:
    from hfb.motion.motion_file import load_motion
    from hfb.rendering.backends import make_rasterizer
    from hfb.report.slow_motion import Shot
    from hfb.tasks.core.scene import load_camera, load_chosen_body, load_picture, load_texture

    return Shot(
        motion=load_motion(motion.path)[0],
        body=load_chosen_body(body),
        texture=load_texture(texture),
        rasterizer=make_rasterizer("coverage", config.rasterizer, config.threads),
        camera=load_camera(clip),
        plate_linear=load_picture(clip.background, clip),
        frame_linear=lambda number: load_picture(clip.frames[number], clip),
        light=clip.light,
    )
