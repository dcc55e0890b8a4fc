"""A result's files for other programs and for people: motion files and films."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path
from typing import TYPE_CHECKING, cast

from hfb.config import ExportConfig, Film, FitConfig, Record
from hfb.errors import InputError
from hfb.geometry.world import WorldFacts
from hfb.interop.writers.export_names import FILE_NAMES, FILM_NAMES, NEEDS_BODY, PLATE
from hfb.io.atomic import write_bytes_atomic
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.task import task
from hfb.tasks.telemetry import progress

if TYPE_CHECKING:
    from hfb.body.model import BetasSpace
    from hfb.report.films.slow_motion import Shot
    from hfb.typing import Array, Float

_SAID_EVERY_S = 0.25


class ExportsHandle(Record):
    """Files for other programs and for people, each under the name that it is published by.

    Attributes:
        files: the files.
        left_out: why a format has no file, one sentence each.
        world: that of the motion files.
    """

    files: tuple[FileHandle, ...]
    left_out: tuple[str, ...] = ()
    world: WorldFacts | None = None

    def facts(self) -> dict[str, object]:
        """Return the world of the motion files, and how far feet slide in it, for result.json."""
        return self.world.entries() if self.world else {}

    def by_name(self) -> dict[str, FileHandle]:
        """Return name -> file."""
        return {file.path.name: file for file in self.files}


class ShotHandle(Record):
    """Everything that films of a result are rendered from.

    Attributes:
        clip: all frames of the clip: the motion names them by their numbers.
        motion: of the whole clip.
        texture: an .npz with the ``texture`` of the person, in the clip's light.
        body: the user's body model; None for the embedded one.
        config: options of the fit.
    """

    clip: ClipHandle
    motion: FileHandle
    texture: FileHandle
    body: FileHandle | None
    config: FitConfig

    def load(self) -> Shot:
        """Read the files; frames are read when they are drawn."""
        from hfb.motion.motion_file import load_motion
        from hfb.rendering.backends import make_rasterizer
        from hfb.report.films.slow_motion import Shot
        from hfb.tasks.core.scene import load_camera, load_chosen_body, load_image, load_texture

        clip = self.clip
        return Shot(
            motion=load_motion(self.motion.path)[0],
            body=load_chosen_body(self.body),
            texture=load_texture(self.texture),
            rasterizer=make_rasterizer("coverage", self.config.rasterizer, self.config.threads),
            camera=load_camera(clip),
            plate_linear=load_image(clip.background, clip),
            frame_linear=lambda number: load_image(clip.frames[number], clip),
            light=clip.light,
        )


@task("motion files", where="worker")
def write_motion_files(
    *,
    motion: FileHandle,
    texture: FileHandle | None,
    body: FileHandle | None,
    plate: ClipHandle,
    config: ExportConfig,
    folder: Path,
) -> ExportsHandle:
    """Write motion files (`hfb.interop.writers`); a format that cannot hold the motion is left out.

    Args:
        motion: the motion.
        texture: the person's texture as an image.
        body: the user's body model; None for the embedded one.
        plate: the clip; its frames are not read.
        config: which formats.
        folder: where the files go.
    """
    from hfb.interop.writers.export_world import describe_world
    from hfb.interop.writers.exported import Exported
    from hfb.interop.writers.motion_exports import write_motion_file
    from hfb.motion.motion_file import load_motion
    from hfb.tasks.core.scene import load_chosen_body

    moving, space = load_motion(motion.path)
    exported = Exported(
        moving,
        cast("BetasSpace", space),
        load_chosen_body(body) if set(config.formats) & set(NEEDS_BODY) else None,
        texture.path.read_bytes() if texture else None,
        config.amass_rate,
        config.csv_frame,
        config.fps,
        PLATE,
    )
    files, left_out = [], []
    for form in dict.fromkeys(config.formats):
        try:
            files.append(FileHandle.of(write_motion_file(folder, form, exported)))
        except InputError as error:  # the motion is found: a format that cannot hold it does not keep it back
            left_out.append(f"there is no {FILE_NAMES[form]}: {error}")
    if {FILE_NAMES[form] for form in NEEDS_BODY} & {file.path.name for file in files}:
        files.append(FileHandle.of(write_plate(plate, folder / PLATE)))
    return ExportsHandle(files=tuple(files), left_out=tuple(left_out), world=describe_world(moving))


def write_plate(clip: ClipHandle, path: Path) -> Path:
    """Write a clip's background as an sRGB image without distortion.

    Args:
        clip: the clip; its frames are not read.
        path: the file.
    """
    from PIL import Image, PngImagePlugin

    from hfb.photometry import linear_to_srgb
    from hfb.tasks.core.scene import load_image

    plate = load_image(clip.background, clip).clamp(0, 1)
    shown = (linear_to_srgb(plate) if clip.light == "linear" else plate).mul(255).round().byte()
    marked = PngImagePlugin.PngInfo()
    marked.add_text("Software", "hfb")  # else it may be the user's own file, byte for byte, which no result removes
    encoded = io.BytesIO()
    Image.fromarray(shown.numpy()).save(encoded, "PNG", pnginfo=marked)
    write_bytes_atomic(path, encoded.getvalue())
    return path


def export_motion(shot: ShotHandle, texture: FileHandle, config: ExportConfig, folder: Path) -> ExportsHandle:
    """Write the formats and films of the options, and print which formats are left out.

    Args:
        shot: motion, body, plate and frames.
        texture: the person's texture as an image.
        config: which formats and films.
        folder: where the files go.
    """
    written = write_motion_files(
        motion=shot.motion,
        texture=texture,
        body=shot.body,
        plate=shot.clip.model_copy(update={"frames": ()}),  # they would be sent to a worker elsewhere
        config=config,
        folder=folder,
    )
    world = written.world if config.formats else None
    doubts = (world.says,) if world and (world.doubtful or world.floor) else ()
    for reason in (*written.left_out, *doubts):
        progress.say(f"hfb: {reason}")
    films = tuple(dict.fromkeys(config.films))
    with ThreadPoolExecutor(thread_name_prefix="hfb-film") as pool:
        drawn = [pool.submit(copy_context().run, draw_film, shot, film, folder) for film in films]
        return written.model_copy(update={"files": (*written.files, *(one.result() for one in drawn))})


@task("film", where="worker")
def draw_film(shot: ShotHandle, film: Film, folder: Path) -> FileHandle:
    """Draw one film, in a worker where there are some: a clip's films need more memory than all else of a command.

    Args:
        shot: motion, body, plate and frames.
        film: which, see `hfb.report.films.slow_motion`.
        folder: where it goes.
    """
    return FileHandle.of(write_film(film, shot.load(), folder))


def write_film(film: Film, shot: Shot, folder: Path) -> Path:
    """Draw one film, with progress.

    Args:
        film: which.
        shot: motion, body, plate and frames.
        folder: where it goes.
    """
    from hfb.io.media.video.video_writing import VideoWriter
    from hfb.report.films import slow_motion

    path = folder / FILM_NAMES[film]
    slow = slow_motion.film_slow_factor(shot.motion)
    rate = slow_motion.overlay_rate(shot.motion) if film == "overlay" else float(slow_motion.FILM_FPS)
    true_times = film == "exact"
    comment = (
        "one picture per sub-frame, shown at its true time" if true_times else f"hfb {film}, {slow:g} times slower"
    )
    with VideoWriter(path, None if true_times else rate, comment, to_look_at=True) as writer:
        total = slow_motion.picture_count(shot.motion, film)
        for time_s, image in with_progress(film, _film_images(film, shot), total):
            writer.write(image, time_s)
    return path


def with_progress(
    label: str, images: Iterator[tuple[float | None, Float[Array, "Y X 3"]]], total: int
) -> Iterator[tuple[float | None, Float[Array, "Y X 3"]]]:
    """Yield the (time, image) pairs of a film, and report progress.

    Args:
        label: of the film.
        images: the pairs.
        total: their number.
    """
    said = 0.0
    for number, image in enumerate(images, 1):
        if time.monotonic() - said > _SAID_EVERY_S or number == total:
            said = time.monotonic()
            progress.advance(number, total, label)
        yield image


def _film_images(film: Film, shot: Shot) -> Iterator[tuple[float | None, Float[Array, "Y X 3"]]]:
    from hfb.report.films import slow_motion

    if film == "exact":
        yield from slow_motion.exact_sub_frames(shot)
        return
    for image in slow_motion.overlay(shot) if film == "overlay" else slow_motion.slow_motion(shot):
        yield None, image
