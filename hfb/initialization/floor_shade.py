"""A matte without the person's shade and mirror image on the floor, which no network of matting tells from a limb.

A shaded pixel is explained by a darker plate, I = k B (`shadow_evidence`), and so is a limb of the plate's colour, or a
fast dark one. Landmarks decide between them: a figure that agrees better with the matte once such pixels are left out
stands in its own shade, and what lies below its feet, or beside them, is the floor.
"""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from hfb.initialization.landmarks import LANDMARK, PoseNetworks, networks_ready
from hfb.initialization.person_landmarks import draw_stick_figure, find_landmarks, stick_agreement, trunk_length
from hfb.matting.known_background import shadow_evidence
from hfb.matting.matte_network import quiet_noise
from hfb.matting.matting_protocol import Matting, Picture, Plate, matte_region, shrink
from hfb.networks.mediapipe_files import LandmarkChoice
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

_SIZE_PX = 640
_MARGIN = 0.1
_TOLERANCE = 12.0
"""Squared misfit, in variances of the noise, at which a pixel is no longer shade."""
_UNLIKELY, _LIKELY = 0.2, 0.5
"""Likelihoods of shade from which a pixel on the floor is part of it, and is nothing else."""
_SUSPECTED, _LOWER = 0.05, 0.4
"""Share of the matte that may be shade, in so much of its box: landmarks are looked for from here on."""
_SEEN = 0.2
"""Alpha that something of the person must have without shade: somebody in the plate's colours has none."""
_DARKEST = 0.15
"""Least share of the light that deep shade leaves, where it is known to lie on the floor."""
_LEAST_AGREEMENT = 0.35
_BESIDE, _ABOVE = (0.1, 0.2), (0.3, 0.2)
"""Of a trunk's length: distances from the figure between which pixels become floor; and how far above the lowest
landmark of the feet the floor fades out, and over which distance."""
_PIECE = 0.25
"""Alpha from which pixels hang together."""
_GAPS = 0.15
"""Width of gaps in the shade that are floor, too, of a trunk's length: seams, and where it is darkest."""
_FEET = [LANDMARK[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "heel", "foot_index")]


class FloorShadeMatting:
    """A `Matting` that removes the shade on the floor from another one's mattes.

    Args:
        matting: the other one.
        networks: returns the pose networks; called for a matte in which shade is suspected.
    """

    def __init__(self, matting: Matting, networks: Callable[[], PoseNetworks]) -> None:
        self._matting, self._networks = matting, networks

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """See `Matting`."""
        matte = self._matting(frame_linear, plate_linear)
        frame, plate = (np.clip(np.asarray(one, np.float32), 0, 1) for one in (frame_linear, plate_linear))
        top, left, bottom, right = matte_region(matte, _MARGIN)
        inner = (slice(top, bottom), slice(left, right))
        images = frame[inner], plate[inner]
        alone = matte[inner] * (1 - shade_likelihood(*images))
        lower = slice(round((1 - _LOWER) * (bottom - top)), None)
        if (matte[inner] - alone)[lower].sum() < _SUSPECTED * matte.sum() or alone.max() < _SEEN:
            return matte
        rest = np.zeros_like(matte)
        rest[inner] = alone
        found = find_landmarks(self._networks(), frame, plate, rest)
        if found is None or found[1] < max(_LEAST_AGREEMENT, stick_agreement(found[0].pixels, matte)):
            return matte
        deep = shade_likelihood(*images, _DARKEST)
        matte[inner] = without_floor_shade(matte[inner], deep, found[0].pixels - (left, top))
        return matte


def without_shade(matting: Matting, choice: LandmarkChoice = "auto") -> Matting:
    """Return a method of matting without shade on the floor; the method itself where there are no pose networks.

    Args:
        matting: the method.
        choice: choice among the landmark networks.

    Raises:
        InputError: as `networks_ready`.
    """
    return FloorShadeMatting(matting, partial(PoseNetworks, choice)) if networks_ready(choice) else matting


def shade_likelihood(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], darkest: float = 0.45
) -> Float[Array, "H W"]:
    """Return for each pixel whether a darker or slightly lighter plate explains it, 0 to 1.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], in the frame's exposure.
        darkest: least share of the plate's light.
    """
    frame, plate = (shrink(one, _SIZE_PX) for one in (frame_linear, plate_linear))
    noise = quiet_noise(linear_to_srgb(frame).astype(np.float32), linear_to_srgb(plate).astype(np.float32))
    misfit, _ = shadow_evidence(frame, plate, noise, darkest)
    size = frame_linear.shape[1::-1]
    return np.asarray(cv2.resize(np.exp(-misfit / _TOLERANCE), size, interpolation=cv2.INTER_LINEAR), np.float32)


def without_floor_shade(
    matte: Float[Array, "H W"], shade: Float[Array, "H W"], landmarks_px: Float[Array, "33 2"]
) -> Float[Array, "H W"]:
    """Remove what is shade, apart from the figure, and about as low as its feet or lower.

    Args:
        matte: alpha.
        shade: by `shade_likelihood`.
        landmarks_px: places of the person's landmarks.
    """
    trunk = trunk_length(landmarks_px)
    figure = draw_stick_figure(landmarks_px, matte.shape)
    distance = cv2.distanceTransform(1 - figure, cv2.DIST_L2, 3) if figure.any() else np.full(matte.shape, np.inf)
    apart = np.clip((distance / trunk - _BESIDE[0]) / (_BESIDE[1] - _BESIDE[0]), 0, 1)
    rows = np.arange(matte.shape[0])[:, None] + 0.5
    low = np.clip(((rows - landmarks_px[_FEET, 1].max()) / trunk + _ABOVE[0]) / _ABOVE[1], 0, 1)
    width = 2 * max(1, round(_GAPS * trunk / 2)) + 1
    sure = np.clip((shade - _UNLIKELY) / (_LIKELY - _UNLIKELY), 0, 1)
    whole = cv2.morphologyEx(sure, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)))
    left = matte * (1 - whole * apart * low)
    # What hangs together with the figure is the person; anything else there is haze, or the floor's mirror image.
    _, pieces = cv2.connectedComponents((left > _PIECE).astype(np.uint8))
    person = (pieces > 0) & np.isin(pieces, np.unique(pieces[figure > 0]))
    return np.where(person | (apart * low < 1), left, 0).astype(np.float32)
