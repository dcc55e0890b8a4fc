"""A user's own matting network: BackgroundMattingV2, the paper's, or Robust Video Matting; TorchScript or ONNX."""

from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch

from hfb.config import MattingConfig
from hfb.errors import InputError
from hfb.io.array_files import weights_file
from hfb.matting.matting_protocol import LEAST_SHARE, Matting, Picture, Plate, check_sizes, nobody_found, shrink
from hfb.matting.user_networks.bgmv2_network import MattingNetwork, network_of
from hfb.networks.network_files import holds_weights, is_onnx
from hfb.networks.runtimes import Given, Network, Outputs, PictureTooSmall, TorchNetwork, load_network
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

_MULTIPLE_PX = 4
_LONGEST_PX = 4096
"""Larger frames are matted at this size: a matte is compared at 256 px at most, and memory stays bounded."""
_TILES_SHARE = 0.125
"""Overlap of neighbouring tiles, as a share of a tile."""
_COARSE_PX = 480
"""Longer side of BackgroundMattingV2's first pass: 1/4 of an HD frame, as its authors recommend."""
_COARSE_SCALES = (0.125, 0.5)
_REFINED_PIXELS = 80_000
"""Number of refined pixels at HD and below, as its authors recommend; larger images have the same share (4K:
320,000)."""
_REFINED_SHARE = _REFINED_PIXELS / (1920 * 1080)
_MOST_ENLARGED = 8
"""A network whose file fixes the number of refined pixels fails on a small image, which is then shown larger."""
_RVM_PX = 512
_RVM_LOOKS = 4
"""Number of times a recurrent network sees the same frame: frames are computed in parallel, independently."""

_Pictures = tuple[Float[Array, "H W 3"], ...]
"""The frame, and the plate where the network sees one."""


def external_matting(config: MattingConfig) -> Matting:
    """Load the user's network that the configuration names, once per process.

    Args:
        config: names the method and the network's file.

    Raises:
        InputError: no weights are given, or they cannot be used.
    """
    if config.weights is None:
        raise InputError(f"--matting {config.method} needs the network's file: give it with --matting-weights FILE")
    try:
        changed = config.weights.stat().st_mtime_ns
    except OSError:
        changed = 0
    return _loaded(config, changed)


@lru_cache(maxsize=1)
def _loaded(config: MattingConfig, changed: int) -> Matting:
    assert config.weights is not None
    if config.method == "rvm":
        return RobustVideoMatting(config.weights, config.tile_px, config.half)
    return BackgroundMattingV2(
        config.weights,
        config.backbone_scale,
        config.refine_mode,
        config.refine_pixels,
        config.refine_threshold,
        config.tile_px,
        config.half,
    )


