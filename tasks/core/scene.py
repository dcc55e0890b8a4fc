"""From handles to the method's input: images in linear light, mattes, camera, body and texture.

A chain's tasks need the same frames repeatedly. Each process caches decoded images by content, so that a frame is
decoded and linearised once; a task gets its own copy.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from hfb.body.assets import load_body
from hfb.body.model import Body
from hfb.geometry.camera import PinholeCamera
from hfb.io.media.images.image_decoding import Picture, decode_picture
from hfb.io.media.images.image_io import read_matte
from hfb.matting.exposure_match import NO_GAIN, in_plate_exposure
from hfb.photometry import Transfer, as_srgb, linear_to_srgb, srgb_to_linear
from hfb.rendering.observation import Observation
from hfb.tasks.core.handles import ClipHandle, FileHandle, FrameHandle, verify_unchanged
from hfb.typing import Array

Light = Literal["srgb", "linear"]

_LIMIT_BYTES = 256 << 20
_ALWAYS = 3  # frame, plate and matte of one photograph, however large


class DecodedImages:
    """A least-recently-used cache of images with a limit in bytes. Thread-safe."""

    def __init__(self, limit_bytes: int, always: int) -> None:
        """Begin empty.

        Args:
            limit_bytes: of all images together.
            always: how many are kept even if they are larger.
        """
        self._limit_bytes, self._always = limit_bytes, always
        self._images: OrderedDict[tuple[str, ...], Tensor] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, key: tuple[str, ...], decode: Callable[[], Tensor]) -> Tensor:
        """Return the image of a key, decoded unless it is cached. It must not be changed.

        Args:
            key: content and light.
            decode: makes the image.
        """
        with self._lock:
            if key in self._images:
                self._images.move_to_end(key)
                return self._images[key]
        image = decode()
        self.put(key, image)
        return image

    def put(self, key: tuple[str, ...], image: Tensor) -> None:
        """Cache an image; the least recently used ones are dropped.

        Args:
            key: content and light.
            image: (H, W, 3).
        """
        with self._lock:
            if key in self._images:
                return
            self._images[key] = image
            self._bytes += image.nbytes
            while self._bytes > self._limit_bytes and len(self._images) > self._always:
                _, oldest = self._images.popitem(last=False)
                self._bytes -= oldest.nbytes


_kept = DecodedImages(_LIMIT_BYTES, _ALWAYS)


def decode_once(file: FileHandle, transfer: Transfer, light: Light) -> tuple[Picture, Tensor]:
    """Decode a user's image with its metadata; `load_image` then takes it from the cache.

    Args:
        file: the image.
        transfer: how it stores light.
        light: in which blur is averaged.

    Returns:
        the image as stored, and in that light; the latter must not be changed.

    Raises:
        StaleFile: the file does not match its handle, before or after.
        InputError: it cannot be decoded.
    """
    with verify_unchanged(file):
        found = decode_picture(file.path, transfer)
    image = in_light(found.pixels, transfer, light)
    _kept.put(_key(file, transfer, light), image)
    return found, image


def load_image(picture: FileHandle, clip: ClipHandle) -> Tensor:
    """Return an image (H, W, 3) in the light in which the clip's blur is averaged, in the background's exposure.

    Args:
        picture: one of the clip's frames, or its background.
        clip: says how light is stored and averaged.
    """
    return _shared_image(picture, clip).clone()


def load_mattes(mattes: Sequence[FileHandle]) -> Tensor:
    """Return the person's share (T, H, W) of each pixel.

    Args:
        mattes: one per frame.
    """
    return torch.stack([_shared_matte(matte) for matte in mattes])


def in_light(picture: Array, transfer: Transfer, light: Light) -> Tensor:
    """Return an image (H, W, 3) in the light in which blur is averaged.

    Args:
        picture: as stored.
        transfer: how it is stored.
        light: in which blur is averaged.
    """
    stored = torch.from_numpy(as_srgb(picture, transfer))
    if transfer == "linear":
        return stored if light == "linear" else linear_to_srgb(stored)
    return srgb_to_linear(stored) if light == "linear" else stored


def match_plate(image: Tensor, plate: Tensor, gain: tuple[float, float, float], light: Light) -> Tensor:
    """Return a frame in the exposure of its background.

    Args:
        image: the frame (H, W, 3).
        plate: the background.
        gain: of the frame over the background, per channel of linear light.
        light: of both images.
    """
    if gain == NO_GAIN:
        return image
    if light == "linear":
        return torch.from_numpy(in_plate_exposure(image.numpy(), plate.numpy(), gain))
    seen, there = (srgb_to_linear(one).numpy() for one in (image, plate))
    return linear_to_srgb(torch.from_numpy(in_plate_exposure(seen, there, gain)))


def load_camera(clip: ClipHandle) -> PinholeCamera:
    """Return the clip's camera.

    Args:
        clip: with K [px].
    """
    camera = PinholeCamera.from_matrix(torch.tensor(clip.K, dtype=torch.float64), clip.height, clip.width)
    if clip.readout is None:
        return camera
    return camera.with_readout(clip.readout.seconds / clip.exposure_s, clip.readout.to)


def load_observation(clip: ClipHandle, mattes: Sequence[FileHandle]) -> Observation:
    """Return the whole clip with its mattes.

    Args:
        clip: the frames.
        mattes: one per frame.
    """
    return Observation(
        frames_linear=torch.stack([_shared_image(frame, clip) for frame in clip.frames]),
        plate_linear=load_image(clip.background, clip),
        mattes=load_mattes(mattes),
        camera=load_camera(clip),
        exposure_s=clip.exposure_s,
        interval_s=clip.interval_s,
        light=clip.light,
    )


def load_chosen_body(body: FileHandle | None) -> Body:
    """Return the user's body model, or the embedded one.

    Args:
        body: the user's file, or None.
    """
    return load_body(body.path) if body else _embedded_body()


@lru_cache
def _embedded_body() -> Body:
    """Return one object per process: templates of silhouettes are kept per body. It must not be changed."""
    return load_body(None)


def load_texture(texture: FileHandle) -> Tensor:
    """Return the fitted texture (A, A, 3) in the clip's light.

    Args:
        texture: an .npz with ``texture``.
    """
    with np.load(texture.path, allow_pickle=False) as file:
        return torch.from_numpy(file["texture"])


def _shared_image(picture: FileHandle, clip: ClipHandle) -> Tensor:
    def decode() -> Tensor:
        return decode_once(picture, clip.transfer, clip.light)[1]

    image = _kept.get(_key(picture, clip.transfer, clip.light), decode)
    if not isinstance(picture, FrameHandle) or picture.gain == NO_GAIN:
        return image
    key = (*_key(picture, clip.transfer, clip.light), clip.background.sha256, *map(str, picture.gain))
    return _kept.get(key, lambda: match_plate(image, _shared_image(clip.background, clip), picture.gain, clip.light))


def _shared_matte(matte: FileHandle) -> Tensor:
    def decode() -> Tensor:
        with verify_unchanged(matte):
            return torch.from_numpy(read_matte(matte.path))

    return _kept.get((matte.sha256, "matte"), decode)


def _key(file: FileHandle, transfer: Transfer, light: Light) -> tuple[str, ...]:
    return file.sha256, transfer, light
