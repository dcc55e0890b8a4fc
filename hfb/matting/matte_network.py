"""A small U-Net for the matte: its input and its layers."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from hfb.matting.known_background import texture_evidence
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float, Tensor

CHANNELS = 14
WIDTHS = (16, 24, 40, 64, 96)

_LEAST_NOISE = 1.2 / 255
_MOST_NOISE = 12 / 255
_QUIET_SHARE = 0.3
_QUIET_LEVEL = 0.65
"""The 0.3-quantile of mean |d| over three channels lies at 0.58 sigma where nobody is, higher the more is covered."""
_DARK = 0.01  # added to both lights before their ratio is taken


def features(frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> Float[Array, "C H W"]:
    """Return the network's input: both images, their difference in units of the noise, their ratio, and texture.

    Args:
        frame_linear: in [0, 1]; the plate already has the frame's exposure.
        plate_linear: in [0, 1]; the plate already has the frame's exposure.

    Returns:
        frame and plate in sRGB (6); signed logarithm of the difference over the noise (3); logarithm of the ratio of
        the lights, in which a shadow is the same in all channels (3); alpha by texture and its precision (2).
    """
    frame, plate = (linear_to_srgb(picture).astype(np.float32) for picture in (frame_linear, plate_linear))
    alpha, precision = texture_evidence(frame_linear, plate_linear, quiet_noise(frame, plate))
    scaled = (frame - plate) / _quiet_sigma(frame, plate)
    ratio = np.log((frame_linear + _DARK) / (plate_linear + _DARK))
    picture = np.concatenate(
        [
            frame - 0.5,
            plate - 0.5,
            np.sign(scaled) * np.log1p(np.abs(scaled)) / 2,
            np.clip(ratio, -3, 3),
            ((alpha - 0.5) * (precision > 0))[..., None],
            (np.log1p(precision) / 4)[..., None],
        ],
        -1,
    )
    return np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32)


def quiet_noise(frame_srgb: Float[Array, "H W 3"], plate_srgb: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    """Estimate the standard deviation of frame - plate in linear light, from the pixels that differ least.

    Args:
        frame_srgb: in [0, 1].
        plate_srgb: in [0, 1], in the frame's exposure.
    """
    level = np.maximum(frame_srgb, plate_srgb)
    slope = np.where(level <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((level + 0.055) / 1.055) ** 1.4)
    return np.asarray(_quiet_sigma(frame_srgb, plate_srgb) * slope, np.float32)


def _quiet_sigma(frame_srgb: Float[Array, "H W 3"], plate_srgb: Float[Array, "H W 3"]) -> np.float32:
    quiet = np.quantile(np.abs(frame_srgb - plate_srgb).mean(-1), _QUIET_SHARE) / _QUIET_LEVEL
    return np.float32(np.clip(quiet, _LEAST_NOISE, _MOST_NOISE))


class MatteNetwork(nn.Module):
    """A U-Net of four halvings, wide convolutions at the smallest size, and four doublings with skip connections.

    The second output is the logarithm of the expected error (a Laplace scale) of the first.

    Args:
        widths: channels of the layers from fine to coarse.
        normalise: makes a normalisation layer for a number of channels; None for none.
        channels: number of input channels.
    """

    def __init__(
        self,
        widths: Sequence[int] = WIDTHS,
        normalise: Callable[[int], nn.Module] | None = None,
        channels: int = CHANNELS,
    ) -> None:
        super().__init__()

        def layer(before: int, after: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
            convolution = nn.Conv2d(before, after, 3, stride, dilation, dilation)
            norm = nn.Identity() if normalise is None else normalise(after)
            return nn.Sequential(convolution, norm, nn.ReLU(inplace=True))

        steps = list(pairwise(widths))
        self.entry = layer(channels, widths[0])
        self.down = nn.ModuleList(nn.Sequential(layer(a, b, stride=2), layer(b, b)) for a, b in steps)
        self.around = nn.ModuleList(layer(widths[-1], widths[-1], dilation=2) for _ in range(2))
        self.up = nn.ModuleList(layer(a + b, a) for a, b in reversed(steps))
        self.exit = nn.Conv2d(widths[0], 2, 3, padding=1)

    def forward(self, picture: Float[Tensor, "B C H W"]) -> Float[Tensor, "B 2 H W"]:
        """Return the logit of alpha, and the logarithm of its error scale; any size from 16 px.

        Args:
            picture: features of frame and plate.
        """
        now = self.entry(picture)
        finer = [now]
        for down in self.down:
            now = down(now)
            finer.append(now)
        for around in self.around:
            now = now + around(now)
        for up, beside in zip(self.up, reversed(finer[:-1]), strict=True):
            now = functional.interpolate(now, size=beside.shape[-2:], mode="bilinear", align_corners=False)
            now = up(torch.cat([now, beside], 1))
        return self.exit(now)
