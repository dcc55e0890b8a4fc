"""A calibrated lens, and the removal of its distortion."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from hfb.typing import Array, Float

_HARMLESS_PX = 0.05


@dataclass(frozen=True)
class Lens:
    """OpenCV's standard or fisheye model; numbers only, so that it can be sent with the footage.

    Attributes:
        K: fx, fy, cx, cy [px] in OpenCV's convention: the first pixel's centre is at (0, 0).
        distortion: k1 k2 p1 p2 [k3 ...], of a fisheye k1 k2 k3 k4.
        fisheye: light from the angle a off the axis lies at f a (1 + k1 a^2 + k2 a^4 ...), not at f tan(a) ...
    """

    K: tuple[float, float, float, float]
    distortion: tuple[float, ...]
    fisheye: bool = False

    def pinhole(self) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
        """Return the matrix of an undistorted image in this project's convention: first pixel centre at (0.5, 0.5)."""
        fx, fy, cx, cy = self.K
        return (fx, 0.0, cx + 0.5), (0.0, fy, cy + 0.5), (0.0, 0.0, 1.0)

    def bends(self, height: int, width: int) -> bool:
        """Return whether an image of this size changes at all when it is undistorted.

        Args:
            height: height of the image [px].
            width: width of the image [px].
        """
        return _maps(self, height, width)[0] is not None

    def undistorted(self, picture: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """Resample an image as a pinhole camera of the same matrix takes it; its border repeats outside.

        A lens that moves no pixel by more than a twentieth of one leaves the image as it is.

        Args:
            picture: as stored.
        """
        x, y = _maps(self, *picture.shape[:2])
        if x is None or y is None:
            return picture
        return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def undistortion_maps(
    K: Float[Array, "3 3"],
    distortion: Float[Array, "n"],
    fisheye: bool,
    new_K: Float[Array, "3 3"],
    size: tuple[int, int],
) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
    """Return, for each pixel of a pinhole's image, its position (x, y) in the stored image [px].

    Args:
        K: camera matrix of the stored image, in OpenCV's convention.
        distortion: distortion of the stored image, in OpenCV's convention.
        fisheye: use OpenCV's fisheye model.
        new_K: camera matrix of the pinhole.
        size: (width, height).
    """
    initialize = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    x, y = initialize(K, distortion, np.eye(3), new_K, size, cv2.CV_32FC1)
    return x, y


@lru_cache(maxsize=2)
def _maps(lens: Lens, height: int, width: int) -> tuple[Float[Array, "H W"], Float[Array, "H W"]] | tuple[None, None]:
    fx, fy, cx, cy = lens.K
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    x, y = undistortion_maps(matrix, np.array(lens.distortion), lens.fisheye, matrix, (width, height))
    rows, columns = np.mgrid[:height, :width]
    if max(np.abs(x - columns).max(), np.abs(y - rows).max()) <= _HARMLESS_PX:
        return None, None
    return x, y
