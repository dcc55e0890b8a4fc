"""The image strip: how the fit explains each blurred frame.

input | matte | sub-frames | re-blurred | residual | the bodies from the side; one row per frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from hfb.body.model import Body
from hfb.evaluation.protocol import pose_rows
from hfb.motion.sampled import SampledMotion
from hfb.rendering.formation import compose, see_by_rows
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.report.images.shading import shade_bodies, side_view, time_colours
from hfb.typing import Array, Float, Tensor

_CELL_HEIGHT_PX, _LARGEST_WIDTH_PX = 256, 384
_SHOWN_SUBFRAMES = 5
_RESIDUAL_GAIN = 2.0
_CAPTION_PX, _GAP_PX = 22, 4
_NOTE_SIZE = 0.45
_PAPER = 1.0
_GHOST_OPACITIES = (0.55, 0.75, 1.0)  # first, middle, last instant


@dataclass(frozen=True)
class StripRow:
    """Images of one frame, all of one size, sRGB in [0, 1].

    Attributes:
        input_srgb: the blurred frame.
        matte: the person's share of each pixel.
        subframes: bodies over the background at some instants.
        labels: captions of ``subframes``.
        reblurred_srgb: the mean over all sub-frames, composed with the background.
        residual: re-blurred minus input, in [-1, 1].
        novel_views: first, middle and last body from the side, later ones over earlier ones.
    """

    input_srgb: Float[Array, "H W 3"]
    matte: Float[Array, "H W"]
    subframes: tuple[Float[Array, "H W 3"], ...]
    labels: tuple[str, ...]
    reblurred_srgb: Float[Array, "H W 3"]
    residual: Float[Array, "H W 3"]
    novel_views: Float[Array, "H W 3"]


def draw_strip(
    observation: Observation,
    motion: SampledMotion,
    texture: Float[Tensor, "A A 3"],
    body: Body,
    rasterizer: Rasterizer,
    note: str = "",
) -> Float[Array, "Y X 3"]:
    """Draw the whole strip, sRGB in [0, 1], cropped to the region around the mattes.

    Args:
        observation: blurred frames, plate, mattes and camera.
        motion: the fitted motion, in camera coordinates of the observation.
        texture: in the observation's light.
        body: the model that the motion's betas belong to.
        rasterizer: renders the sub-frames.
        note: a sentence written below, such as what the image cannot tell; empty for none.
    """
    left, top, width, height = observation.region()
    scale = min(_CELL_HEIGHT_PX / height, _LARGEST_WIDTH_PX / width)
    window = observation.cropped(left, top, width, height).resized(round(scale * max(height, width)))
    frames = range(observation.mattes.shape[0])
    picture = lay_out([_row(window, frame, motion, texture, body, rasterizer) for frame in frames])
    return np.concatenate([picture, _written(note, picture.shape[1])]) if note else picture


def lay_out(rows: Sequence[StripRow]) -> Float[Array, "Y X 3"]:
    """Lay rows of captioned cells out on white.

    Args:
        rows: one per frame, all of the same size.
    """
    lines = []
    for number, row in enumerate(rows, 1):
        gray = np.repeat(row.matte[..., None], 3, -1)
        cells = [row.input_srgb, gray, *row.subframes, row.reblurred_srgb]
        cells += [0.5 + _RESIDUAL_GAIN / 2 * row.residual, row.novel_views]
        name = "input" if len(rows) == 1 else f"input {number}"
        captions = [name, "matte", *row.labels, "re-blurred", f"residual x{_RESIDUAL_GAIN:.0f}", "from the side"]
        lines.append(np.concatenate([captioned(*pair) for pair in zip(cells, captions, strict=True)], 1))
    picture = np.concatenate(lines, 0)
    return picture.clip(0, 1, out=picture)


def captioned(picture: Float[Array, "H W 3"], caption: str) -> Float[Array, "Y X 3"]:
    """Put a caption above an image, with a margin to its right and below.

    Args:
        picture: sRGB in [0, 1].
        caption: text; narrow images get smaller letters.
    """
    height, width = picture.shape[:2]
    band = np.full((_CAPTION_PX, width + _GAP_PX, 3), 255, dtype=np.uint8)  # OpenCV 5 writes on 8 bits only
    size = 0.45
    while size > 0.2 and cv2.getTextSize(caption, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0] > width - 4:
        size -= 0.05  # a narrow cell gets smaller letters
    cv2.putText(band, caption, (3, 15), cv2.FONT_HERSHEY_SIMPLEX, size, (40, 40, 40), 1, cv2.LINE_AA)
    cell = np.full((height + _CAPTION_PX + _GAP_PX, width + _GAP_PX, 3), _PAPER, dtype=np.float32)
    cell[:_CAPTION_PX] = band / np.float32(255)
    cell[_CAPTION_PX : _CAPTION_PX + height, :width] = picture
    return cell


def stacked(pictures: Sequence[Float[Array, "_h _w 3"]]) -> Float[Array, "Y X 3"]:
    """Return pictures under one another, filled up with white to the widest; a small white one of none.

    Args:
        pictures: sRGB in [0, 1].
    """
    width = max((one.shape[1] for one in pictures), default=8)
    padded = [np.pad(one, ((0, 0), (0, width - one.shape[1]), (0, 0)), constant_values=1) for one in pictures]
    return np.concatenate(padded) if padded else np.ones((8, 8, 3), np.float32)


def _written(note: str, width: int) -> Float[Array, "Y X 3"]:
    """Draw text as an image of this width."""
    lines, words = [""], note.split()
    for word in words:
        longer = f"{lines[-1]} {word}".strip()
        fits = cv2.getTextSize(longer, cv2.FONT_HERSHEY_SIMPLEX, _NOTE_SIZE, 1)[0][0] <= width - 6
        lines = [*lines[:-1], longer] if fits else [*lines, word]
    band = np.full((_CAPTION_PX * len(lines), width, 3), 255, dtype=np.uint8)
    for number, line in enumerate(lines):
        place = (3, _CAPTION_PX * number + 15)
        cv2.putText(band, line, place, cv2.FONT_HERSHEY_SIMPLEX, _NOTE_SIZE, (40, 40, 40), 1, cv2.LINE_AA)
    return band / np.float32(255)


def _row(
    window: Observation,
    frame: int,
    motion: SampledMotion,
    texture: Float[Tensor, "A A 3"],
    body: Body,
    rasterizer: Rasterizer,
) -> StripRow:
    """Render one frame's images in the window's camera."""
    vertices = pose_rows(motion, motion.rows_of(frame), body).vertices
    count = len(vertices)
    with torch.no_grad():
        blurred = rasterizer.render_mean(see_by_rows(vertices, window.camera), texture, window.camera, body.mesh)
    reblurred = window.to_srgb(compose(blurred, window.plate_linear))
    seen = window.to_srgb(window.frames_linear[frame])

    shown = sorted({round(float(k)) for k in np.linspace(0, count - 1, _SHOWN_SUBFRAMES)})
    colours = time_colours(count)
    clay = shade_bodies(vertices[shown], colours[shown], window.camera, body.mesh, rasterizer)
    faded = 0.35 * window.to_srgb(window.plate_linear) + 0.65 * _PAPER
    return StripRow(
        input_srgb=seen.numpy(),
        matte=window.mattes[frame].numpy(),
        subframes=tuple((picture[..., :3] + (1 - picture[..., 3:]) * faded).numpy() for picture in clay),
        labels=tuple(f"{k + 1}/{count}" for k in shown),
        reblurred_srgb=reblurred.numpy(),
        residual=(reblurred - seen).numpy(),
        novel_views=_ghosts(vertices, colours, window, body, rasterizer).numpy(),
    )


def _ghosts(
    vertices: Float[Tensor, "S V 3"],
    colours: Float[Tensor, "S 3"],
    window: Observation,
    body: Body,
    rasterizer: Rasterizer,
) -> Float[Tensor, "H W 3"]:
    """Render the first, middle and last body from the side, earlier ones transparent."""
    chosen = [0, (len(vertices) - 1) // 2, len(vertices) - 1]
    picture = torch.full_like(window.plate_linear, _PAPER)
    turned, camera = side_view(vertices[chosen], *picture.shape[:2])
    for clay, opacity in zip(
        shade_bodies(turned, colours[chosen], camera, body.mesh, rasterizer), _GHOST_OPACITIES, strict=True
    ):
        picture = opacity * clay[..., :3] + (1 - opacity * clay[..., 3:]) * picture
    return picture
