"""The pinhole camera of a system that stores where its 3D points appear, but not through which lens."""

import numpy as np

from hfb.interop.readers.pose_track import pinhole
from hfb.typing import Array, Bool, Float

_LEAST_POINTS, _LEAST_SPREAD = 6, 1e-3


def focal_of_points(points: Float[Array, "J 3"], pixels: Float[Array, "J 2"]) -> float:
    """Return the focal length [px] by least squares; NaN where too few points are known or they lie too close.

    Args:
        points: camera coordinates, NaN where unknown.
        pixels: their places in the image [px], NaN where unknown.
    """
    known = _known(points, pixels)
    rays = points[known, :2] / points[known, 2:]
    if known.sum() < _LEAST_POINTS or np.ptp(rays, axis=0).max() < _LEAST_SPREAD:
        return float("nan")
    spread = rays - rays.mean(0)
    focal_px = float((spread * (pixels[known] - pixels[known].mean(0))).sum() / (spread * spread).sum())
    return focal_px if focal_px > 0 else float("nan")


def camera_of_points(points: Float[Array, "J 3"], pixels: Float[Array, "J 2"], focal_px: float) -> Float[Array, "3 3"]:
    """Return K whose principal point follows from the points; NaN where none is known.

    Args:
        points: camera coordinates, NaN where unknown.
        pixels: their places in the image [px], NaN where unknown.
        focal_px: focal length.
    """
    known = _known(points, pixels)
    if not known.any():
        return pinhole(focal_px, np.nan, np.nan)
    cx, cy = np.median(pixels[known] - focal_px * points[known, :2] / points[known, 2:], 0)
    return pinhole(focal_px, float(cx), float(cy))


def _known(points: Float[Array, "J 3"], pixels: Float[Array, "J 2"]) -> Bool[Array, "J"]:
    return np.isfinite(pixels).all(1) & np.isfinite(points).all(1) & (points[:, 2] > 0)
