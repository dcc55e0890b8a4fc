"""Inputs of the second network that follow from a first matte: the body's colours, and alpha by them.

alpha = <I - B, F - B> / |F - B|^2 needs F, which follows from a first matte: from opaque neighbours, near and far, and,
where a thin limb is nowhere opaque, from the blurred pixels themselves after removing the plate,
F = B + (I - B) / alpha. None is right everywhere; the second network has learned to weigh them.
"""

import numpy as np

from hfb.matting.diffusion import spread_colours
from hfb.matting.known_background import dot
from hfb.matting.matte_network import quiet_noise
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

EVIDENCE_CHANNELS = 17
COLOUR_STARTS = (0, 3)
"""Channels of the evidence at which a colour's three begin."""

_NEAR_PX, _FAR_PX, _UNMIXED_PX = 4, 32, 6
_OPAQUE_POWER, _UNMIXED_POWER = 6, 2
_LEAST_SHARE = 0.15  # a pixel with a smaller share does not determine the body's colour


def colour_evidence(
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    alpha: Float[Array, "H W"],
    doubt: Float[Array, "H W"] | None = None,
) -> Float[Array, "C H W"]:
    """Return the second network's inputs besides `matte_network.features`.

    Args:
        frame_linear: in [0, 1]; the plate already has the frame's exposure.
        plate_linear: in [0, 1]; the plate already has the frame's exposure.
        alpha: the first matte.
        doubt: the logarithm of its expected error, where it is known.

    Returns:
        near and unmixed body colours in sRGB (6); for each of the near, far and unmixed colour: alpha by it, how far it
        is from the plate, and what it leaves unexplained (9); the first matte and, if known, its doubt (2).
    """
    noise = quiet_noise(linear_to_srgb(frame_linear), linear_to_srgb(plate_linear))
    opaque = (alpha**_OPAQUE_POWER + 1e-6).astype(np.float32)
    near = spread_colours(frame_linear, opaque, _NEAR_PX)
    far = spread_colours(frame_linear, opaque, _FAR_PX)
    own = unmixed_colours(frame_linear, plate_linear, alpha, _UNMIXED_POWER)
    channels = [linear_to_srgb(colours) - 0.5 for colours in (near, own)]
    for colours in (near, far, own):
        channels.extend(explained_by(colours, frame_linear, plate_linear, noise))
    channels.append((alpha - 0.5)[..., None])
    if doubt is not None:
        channels.append(np.clip(doubt, -6, 1)[..., None] / 4)
    return np.ascontiguousarray(np.concatenate(channels, -1).transpose(2, 0, 1), np.float32)


def explained_by(
    colours: Float[Array, "H W 3"],
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    noise: Float[Array, "H W 3"],
) -> list[Float[Array, "H W 1"]]:
    """Return alpha if the body had these colours, their distance from the plate, and the unexplained rest (all scaled).

    Args:
        colours: colours of the body, linear light.
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], in the frame's exposure.
        noise: standard deviation of frame - plate, linear light.
    """
    direction, difference = (colours - plate_linear) / noise, (frame_linear - plate_linear) / noise
    length = dot(direction, direction)
    share = dot(difference, direction) / (length + 1)
    rest = difference - np.clip(share, 0, 1)[..., None] * direction
    told = np.clip(share, -0.3, 1.3) - 0.5, np.log1p(length) / 8, np.log1p(dot(rest, rest)) / 8
    return [one[..., None] for one in told]


def unmixed_colours(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], alpha: Float[Array, "H W"], power: int
) -> Float[Array, "H W 3"]:
    """Return the body's colours by B + (I - B) / alpha, spread from where alpha is large.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], in the frame's exposure.
        alpha: matte in [0, 1].
        power: exponent of alpha in the weights with which colours are spread.
    """
    unmixed = np.clip(plate_linear + (frame_linear - plate_linear) / np.maximum(alpha, _LEAST_SHARE)[..., None], 0, 1)
    partly = (np.where(alpha > _LEAST_SHARE, alpha, 0) ** power + 1e-6).astype(np.float32)
    return spread_colours(unmixed.astype(np.float32), partly, _UNMIXED_PX)
