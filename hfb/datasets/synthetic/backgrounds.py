"""Generated backgrounds: a room with a wall, a floor and things on them."""

import cv2
import numpy as np

from hfb.typing import Array, Float


def room_background(height: int, width: int, rng: np.random.Generator) -> Float[Array, "H W 3"]:
    """Paint a soft-lit wall and floor with a few pictures and boxes, sRGB in [0, 1].

    Args:
        height: height of the image [px].
        width: width of the image [px].
        rng: draws colours and objects.
    """
    wall, floor = (rng.uniform(low, high) + rng.uniform(-0.07, 0.07, 3) for low, high in ((0.5, 0.8), (0.2, 0.45)))
    horizon = int(height * rng.uniform(0.62, 0.75))
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    picture = np.where((rows < horizon)[..., None], wall, floor)
    for _ in range(int(rng.integers(4, 9))):
        box_height, box_width = (rng.uniform(0.08, 0.3, 2) * (height, width)).astype(int)
        top, left = int(rng.uniform(0, horizon - box_height * 0.5)), int(rng.uniform(0, width - box_width))
        picture[top : top + box_height, left : left + box_width] = np.clip(
            rng.uniform(0.2, 0.8) + rng.normal(0, 0.15, 3), 0, 1
        )
        inner = picture[top + 4 : top + box_height - 4, left + 4 : left + box_width - 4]
        inner += rng.normal(0, 0.1, 3)
    light = 1 - 0.35 * (((columns / width - rng.uniform(0.2, 0.8)) ** 2) + ((rows / height - rng.uniform(0, 0.4)) ** 2))
    grain = cv2.GaussianBlur(rng.normal(0, 1, (height, width, 3)), (0, 0), 1.2) * 0.03
    picture = cv2.GaussianBlur(picture * light[..., None] + grain, (0, 0), 0.8)
    return np.clip(picture, 0, 1)
