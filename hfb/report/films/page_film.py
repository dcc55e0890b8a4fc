"""The slow-motion film of a result's page, cropped to the person and small enough to be embedded.

Two panels, the blurred frame and the body at one instant: at most 640 px wide and 20 s long for any clip.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hfb.geometry.camera import PinholeCamera
from hfb.motion.sampled import SampledMotion
from hfb.report.films.slow_motion import Shot, film_instants, film_slow_factor, paired_pictures
from hfb.typing import Array, Float

_PANEL_PX = (340, 316)  # height and width that a panel of two may have, captions and margins left out
_MARGIN = 0.35  # of the person's height: hands and feet beyond their joints, and some ground
_LEAST_PX = 48
_LONGEST_S = 20.0


def page_slow_factor(motion: SampledMotion) -> float:
    """Return how many times slower than real time the page's film is, so that it lasts at most 20 s.

    Args:
        motion: fitted motion; only ``times_s`` and ``frame_index`` count.
    """
    lasts = float(motion.times_s[-1] - motion.times_s[0])
    return min(film_slow_factor(motion), _LONGEST_S / max(lasts, 1e-9))


def page_picture_count(motion: SampledMotion) -> int:
    """Return the number of images of the page's film.

    Args:
        motion: fitted motion.
    """
    return len(film_instants(motion, page_slow_factor(motion)))


def page_pictures(shot: Shot) -> Iterator[Float[Array, "Y X 3"]]:
    """Yield the images of the page's film, sRGB in [0, 1], `hfb.report.films.slow_motion.FILM_FPS` per second.

    Args:
        shot: motion, body, plate and frames.
    """
    slow = page_slow_factor(shot.motion)
    yield from paired_pictures(around_person(shot), film_instants(shot.motion, slow), slow, _PANEL_PX)


def around_person(shot: Shot) -> Shot:
    """Return the shot cropped to a box that holds the person at every instant.

    Args:
        shot: the shot; its camera's principal point moves with the crop.
    """
    left, top, right, bottom = _box(shot.motion, shot.camera)
    frame = shot.frame_linear
    return replace(
        shot,
        camera=shot.camera.crop(left, top, right - left, bottom - top),
        plate_linear=shot.plate_linear[top:bottom, left:right],
        frame_linear=lambda number: frame(number)[top:bottom, left:right],
    )


def _box(motion: SampledMotion, camera: PinholeCamera) -> tuple[int, int, int, int]:
    """Return left, top, right, bottom [px] around all joints in the image, with a margin, within the image."""
    seen = motion.joints @ camera.matrix().numpy().T
    pixels = seen[..., :2] / np.maximum(seen[..., 2:], 1e-6)
    margin = _MARGIN * float(np.median(np.ptp(pixels[..., 1], axis=1)))
    low, high = pixels.min((0, 1)) - margin, pixels.max((0, 1)) + margin
    sides = []
    for at, size in ((0, camera.width), (1, camera.height)):
        start = int(np.clip(np.floor(low[at]), 0, max(0, size - _LEAST_PX)))
        sides.append((start, int(np.clip(np.ceil(high[at]), min(size, start + _LEAST_PX), size))))
    return sides[0][0], sides[1][0], sides[0][1], sides[1][1]
