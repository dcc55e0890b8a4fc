"""The scenery of a synthetic image: background, texture of the body, and light."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch

from hfb.body.model import Body
from hfb.datasets.synthetic.backgrounds import room_background
from hfb.datasets.synthetic.clothed import vertex_normals
from hfb.datasets.synthetic.textures import clothes_texture
from hfb.errors import InputError
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.rendering.texels import fill_texture_gutter, texel_faces
from hfb.typing import Array, Float, Tensor

TEXTURE_PX = 512
_ENDINGS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp"})
_CROP, _SATURATION = (0.6, 1.0), (0.5, 0.95)
_BRIGHT_ROOM = 0.25
"""Mean linear light of a plate under which a texture's colours need no correction."""
_FROM_ABOVE = 0.35
"""Share of the light that comes from above: it falls on the rest body and is part of the texture."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """Everything that a case's images show besides the motion.

    Attributes:
        plate_linear: the clean background.
        texture_linear: texture of the person, (512, 512).
        background: name of the background's file, or "generated".
        texture: name of the texture's file, or "generated".
        light: factor by which the room's light changed the texture.
        skipped: images that could not be read, with the reason.
    """

    plate_linear: Float[Tensor, "H W 3"]
    texture_linear: Float[Tensor, "A A 3"]
    background: str
    texture: str
    light: float
    skipped: dict[str, str] = field(default_factory=dict)


def draw_scenery(
    backgrounds: Path | None, textures: Path | None, body: Body, size_px: int, rng: np.random.Generator
) -> Scenery:
    """Draw a random background and a texture of a person in its light.

    Args:
        backgrounds: folder of images, searched with its subfolders; generated where not given.
        textures: folder of images, likewise.
        body: model whose texture coordinates are used.
        size_px: side of the square background.
        rng: draws the choice.

    Raises:
        InputError: a folder holds no image that can be read.
    """
    for_plate, for_texture = rng.spawn(2)
    skipped: dict[str, str] = {}
    if backgrounds is None:
        plate_srgb, background = room_background(size_px, size_px, for_plate).astype(np.float32), "generated"
        plate = torch.from_numpy(srgb_to_linear(plate_srgb))
    else:
        picture, background = _draw_picture(backgrounds, for_plate, skipped)
        plate = torch.from_numpy(_crop(picture, size_px, for_plate))
    if textures is None:
        texture, drawn = _muted(clothes_texture(body, TEXTURE_PX, for_texture), for_texture), "generated"
        texture = texture * _light_from_above(body)
    else:
        picture, drawn = _draw_picture(textures, for_texture, skipped)
        texture = _as_texture(picture, body)
    light = float(np.clip(np.sqrt(float(plate.mean()) / _BRIGHT_ROOM), 0.4, 1.15))
    return Scenery(plate, (texture * light).clamp(0, 1), background, drawn, light, skipped)


def _draw_picture(folder: Path, rng: np.random.Generator, skipped: dict[str, str]) -> tuple[Float[Array, "h w 3"], str]:
    """Draw a random image of a folder and return it with its name; damaged ones are skipped and recorded."""
    names = _pictures_in(folder)
    reasons: dict[str, str] = {}
    for index in rng.permutation(len(names)):
        try:
            picture = read_picture_srgb(folder / names[index])
        except InputError as error:
            reasons[names[index]] = str(error)
            continue
        skipped.update(reasons)
        return picture, names[index]
    reason = f" (the first: {next(iter(reasons.values()))})" if reasons else ""
    raise InputError(f"{folder} holds no picture that can be read{reason}; give a folder of PNG or JPEG files")


@lru_cache(maxsize=8)
def _pictures_in(folder: Path) -> tuple[str, ...]:
    """Return relative paths of image files, in an order that does not depend on the file system."""
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; give a folder of PNG or JPEG files")
    found = (path for path in folder.rglob("*") if path.suffix.lower() in _ENDINGS and path.is_file())
    return tuple(sorted(path.relative_to(folder).as_posix() for path in found))


def _crop(picture_srgb: Float[Array, "h w 3"], size_px: int, rng: np.random.Generator) -> Float[Array, "H W 3"]:
    """Return a random square of an image at the wanted size, averaged in linear light."""
    height, width = picture_srgb.shape[:2]
    side = max(int(min(height, width) * rng.uniform(*_CROP)), 1)
    top, left = (int(rng.integers(0, room + 1)) for room in (height - side, width - side))
    return _resize(srgb_to_linear(picture_srgb[top : top + side, left : left + side]), size_px)


def _resize(picture_linear: Float[Array, "h w 3"], size_px: int) -> Float[Array, "H W 3"]:
    smaller = size_px < max(picture_linear.shape[:2])
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    picture = cv2.resize(np.ascontiguousarray(picture_linear), (size_px, size_px), interpolation=how)
    return np.clip(picture, 0, 1, dtype=np.float32)


def _as_texture(picture_srgb: Float[Array, "h w 3"], body: Body) -> Float[Tensor, "A A 3"]:
    linear = torch.from_numpy(_resize(srgb_to_linear(picture_srgb), TEXTURE_PX))
    return fill_texture_gutter(linear, texel_faces(body.mesh, TEXTURE_PX))


def _muted(texture_linear: Float[Tensor, "A A 3"], rng: np.random.Generator) -> Float[Tensor, "A A 3"]:
    """Desaturate generated clothes, whose colours are those of felt pens, to those of cloth."""
    gray = texture_linear.mean(-1, keepdim=True)
    return gray + float(rng.uniform(*_SATURATION)) * (texture_linear - gray)


@lru_cache(maxsize=2)
def _light_from_above(body: Body) -> Float[Tensor, "A A 1"]:
    """Return the light at each texel of a body in a room: most from above, some from everywhere."""
    corners = vertex_normals(body)[body.mesh.faces.numpy()][..., 1].mean(1)
    owner = texel_faces(body.mesh, TEXTURE_PX)
    upward = np.append(corners, 0.0)[owner.numpy()]  # the void has index -1: no direction
    light = torch.from_numpy((1 + _FROM_ABOVE * np.clip(upward, -1, 1)).astype(np.float32))[..., None]
    return fill_texture_gutter(light.expand(-1, -1, 3), owner)[..., :1].contiguous()


def to_file_and_back(plate_linear: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W 3"]:
    """Round the plate to an 8-bit sRGB file's values.

    Args:
        plate_linear: linear light.
    """
    return srgb_to_linear((linear_to_srgb(plate_linear.clamp(0, 1)) * 255).round() / 255)
