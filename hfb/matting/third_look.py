"""Inputs of the third network that follow from a fit: its render, silhouette and colours.

A matte from before the fit has errors where the person looks like the plate; the fitted body has errors where a limb is
not yet in place. Where they disagree, the pixels decide: the share of the fitted colour, and the difference that the
fit's image leaves. The third network has learned to weigh them from people beside a body of slightly different pose and
shape, and from fits.
"""

import numpy as np

from hfb.matting.diffusion import spread_colours
from hfb.matting.matte_network import CHANNELS, quiet_noise
from hfb.matting.second_look import EVIDENCE_CHANNELS, explained_by
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

SHARED_CHANNELS = CHANNELS + EVIDENCE_CHANNELS - 1
"""Number of the second network's input channels that are used: all but the doubt of a first matte."""
FIT_CHANNELS = 10
FIT_COLOUR_STARTS = (0, 7)
"""Channels of the fit's evidence at which a colour's three begin."""

_LEAST_SHARE = 0.1  # a pixel that is less the fit's has no colour of its own
_SPREAD_PX = 6


def fit_evidence(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], fitted: Float[Array, "H W 4"]
) -> Float[Array, "C H W"]:
    """Return the third network's inputs that depend on a fit.

    Args:
        frame_linear: in [0, 1]; the plate already has the frame's exposure.
        plate_linear: in [0, 1]; the plate already has the frame's exposure.
        fitted: the fit's blurred image, premultiplied linear light and alpha.

    Returns:
        the fit's colours in sRGB, spread to where it is not (3); alpha by them, how far they are from the plate, what
        they leave unexplained (3); the fit's alpha (1); signed logarithm of what its image leaves unexplained, in
        units of the noise (3).
    """
    colour, alpha = fitted[..., :3], fitted[..., 3]
    noise = quiet_noise(linear_to_srgb(frame_linear), linear_to_srgb(plate_linear))
    own = np.clip(colour / np.maximum(alpha, _LEAST_SHARE)[..., None], 0, 1)
    weights = (np.where(alpha > _LEAST_SHARE, alpha, 0) ** 2 + 1e-6).astype(np.float32)
    own = spread_colours(own.astype(np.float32), weights, _SPREAD_PX)
    rest = (frame_linear - colour - (1 - alpha[..., None]) * plate_linear) / noise
    channels = [
        linear_to_srgb(own) - 0.5,
        *explained_by(own, frame_linear, plate_linear, noise),
        (alpha - 0.5)[..., None],
        np.sign(rest) * np.log1p(np.abs(rest)) / 2,
    ]
    return np.ascontiguousarray(np.concatenate(channels, -1).transpose(2, 0, 1), np.float32)
