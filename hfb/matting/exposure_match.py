"""The exposure of a frame over its plate's, and the frame as the plate's exposure would have shown it.

Automatic exposure, flicker and white balance scale linear light. The frame is brought to the plate's exposure and not
the plate to the frame's: one texture and one person then hold for all frames of a clip, whatever each was exposed to.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from hfb.matting.matting_protocol import shrink
from hfb.typing import Array, Bool, Float

Gain = tuple[float, float, float]
"""Per channel: linear light of the frame over that of the plate."""
NO_GAIN: Gain = (1.0, 1.0, 1.0)

_LOOKED_AT_PX = 192
_DARK, _CLIPPED = 0.02, 0.97
"""Linear light outside of which a channel's ratio says nothing: one step of eight bits is 5 % there, or it is cut."""
_MOST_LOG, _STEP = 0.75, 0.01
_NEAR = (0.08, 0.05, 0.035, 0.035)
"""How far from the gain the logarithm of a pixel's ratio may lie, round by round."""
_LEAST_PIXELS, _LEAST_SHARE, _LEAST_SAID = 200, 0.05, 0.12
_LARGE = 0.5
_AROUND_PX, _LEAST_TEXTURE, _TEXTURE_KEPT, _TEXTURED = 5, 0.05, 0.5, 4.0
_CUT = 0.98  # linear light that may have been more
_LEAST_COMMON, _LEAST_BALANCE = 0.025, 0.025
"""Logarithms below are none: clean recordings reach 0.011 and 0.016, drawn scenes with noise 0.0003."""


def frame_gain(frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> Gain:
    """Return a frame's exposure over its plate's, per channel; exactly 1 where they are the same.

    It is the ratio that most pixels share. Pixels that show the plate's texture count more, so that a person who covers
    half of the image does not decide. All channels have one value unless the white balance differs too. Beyond a
    factor of two the light is another one, and the gain 1.

    Args:
        frame_linear: the frame, in [0, 1].
        plate_linear: the background, of the same size.
    """
    ratio, weight = _log_ratios(frame_linear, plate_linear)
    if len(ratio) < _LEAST_PIXELS:
        return NO_GAIN
    mean = ratio.mean(1)
    shared = np.abs(mean - _most_shared(mean, weight)) < _NEAR[0]
    gain = np.array([_most_shared(channel, weight[shared]) for channel in ratio[shared].T])
    for near in _NEAR:
        inside = (np.abs(ratio - gain) < near).all(1)
        if (
            inside.sum() < max(_LEAST_PIXELS, _LEAST_SHARE * len(ratio))
            or weight[inside].sum() < _LEAST_SAID * weight.sum()
        ):
            return NO_GAIN
        gain = np.median(ratio[inside], axis=0)
    common = float(gain.mean())
    balance = gain - common
    if abs(common) > _MOST_LOG - _NEAR[0]:
        return NO_GAIN
    if np.abs(balance).max() < _LEAST_BALANCE:
        if abs(common) < _LEAST_COMMON:
            return NO_GAIN
        gain = np.full(3, common)
    red, green, blue = (round(float(one), 4) for one in np.exp(gain))
    return red, green, blue


def in_plate_exposure(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], gain: Gain
) -> Float[Array, "H W 3"]:
    """Divide a frame by its gain.

    Clipped values do not state the light. Where the frame is clipped, it is taken to be as bright as the plate, less
    the share that its unclipped channels lack there; where the plate is clipped, the frame is clipped alike.

    Args:
        frame_linear: the frame.
        plate_linear: the background.
        gain: of the frame over the plate.
    """
    if gain == NO_GAIN:
        return frame_linear
    even = frame_linear / np.asarray(gain, frame_linear.dtype)
    cut = frame_linear >= _CUT
    if cut.any():
        even = np.where(cut, np.maximum(even, plate_linear * _share_of_plate(even, plate_linear, ~cut)), even)
    return np.minimum(even, max(1.0, float(plate_linear.max())))


def _share_of_plate(
    even: Float[Array, "H W 3"], plate: Float[Array, "H W 3"], known: Bool[Array, "H W 3"]
) -> Float[Array, "H W 1"]:
    """Return the share of the plate's light that a pixel has in its known channels; 1 where none is known.

    A limb that passes swiftly before a white wall darkens it: where red is clipped, blue still shows the limb.
    """
    told = (known & (plate > _DARK)).astype(even.dtype)
    share = (even / np.maximum(plate, _DARK) * told).sum(-1) / np.maximum(told.sum(-1), 1)
    return np.asarray(np.where(told.any(-1), share, 1)[..., None], even.dtype)


def describe_gains(gains: Sequence[Gain]) -> str | None:
    """Return a sentence on the exposures that are evened out; None where there are none.

    Args:
        gains: of all frames, in their order.
    """
    other = {number: gain for number, gain in enumerate(gains) if gain != NO_GAIN}
    if not other:
        return None
    means = [float(np.exp(np.log(gain).mean())) for gain in other.values()]
    low, high = f"{min(means):.2f}", f"{max(means):.2f}"
    balance = any(len(set(gain)) > 1 for gain in other.values())
    whose = f"frame {next(iter(other))} has" if len(other) == 1 else f"{len(other)} of {len(gains)} frames have"
    times = low if low == high else f"{low} to {high}"
    return (
        f"{whose} {times} times the background's exposure{' and another white balance' if balance else ''}: evened out"
    )


def _log_ratios(
    frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n"]]:
    """Return log ratios and weights of the pixels that are neither dark nor clipped, at a small size."""
    clipped = np.any((frame >= _CLIPPED) | (plate >= _CLIPPED), axis=-1)
    small_frame, small_plate = (shrink(one, _LOOKED_AT_PX) for one in (frame, plate))
    usable: Bool[Array, "h w"] = shrink(np.asarray(clipped, np.float32), _LOOKED_AT_PX) < 1e-3
    usable = usable & (np.minimum(small_frame, small_plate) > _DARK).all(-1)
    seen, there = (np.log(np.maximum(one, _DARK)) for one in (small_frame, small_plate))
    weight = _shows_plate(seen.mean(-1), there.mean(-1))
    return np.asarray((seen - there)[usable], np.float64), weight[usable]


def _shows_plate(frame: Float[Array, "h w"], plate: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Return the weight of each pixel: larger where the plate has a texture that the frame has too.

    Both are in logarithms. A plain coat before a patterned wall counts less than the wall, however large it is.
    """
    apart, pattern = (_spread(one) for one in (frame - plate, plate))
    textured = pattern > _LEAST_TEXTURE
    return np.where(textured, np.where(apart < _TEXTURE_KEPT * pattern, _TEXTURED, 0.0), 1.0)


def _spread(picture: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Return the standard deviation around every pixel."""
    size = (_AROUND_PX, _AROUND_PX)
    return np.sqrt(np.maximum(cv2.blur(picture**2, size) - cv2.blur(picture, size) ** 2, 0))


def _most_shared(ratio: Float[Array, "n"], weight: Float[Array, "n"]) -> float:
    """Return the logarithm that most pixels share; the smaller one where two are shared by about as many."""
    edges = np.arange(-_MOST_LOG, _MOST_LOG + _STEP, _STEP)
    counts, _ = np.histogram(ratio, edges, weights=weight)
    smooth = cv2.GaussianBlur(counts.astype(np.float64)[None], (0, 0), 1.5)[0]
    middles = (edges[1:] + edges[:-1]) / 2
    return float(middles[int(np.argmax(smooth * np.exp(-((middles / _LARGE) ** 2))))])
