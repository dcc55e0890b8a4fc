"""Draw fits that mattes are learned from: `hfb train matting-fits --mocap DIR --backgrounds DIR --out f.npy`.

For the third matting network (`hfb train matting --third --fits f.npy`): an image, its plate, the matte of the first
two networks, the rendering of a fit to these before the full-resolution stages, and the truth. A fit is wrong where its
matte is, and its texture takes the plate's colours where its body wrongly covers the plate. Doubles
(`hfb train matting-bank --doubles`) lack this correlation.
"""

import argparse

import cv2
import numpy as np
import torch

from hfb.matting.matting_protocol import clean, matte_region
from hfb.matting.network import NetworkMatting
from hfb.photometry import linear_to_srgb
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.blurred_people import until_found
from hfb.training.joints.joint_bank import split
from hfb.training.joints.joint_fits import Gym
from hfb.training.schedule import Counter

SIZE_PX = 192
_MARGIN = 0.25
_EVERY = 50


class MattingGym(Gym):
    """A gym with the shipped mattes, except for the moving layer."""

    matting = NetworkMatting()

    def mattes(self, rng: np.random.Generator) -> list[np.ndarray]:
        """Return (12, SIZE_PX, SIZE_PX) uint8 of one or two frames.

        Channels: frame and plate in sRGB (6), the matte, the fit's rendering (square roots of premultiplied light) and
        its silhouette (4), the true matte.

        Args:
            rng: of the person.
        """
        return until_found(lambda: self._rows(rng))

    def _rows(self, rng: np.random.Generator) -> list[np.ndarray] | None:
        watched = self._watched(rng)
        if watched is None:
            return None
        seen, (_, found) = watched.seen, self._fit(watched, rng)
        rows = []
        for frame, matte, fitted, true in zip(
            seen.frames_linear, seen.mattes, self._drawn(found, seen), watched.alphas, strict=True
        ):
            layers = [
                linear_to_srgb(frame.numpy()),
                linear_to_srgb(seen.plate_linear.numpy()),
                matte.numpy()[..., None],
            ]
            layers += [np.sqrt(np.clip(fitted[..., :3].numpy(), 0, 1)), fitted[..., 3:].numpy(), true[..., None]]
            rows.append(_cut(np.concatenate(layers, -1), matte.numpy(), rng))
        return rows

    def _matte(self, frame: np.ndarray, plate: np.ndarray, alpha: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        top, left, bottom, right = matte_region(alpha, margin=_MARGIN)
        matte = np.zeros_like(alpha)
        inner = (slice(top, bottom), slice(left, right))
        matte[inner] = clean(self.matting.look_twice(frame[inner], plate[inner])[0])
        return matte


def _cut(layers: np.ndarray, matte: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cut a square around the person, unscaled where it fits."""
    top, left, bottom, right = matte_region(matte, margin=_MARGIN)
    side = max(bottom - top, right - left, SIZE_PX)
    corner = [round((a + b - side) / 2 + rng.normal(0, 4)) for a, b in ((top, bottom), (left, right))]
    height, width = matte.shape
    pads = [(max(0, -at), max(0, at + side - size)) for at, size in zip(corner, (height, width), strict=True)]
    padded = np.pad(layers, (*pads, (0, 0)), mode="edge")
    at, across = (place + pad[0] for place, pad in zip(corner, pads, strict=True))
    square = padded[at : at + side, across : across + side]
    if side > SIZE_PX:
        each = np.moveaxis(square, -1, 0)
        square = np.stack([cv2.resize(one, (SIZE_PX,) * 2, interpolation=cv2.INTER_AREA) for one in each], -1)
    return (np.clip(square, 0, 1) * 255).round().astype(np.uint8).transpose(2, 0, 1)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser)


def run(options: argparse.Namespace) -> None:
    """Write one array that training may read meanwhile: rows of zeros are not drawn yet.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    gym = MattingGym(
        options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px
    )
    shape = (options.count, 12, SIZE_PX, SIZE_PX)
    bank = np.lib.format.open_memmap(options.out, mode="w+", dtype=np.uint8, shape=shape)
    done, number, counter = 0, 0, Counter("frames", _EVERY)
    while done < options.count:
        for row in gym.mattes(np.random.default_rng([options.seed, number]))[: options.count - done]:
            bank[done] = row
            done += 1
            counter.reached(done)
        number += 1
    bank.flush()