class BackgroundMattingV2:
    """Lin et al. 2021 (MIT licence): the released .pth and .onnx files as they are, base or refined.

    A .pth of plain weights runs in our own implementation (bgmv2_network.py).
    """

    def __init__(
        self,
        path: Path,
        backbone_scale: float | None = None,
        refine_mode: str | None = None,
        refine_pixels: int | None = None,
        refine_threshold: float | None = None,
        tile_px: int | None = None,
        half: bool = False,
    ) -> None:
        """Load the network; None for an option chooses by the frame's size, or keeps the file's own.

        Args:
            path: the network's file.
            backbone_scale: size of the coarse pass relative to the image's.
            refine_mode: rule by which refined patches are chosen.
            refine_pixels: number of refined pixels.
            refine_threshold: error above which a pixel is refined.
            tile_px: larger frames are seen in tiles of this size.
            half: compute in 16 bits; not for ONNX, whose precision and options are the file's.

        Raises:
            InputError: the file cannot be used.
        """
        self._path = path
        self._scale, self._pixels, self._tile_px = backbone_scale, refine_pixels, tile_px
        own = {"refine_mode": refine_mode, "refine_threshold": refine_threshold}
        self._settings = {name: value for name, value in own.items() if value is not None}
        self._half = half
        self._networks: dict[tuple[float, int], Network] = {}
        self._factors: dict[tuple[int, ...], int] = {}
        self._weights = weights_of(path) if holds_weights(path) else None
        if self._weights is None:
            load_network(path)  # problems are reported at once

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """See `Matting`."""
        frame, plate = (_srgb(picture) for picture in (frame_linear, plate_linear))
        check_sizes(frame, plate)
        return _at_size((frame, plate), self._tile_px, lambda part: self.look(*part))

    def look(self, frame_srgb: Float[Array, "H W 3"], plate_srgb: Float[Array, "H W 3"]) -> Float[Array, "H W"]:
        """Return the network's alpha at the image's size; sides are padded to multiples of four.

        Args:
            frame_srgb: in [0, 1].
            plate_srgb: in [0, 1], in the frame's size.
        """
        height, width = frame_srgb.shape[:2]
        pictures = _padded(frame_srgb), _padded(plate_srgb)
        size = pictures[0].shape[:2]
        factor = self._factors.get(size, 1)
        while True:
            frame, plate = (_enlarged(one, factor) for one in pictures)
            try:
                outputs = self._network(*frame.shape[:2])([_planes(frame), _planes(plate)])
            except PictureTooSmall:
                if factor == _MOST_ENLARGED:
                    raise self._too_small(height, width) from None
                factor *= 2
            else:
                break
        self._factors[size] = factor
        return _reduced(_alpha(outputs, "pha", 0, frame.shape[:2]), size)[:height, :width]

    def _too_small(self, height: int, width: int) -> InputError:
        return InputError(
            f"{self._path} refines a fixed number of pixels, more than a picture of {width} x {height} px has even at "
            f"{_MOST_ENLARGED} times its size: give a larger picture, or the network's TorchScript file"
        )

    def _network(self, height: int, width: int) -> Network:
        """Return the network with coarse scale and refined pixels for an image of this size."""
        scale = self._scale or float(np.clip(_COARSE_PX / max(height, width), *_COARSE_SCALES))
        # More pixels than there are, and the network's own choice of the worst fails.
        usual = max(_REFINED_PIXELS, round(_REFINED_SHARE * height * width))
        pixels = min(self._pixels or usual, height * width)
        key = (scale, pixels)
        if key not in self._networks:
            settings = {"backbone_scale": scale, "refine_sample_pixels": pixels, **self._settings}
            if self._weights is None:
                self._networks = {key: load_network(self._path, settings, self._half)}
            else:
                for name, value in settings.items():
                    setattr(self._weights, name, value)
                self._networks = {key: TorchNetwork(self._path, self._weights, self._half)}
        return self._networks[key]


class RobustVideoMatting:
    """Lin et al. 2022 (GPL-3.0 weights) and networks with its interface; the plate is not used.

    Args:
        path: the network's file.
        tile_px: side of tiles in which larger frames are processed.
        half: compute in 16 bits.
    """

    def __init__(self, path: Path, tile_px: int | None = None, half: bool = False) -> None:
        """Load the network. Raises InputError where the file cannot be used."""
        self._network = load_network(path, half=half)
        self._tile_px = tile_px
        self._onnx = is_onnx(path)

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """See `Matting`."""
        frame = _srgb(frame_linear)
        check_sizes(frame, _srgb(plate_linear))
        return _at_size((frame,), self._tile_px, lambda part: self.look(*part))

    def look(self, frame_srgb: Float[Array, "H W 3"]) -> Float[Array, "H W"]:
        """Return the network's alpha after it has seen the frame several times, as its memory needs.

        Args:
            frame_srgb: in [0, 1].
        """
        ratio = min(1.0, _RVM_PX / max(frame_srgb.shape[:2]))
        picture = _planes(frame_srgb)
        memory: list[Given] = [np.zeros((1, 1, 1, 1), np.float32) if self._onnx else None] * 4
        last: Given = np.array([ratio], np.float32) if self._onnx else ratio
        for _ in range(_RVM_LOOKS):
            outputs = self._network([picture, *memory, last])
            if len(outputs.arrays) < 6:
                raise InputError(
                    f"{outputs.source} gave {len(outputs.arrays)} outputs instead of Robust Video Matting's 6"
                )
            memory = list(outputs.arrays[2:6])
        return _alpha(outputs, "pha", 1, frame_srgb.shape[:2])


def weights_of(path: Path) -> MattingNetwork:
    """Load BackgroundMattingV2 with the plain weights of a file, through torch's restricted reader.

    Args:
        path: file of plain weights.

    Raises:
        InputError: damaged, weights of something else, or a pickle that names code.
    """
    advice = "give BackgroundMattingV2's TorchScript file, its ONNX file, or its plain weights as released"
    try:
        file = weights_file(path)
    except ValueError as error:
        raise InputError(f"{path} cannot be used: {error}; {advice}") from error
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # damaged files make it raise nearly anything
        raise InputError(f"{path} holds more than weights, or is damaged: {advice}") from error
    state = _unwrapped(state)
    if not isinstance(state, dict) or not all(isinstance(value, torch.Tensor) for value in state.values()):
        raise InputError(f"{path} holds something other than weights: {advice}")
    try:
        return network_of({str(name).removeprefix("module."): value.float() for name, value in state.items()})
    except ValueError as error:
        raise InputError(f"{path} holds weights of another network: {advice}") from error


