"""Find the inputs of a recorded run again by their content: to repeat it, or to draw films of its result."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hfb.config import FitConfig, RunConfig
from hfb.errors import InputError
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.inputs.inputs import Inputs
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.results.stored_runs import fetch_file, find_run, readable_store
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking.hidden_options import for_pictures
from hfb.tasks.tracking.recipe import RECIPE, GivenFile, Recipe, read_recipe, recipe_config, recipe_inputs

if TYPE_CHECKING:
    from torch import Tensor

    from hfb.body.model import Body
    from hfb.geometry.camera import PinholeCamera
    from hfb.io.media.footage import Footage
    from hfb.motion.sampled import SampledMotion
    from hfb.report.films.slow_motion import Shot
    from hfb.typing import Array

_PICTURES = ("frame_", "background", "video", "calibration")
"""Roles of files that images come from; networks, priors and truths are not needed to draw a result."""

_FAR = 60


@dataclass(frozen=True)
class SeenImages:
    """Camera, plate and frames of a recorded run.

    Attributes:
        plate_linear: (H, W, 3), in the same light.
        frame_linear: returns a blurred frame by its number in the motion, in ``light``.
    """

    camera: PinholeCamera
    plate_linear: Tensor
    frame_linear: Callable[[int], Tensor]
    light: Literal["srgb", "linear"]


@contextmanager
def reload_images(run_words: str, inputs_folder: Path | None = None) -> Iterator[SeenImages]:
    """Provide the images of a recorded run inside the block.

    Args:
        run_words: a run's id, the beginning of it, or its result's folder.
        inputs_folder: where to look for images that were moved; they are recognised by their content.

    Raises:
        InputError: the run was not recorded, or its images are gone or were changed.
    """
    run = find_run(run_words)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        with readable_store():
            path = fetch_file(run, RECIPE, folder)
        if path is None:
            raise InputError(
                f"run {run.title} does not say which pictures it was made from: only runs of `hfb fit`, `hfb demo` and "
                "`hfb video` of this version on do; run its own command again with --export.films"
            )
        recipe = for_pictures(read_recipe(path, run.title), run.title)
        places = locate_inputs(
            {role: file for role, file in recipe.files.items() if role.startswith(_PICTURES)}, inputs_folder
        )
        config = recipe_config(recipe, places, run.title)
        yield (_of_fit if recipe.command == "fit" else _of_video)(recipe, config, places, run=run.title, folder=folder)


@contextmanager
def reload_shot(
    run_words: str, inputs_folder: Path | None, *, motion: SampledMotion, body: Body, texture: Path
) -> Iterator[Shot]:
    """Provide everything that films of a recorded run are rendered from inside the block.

    Args:
        run_words: a run's id, the beginning of it, or its result's folder.
        inputs_folder: where to look for images that were moved.
        motion: of the result.
        body: that was fitted.
        texture: an image file of the fitted texture.

    Raises:
        InputError: see `reload_images`.
    """
    from hfb.io.media.images.image_io import read_picture_srgb
    from hfb.rendering.backends import make_rasterizer
    from hfb.report.films.slow_motion import Shot
    from hfb.tasks.core.scene import in_light

    drawing = FitConfig()  # wherever the result was computed, this machine has the default
    with reload_images(run_words, inputs_folder) as seen:
        yield Shot(
            motion=motion,
            body=body,
            texture=in_light(read_picture_srgb(texture), "srgb", seen.light),
            rasterizer=make_rasterizer("coverage", drawing.rasterizer, drawing.threads),
            camera=seen.camera,
            plate_linear=seen.plate_linear,
            frame_linear=seen.frame_linear,
            light=seen.light,
        )


def _of_fit(recipe: Recipe, config: RunConfig, places: dict[str, Path], *, run: str, folder: Path) -> SeenImages:
    from hfb.tasks.core.scene import load_camera, load_image
    from hfb.tasks.image.prepare import prepare

    inputs = recipe_inputs(Inputs, recipe, places, run)
    clip = prepare.fn(
        frames=inputs.frames,
        background=inputs.background,
        clip=inputs.clip,
        camera=config.camera,
        exposure=config.exposure,
    )
    return SeenImages(
        load_camera(clip),
        load_image(clip.background, clip),
        lambda number: load_image(clip.frames[number], clip),
        clip.light,
    )


def _of_video(recipe: Recipe, config: RunConfig, places: dict[str, Path], *, run: str, folder: Path) -> SeenImages:
    from hfb.io.media.images.image_io import read_picture_srgb
    from hfb.tasks.core.scene import in_light, load_camera
    from hfb.tasks.video.video_clip import find_background, load_footage, look_at_clip

    inputs = recipe_inputs(VideoInputs, recipe, places, run)
    seen = look_at_clip.fn(
        inputs=inputs, average=config.video.average, camera=config.camera, exposure=config.exposure, folder=folder
    )
    plate = find_background.fn(seen, inputs.plate, inputs.background, folder)
    frames = _InOrder(load_footage(seen))
    return SeenImages(
        load_camera(seen.clip((), plate)),
        in_light(read_picture_srgb(plate.path), seen.transfer, seen.light),
        lambda number: in_light(frames.picture(number), seen.transfer, seen.light),
        seen.light,
    )


class _InOrder:
    """Sequential access to frames: a video is decoded once, not once per frame."""

    def __init__(self, footage: Footage) -> None:
        self._footage = footage
        self._next, self._frames = 0, footage.frames()

    def picture(self, number: int) -> Array:
        """Return a frame (H, W, 3), as the footage stores light.

        Args:
            number: of the frame.
        """
        if not self._next <= number < self._next + _FAR:
            self._next, self._frames = number, self._footage.frames(number)
        while self._next < number:
            next(self._frames)
            self._next += 1
        self._next += 1
        return next(self._frames)


def locate_inputs(files: Mapping[str, GivenFile], folder: Path | None) -> dict[str, Path]:
    """Return sha256 -> path of every file, at its old place or anywhere below a folder.

    Args:
        files: by role, such as ``frame_0``.
        folder: where to look for files that were moved; None for their old places alone.

    Raises:
        InputError: some are gone or were changed; the sentence names them, and how to point at moved ones.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"{folder} is no folder: give the one that holds the run's inputs with --inputs")
    found: dict[str, Path] = {}
    missing: dict[str, str] = {}
    for number, (role, file) in enumerate(files.items()):
        progress.advance(number, len(files))
        state = _state(file)
        if state is None:
            found[file.sha256] = file.path
        else:
            missing[role] = f"{role} ({file.path}) {state}"
    if folder is not None and missing:
        found |= _below(folder, [files[role] for role in missing])
    left = [words for role, words in missing.items() if files[role].sha256 not in found]
    if left:
        shown = ", ".join(left[:5]) + (f" and {len(left) - 5} more" if len(left) > 5 else "")
        where = f"nor is it in {folder}: " if folder is not None and len(left) == 1 else ""
        where = where or (f"nor are they in {folder}: " if folder is not None else "")
        raise InputError(f"{shown}; {where}point at the folder that holds the same files with --inputs DIR")
    return found


def _state(file: GivenFile) -> str | None:
    """Return what is wrong with a file at its old place; None where nothing is."""
    try:
        if file.path.stat().st_size == file.bytes and sha256_of(file.path) == file.sha256:
            return None
    except FileNotFoundError:
        return "is gone"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return "was changed"


def _below(folder: Path, files: list[GivenFile]) -> dict[str, Path]:
    """Return the files that lie somewhere in a folder; only files of a wanted size are read."""
    wanted: dict[int, set[str]] = defaultdict(set)
    for file in files:
        wanted[file.bytes].add(file.sha256)
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        try:
            sought = wanted[path.stat().st_size] - found.keys() if path.is_file() else set()
            sha256 = sha256_of(path) if sought else ""
        except OSError:  # not ours to read
            continue
        if sha256 in sought:
            found[sha256] = path.resolve()
    return found
