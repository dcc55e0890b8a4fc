"""Deblurring of a frame to sharp sub-frames: by a user's network, or from another system's folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hfb.datasets.case import Case, case_name
from hfb.errors import InputError
from hfb.evaluation.baselines.chain_spec import ChainSpec, DeblurrerLayout
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.video_reading import read_frames
from hfb.networks.runtimes import Network, denormalised, load_network, normalised
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float

_MOST_SUBFRAMES = 256


@dataclass(frozen=True)
class SharpPictures:
    """Estimated sub-frames of every frame.

    Attributes:
        times: times of a frame's sub-frames, in exposures.
    """

    pictures_srgb: Float[Array, "T M H W 3"]
    times: Float[Array, "M"]


class Deblurrer:
    """The deblurrer of a chain's table: a network, a folder of images, or none, which keeps the frames.

    Args:
        chain: table of the chains file.
    """

    def __init__(self, chain: ChainSpec) -> None:
        self._layout = chain.deblurrer_layout
        self._folder = chain.pictures
        self._network = load_network(chain.deblurrer) if chain.deblurrer else None
        self.changes_pictures = self._network is not None or self._folder is not None

    def __call__(self, case: Case, observation: Observation) -> SharpPictures:
        """Return the sub-frames of all frames.

        Args:
            case: gives the number by which stored images are found.
            observation: the blurred frames.

        Raises:
            InputError: the network fails, or the folder lacks this case's images.
        """
        frames = [frame.numpy() for frame in observation.to_srgb(observation.frames_linear)]
        if self._network is not None:
            pictures = _by_network(self._network, self._layout, frames)
        elif self._folder is not None:
            folder = self._folder / case_name(case.number)
            sets = [_stored(folder, index, frame.shape) for index, frame in enumerate(frames)]
            if len({len(one) for one in sets}) > 1:
                raise InputError(
                    f"{folder}: its frames have {[len(one) for one in sets]} sub-frames; give equally many"
                )
            pictures = np.stack(sets)
        else:
            pictures = np.stack(frames)[:, None]
        return SharpPictures(pictures, subframe_times(pictures.shape[1], self._layout.times))


def subframe_times(count: int, times: tuple[float, ...] | None) -> Float[Array, "M"]:
    """Return the times of a system's sub-frames in exposures: as given, else evenly from 0 to 1 (a single one at 0.5).

    Args:
        count: sub-frames per frame.
        times: times in exposures, or None.
    """
    if times is not None:
        if len(times) != count:
            raise InputError(f"times has {len(times)} entries for {count} sub-frames per frame; give one for each")
        return np.array(times, np.float64)
    return np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])


def _by_network(
    network: Network, layout: DeblurrerLayout, frames: list[Float[Array, "H W 3"]]
) -> Float[Array, "T M H W 3"]:
    height, width = frames[0].shape[:2]
    bottom, right = -height % layout.multiple_of, -width % layout.multiple_of
    padded = [np.pad(frame, ((0, bottom), (0, right), (0, 0)), mode="edge") for frame in frames]
    inputs = [normalised(frame, layout.normalisation, layout.channels) for frame in padded]
    if layout.frames == "one":
        runs = [[one] for one in inputs]
    else:
        runs = [inputs if layout.frames == "list" else [np.concatenate(inputs, 1)]]
    sharp = []
    for run in runs:
        outputs = network(run)
        chosen = outputs.arrays if layout.output is None else (outputs.get(layout.output),)
        planes = [_planes(array, padded[0].shape[:2], outputs.source) for array in chosen]
        sharp.append(denormalised(np.concatenate(planes), layout.normalisation, layout.channels))
    together = np.concatenate(sharp)[:, :height, :width]
    if len(together) % len(frames):
        raise InputError(f"the deblurrer gave {len(together)} pictures for {len(frames)} frames; choose its output")
    return together.reshape(len(frames), -1, height, width, 3)


def _planes(array: Float[Array, "..."], size: tuple[int, ...], source: Path) -> Float[Array, "N 3 H W"]:
    if array.ndim < 3 or array.shape[-2:] != size or (array.size // (size[0] * size[1])) % 3:
        raise InputError(
            f"{source} gave {array.shape} where pictures (N, 3, {size[0]}, {size[1]}) were expected; "
            "choose its output, and multiple_of where it needs sides of a certain multiple"
        )
    return array.reshape(-1, 3, *size)


def _stored(folder: Path, frame: int, shape: tuple[int, ...]) -> Float[Array, "M H W 3"]:
    """Read a system's images of one frame, in the order of their names, or those of a video."""
    inner, video = folder / f"frame_{frame}", folder / f"frame_{frame}.mp4"
    if inner.is_dir():
        pictures = [read_picture_srgb(path) for path in sorted(inner.iterdir()) if not path.name.startswith(".")]
    elif video.is_file():
        pictures = list(read_frames(video, 0, _MOST_SUBFRAMES))
    else:
        pictures = []
    if not pictures:
        raise InputError(f"there are no sub-frames at {inner}; give {inner.name}/00.png, 01.png, ... or {video.name}")
    odd = next((picture.shape for picture in pictures if picture.shape != shape), None)
    if odd is not None:
        raise InputError(f"{inner} has a picture of {odd[1]} x {odd[0]} px, the frame has {shape[1]} x {shape[0]} px")
    return np.stack(pictures)