def _unwrapped(checkpoint: object) -> object:
    """Return the weights of a checkpoint that also holds the state of a training."""
    if isinstance(checkpoint, dict):
        for name in ("state_dict", "model_state_dict"):
            if isinstance(checkpoint.get(name), dict):
                return checkpoint[name]
    return checkpoint


def _srgb(picture: Picture | Plate) -> Float[Array, "H W 3"]:
    return linear_to_srgb(np.clip(np.asarray(picture, np.float32), 0, 1)).astype(np.float32)


def _at_size(
    pictures: _Pictures, tile_px: int | None, look: Callable[[_Pictures], Float[Array, "h w"]]
) -> Float[Array, "H W"]:
    """Return the matte at the frame's size, of a network that runs in tiles, or at a size that fits into memory."""
    height, width = pictures[0].shape[:2]
    if tile_px is not None and max(height, width) > tile_px:
        alpha = _in_tiles(pictures, tile_px, look)
    else:
        alpha = look(tuple(shrink(picture, _LONGEST_PX) for picture in pictures))
    if alpha.shape != (height, width):
        alpha = cv2.resize(alpha, (width, height), interpolation=cv2.INTER_LINEAR)
    alpha = np.clip(alpha, 0, 1).astype(np.float32)
    if alpha.sum() < LEAST_SHARE * alpha.size:
        raise nobody_found()
    return alpha


def _in_tiles(
    pictures: _Pictures, tile_px: int, look: Callable[[_Pictures], Float[Array, "h w"]]
) -> Float[Array, "H W"]:
    """Run in overlapping tiles that are blended; memory is a tile's."""
    height, width = pictures[0].shape[:2]
    total, weight = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for top, bottom, down in _tiles(height, tile_px):
        for left, right, across in _tiles(width, tile_px):
            share = down[:, None] * across[None]
            alpha = look(tuple(picture[top:bottom, left:right] for picture in pictures))
            total[top:bottom, left:right] += share * alpha
            weight[top:bottom, left:right] += share
    return total / weight


def _tiles(length: int, tile_px: int) -> Iterator[tuple[int, int, Float[Array, "n"]]]:
    """Yield first and last pixel (exclusive) of each tile along a side, and its weights, which fall to its ends."""
    size = min(length, tile_px)
    count = 1 if size == length else 1 + int(np.ceil((length - size) / (size * (1 - _TILES_SHARE))))
    for first in np.linspace(0, length - size, count).round().astype(int):
        at = np.arange(size, dtype=np.float32) + 0.5
        yield int(first), int(first) + size, np.minimum(1, np.minimum(at, size - at) / (_TILES_SHARE * size))


def _padded(picture: Float[Array, "H W 3"]) -> Float[Array, "h w 3"]:
    height, width = picture.shape[:2]
    return np.pad(picture, [(0, -height % _MULTIPLE_PX), (0, -width % _MULTIPLE_PX), (0, 0)], mode="edge")


def _enlarged(picture: Float[Array, "H W 3"], factor: int) -> Float[Array, "h w 3"]:
    if factor == 1:
        return picture
    return cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)


def _reduced(alpha: Float[Array, "h w"], size: tuple[int, ...]) -> Float[Array, "H W"]:
    if alpha.shape == size:
        return alpha
    return cv2.resize(alpha, size[::-1], interpolation=cv2.INTER_AREA)


def _planes(picture: Float[Array, "H W 3"]) -> Float[Array, "1 3 H W"]:
    return np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32)[None]


def _alpha(outputs: Outputs, name: str, place: int, size: tuple[int, int]) -> Float[Array, "H W"]:
    """Return the output of that name, else the one at that place."""
    array = outputs.get(name if name in outputs.names else place)
    if array.shape[-2:] != size or array.size != size[0] * size[1]:
        raise InputError(
            f"{outputs.source} gave a matte of the shape {array.shape} for a picture of {size[1]} x {size[0]} px; "
            "check that it is the network it was named"
        )
    return np.asarray(array.reshape(size), np.float32)
