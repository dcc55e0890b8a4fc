"""The pictures that an earlier result was made from, found again by its recorded recipe: for films drawn later."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hfb.config import FitConfig, RunConfig
from hfb.errors import InputError
from hfb.tasks.core.handles import ClipHandle
from hfb.tasks.inputs.inputs import Inputs
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.results.present_files import find_present
from hfb.tasks.results.stored_runs import fetch_file, find_run, readable_store
from hfb.tasks.tracking.hidden_options import for_pictures
from hfb.tasks.tracking.recipe import RECIPE, Recipe, read_recipe, recipe_config, recipe_inputs

if TYPE_CHECKING:
    from torch import Tensor

    from hfb.body.model import Body
    from hfb.geometry.camera import PinholeCamera
    from hfb.io.media.footage import Footage
    from hfb.motion.sampled import SampledMotion
    from hfb.report.slow_motion import Shot
    from hfb.tasks.core.video_handles import FootageHandle
    from hfb.typing import Array

_PICTURES = ("frame_", "background", "video", "calibration")
"""Roles of the files that pictures come from; networks, priors and truths are not needed to look at a result."""

_FAR = 60


@dataclass(frozen=True)
class Pictures:
    """What was seen.

    Attributes:
        frame_linear: the blurred picture of a frame, by the motion's number for it, in ``light``.
        plate_linear: (H, W, 3), in the same light.
    """

    camera: PinholeCamera
    plate_linear: Tensor
    frame_linear: Callable[[int], Tensor]
    light: Literal["srgb", "linear"]


@contextmanager
def pictures_of(run_words: str, inputs_folder: Path | None = None) -> Iterator[Pictures]:
    """The pictures of a recorded run, for as long as they are needed.

    Args:
        run_words: a run's id, the beginning of it, or its result's folder.
        inputs_folder: where to look for pictures that are no longer where they were; they are told by their content.

    Raises:
        InputError: the run was not recorded, or its pictures are gone or were changed.
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
        places = find_present(
            {role: file for role, file in recipe.files.items() if role.startswith(_PICTURES)}, inputs_folder
        )
        config = recipe_config(recipe, places, run.title)
        yield (_of_fit if recipe.command == "fit" else _of_video)(recipe, config, places, run.title, folder)


@contextmanager
def earlier_shot(
    run_words: str, inputs_folder: Path | None, motion: SampledMotion, body: Body, texture: Path
) -> Iterator[Shot]:
    """What films of a recorded run are drawn from, for as long as they are.

    Args:
        texture: the fitted texture's picture.

    Raises:
        InputError: see `pictures_of`.
    """
    from hfb.io.media.pictures import read_picture_srgb
    from hfb.rendering.backends import make_rasterizer
    from hfb.report.slow_motion import Shot
    from hfb.tasks.core.scene import in_light

    drawing = FitConfig()  # wherever the result was computed, this machine has the default
    with pictures_of(run_words, inputs_folder) as seen:
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


def _of_fit(recipe: Recipe, config: RunConfig, places: dict[str, Path], run: str, _folder: Path) -> Pictures:
    from hfb.tasks.core.scene import load_camera, load_picture
    from hfb.tasks.image.prepare import prepare

    inputs = recipe_inputs(Inputs, recipe, places, run)
    clip: ClipHandle = prepare.fn(inputs.frames, inputs.background, inputs.clip, config.camera, config.exposure)
    return Pictures(
        load_camera(clip),
        load_picture(clip.background, clip),
        lambda number: load_picture(clip.frames[number], clip),
        clip.light,
    )


def _of_video(recipe: Recipe, config: RunConfig, places: dict[str, Path], run: str, folder: Path) -> Pictures:
    from hfb.io.media.pictures import read_picture_srgb
    from hfb.tasks.core.scene import in_light, load_camera
    from hfb.tasks.video.video_clip import find_background, load_footage, look_at_clip

    inputs = recipe_inputs(VideoInputs, recipe, places, run)
    seen: FootageHandle = look_at_clip.fn(inputs, config.video.average, config.camera, config.exposure, folder)
    plate = find_background.fn(seen, inputs.plate, inputs.background, folder)
    frames = _InOrder(load_footage(seen))
    return Pictures(
        load_camera(seen.clip((), plate)),
        in_light(read_picture_srgb(plate.path), seen.transfer, seen.light),
        lambda number: in_light(frames.picture(number), seen.transfer, seen.light),
        seen.light,
    )


class _InOrder:
    """Frames that are asked for one after another: a video is decoded once, not once per frame."""

    def __init__(self, footage: Footage) -> None:
        self._footage = footage
        self._next, self._frames = 0, footage.frames()

    def picture(self, number: int) -> Array:
        """(H, W, 3), as the footage stores light."""
        if not self._next <= number < self._next + _FAR:
            self._next, self._frames = number, self._footage.frames(number)
        while self._next < number:
            next(self._frames)
            self._next += 1
        self._next += 1
        return next(self._frames)
