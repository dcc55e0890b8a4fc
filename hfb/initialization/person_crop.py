"""The square crop around a person for pose networks, and the position of a body by weak perspective."""

import cv2
import numpy as np
import torch

from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.typing import Array, Float, Tensor


def person_square(matte: Float[Array, "H W"], margin: float, threshold: float = 0.05) -> tuple[int, int, int]:
    """Return left, top and side [px] of the square about the person's box; it may reach outside the image.

    Args:
        matte: the person's share of each pixel.
        margin: share of the box that is added on each side.
        threshold: alpha above which a pixel belongs to the matte's box.

    Raises:
        InputError: the matte is empty.
    """
    rows, columns = np.flatnonzero((matte > threshold).any(1)), np.flatnonzero((matte > threshold).any(0))
    if not rows.size:
        raise InputError("the matte is empty: no person differs from the background; check the plate")
    width, height = columns[-1] + 1 - columns[0], rows[-1] + 1 - rows[0]
    side = max(8, round(margin * max(width, height)))
    return (
        round((columns[0] + columns[-1] + 1 - side) / 2),
        round((rows[0] + rows[-1] + 1 - side) / 2),
        side,
    )


def cut_square(
    picture: Float[Array, "H W 3"], left: int, top: int, side: int, size_px: int
) -> Float[Array, "{size_px} {size_px} 3"]:
    """Return a square window at another size; black outside the image, as networks are trained.

    Args:
        picture: the image.
        left: left edge of the square [px].
        top: top edge of the square [px].
        side: side length of the square [px].
        size_px: side of the result [px].
    """
    height, width = picture.shape[:2]
    inside = picture[max(top, 0) : max(top + side, 0), max(left, 0) : max(left + side, 0)]
    pads = (
        max(-top, 0),
        max(top + side - height, 0),
        max(-left, 0),
        max(left + side - width, 0),
    )
    window = cv2.copyMakeBorder(np.ascontiguousarray(inside), *pads, cv2.BORDER_CONSTANT, value=0)
    interpolation = cv2.INTER_AREA if side > size_px else cv2.INTER_LINEAR
    return cv2.resize(window, (size_px, size_px), interpolation=interpolation).astype(np.float32)


def weak_perspective_place(
    scale: float, x: float, y: float, centre_px: tuple[float, float], side_px: float, camera: PinholeCamera
) -> Float[Tensor, "3"]:
    """Return the position of a body [m] whose point X appears at scale (X + (x, y)), the crop spanning -1 to 1.

    The depth is that at which f / z pixels per metre are scale times half the crop's side (Kanazawa et al. 2018).

    Args:
        scale: scale of the weak perspective.
        x: shift of the weak perspective.
        y: shift of the weak perspective.
        centre_px: centre of the crop [px].
        side_px: side of the crop [px].
        camera: camera of the image.

    Raises:
        InputError: a scale that is not positive, so that the crop shows no person.
    """
    if scale <= 0:
        raise InputError(f"the network's camera has the scale {scale:.3g}; its layout may name the wrong output")
    focal = (camera.fx + camera.fy) / 2
    depth = 2 * focal / (scale * side_px)
    middle = camera.unproject(torch.tensor(centre_px, dtype=torch.float32), torch.tensor(depth))
    return (middle + torch.tensor([x, y, 0.0])).float()
