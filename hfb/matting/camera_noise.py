"""Differences of frame and plate in the background: a small exposure gain, and noise."""

from functools import reduce

import cv2
import numpy as np

from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Bool, Float

_LEAST_NOISE = 1.2 / 255  # quantisation of two 8-bit images, plus compression that leaves flat areas untouched
_MOST_NOISE = 12 / 255
GAINS = (0.8, 1.25)  # a third of a stop: beyond, another light is indistinguishable from another scene


def exposure_gain(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], limits: tuple[float, float] = GAINS
) -> Float[Array, "3"]:
    """Estimate the factor per channel by which the plate is multiplied to match the frame's background.

    It is the median ratio over the pixels that differ least, repeated three times, which excludes the person and
    clipped or black pixels.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1].
        limits: smallest and largest gain.
    """
    # channel by channel: NumPy reduces and chooses along axes of three four times as slowly
    frame, plate = (np.moveaxis(one, -1, 0) for one in (frame_linear, plate_linear))
    usable = ((plate > 0.01) & (plate < 0.9) & (frame < 0.95) & (frame > 0.005)).all(0)
    gain = np.ones(3, np.float32)
    if usable.sum() < 100:
        return gain
    ratio = np.stack([seen[usable] / there[usable] for seen, there in zip(frame, plate, strict=True)])
    logs = np.log(ratio)
    for _ in range(3):
        distance = reduce(np.maximum, np.abs(logs - np.log(gain)[:, None]))
        near = distance <= 1.5 * np.median(distance)
        gain = np.clip([np.median(one[near]) for one in ratio], *limits).astype(np.float32)
    return gain


def noise_srgb(
    difference_srgb: Float[Array, "H W 3"], plate_srgb: Float[Array, "H W 3"], empty: Bool[Array, "H W"]
) -> Float[Array, "H W"]:
    """Estimate the standard deviation of `frame - plate` per pixel: a constant and a share of the local contrast.

    The second part models the effect of small camera shake, resampling and compression on edges and texture.

    Args:
        difference_srgb: frame minus plate.
        plate_srgb: in [0, 1].
        empty: pixels that certainly show background only (the sample of the fit).
    """
    gray = cv2.GaussianBlur(plate_srgb.mean(-1), (0, 0), 0.7)
    contrast = cv2.blur(np.hypot(cv2.Sobel(gray, -1, 1, 0), cv2.Sobel(gray, -1, 0, 1)) / 8, (3, 3))
    sample, edges = np.abs(difference_srgb[empty]).mean(-1), contrast[empty]
    if sample.size < 100:
        return np.full(gray.shape, 3 * _LEAST_NOISE, np.float32)
    # mean |d| of a normal variable is 0.8 sigma; the upper quantile in place of the mean covers heavy tails
    smooth = edges <= np.quantile(edges, 0.5)
    floor = float(np.clip(np.quantile(sample[smooth], 0.7) / 0.9, _LEAST_NOISE, _MOST_NOISE))
    share = 0.0
    if not smooth.all():
        excess = np.maximum(sample[~smooth] / 0.8 - floor, 0)
        share = float(np.clip(np.mean(excess) / max(float(np.mean(edges[~smooth])), 1e-4), 0, 0.6))
    return np.asarray(np.hypot(floor, share * contrast), np.float32)


def noise_linear(sigma_srgb: Float[Array, "H W"], level_linear: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    """Convert a standard deviation to linear light: sigma times the slope of the sRGB curve at the pixel's level.

    Args:
        sigma_srgb: standard deviation in sRGB.
        level_linear: linear light at which the sRGB curve's slope is taken.
    """
    level = linear_to_srgb(np.maximum(level_linear, 0))
    slope = np.where(level <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((level + 0.055) / 1.055) ** 1.4)
    return np.asarray(sigma_srgb[..., None] * slope, np.float32)
