"""A matte from one frame and the clean background: alpha = <I - B, F - B> / |F - B|^2, F unknown but smooth.

Blur is a mixture of light, so everything is computed in linear light: I = alpha F + (1 - alpha) B. Two kinds of
evidence are combined, each with its precision under the camera's noise:

- colour: the share of the way from B to the nearby body colour F, which is estimated again in each round from the
  pixels that look most opaque;
- texture: in a small window with nearly constant alpha and F the frame is a line over the plate,
  I = (1 - alpha) B + const, so the slope is the share of the background, whatever F is.

Where neither gives any evidence (clothes of the background's colour) a membrane interpolates. A shadow is a pixel that
a darker background explains and no body colour does.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from hfb.matting.camera_noise import noise_linear, noise_srgb
from hfb.matting.diffusion import smooth_where_unsure, spread_colours
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Bool, Float, Shaped

_ROUNDS = 4
_STIFFNESS = 40.0
_MOST_PRECISE = 4000.0
_COLOUR_SPREAD = 0.2  # body colours vary by this share around their smooth mean
_DARK_SPREAD = 0.02  # and by this much light however dark they are
_WINDOW_RADIUS_PX = 4
_SHADOW_TOLERANCE = 12.0  # squared noise units
_SHADOW_TINT = 0.05  # of the squared change
_LEAST_TEXTURE = 27.0  # summed variance of the plate in a window, in units of the noise
_SMALLEST_COLOUR_PATCH_PX = 8


@dataclass(frozen=True)
class Evidence:
    """Evidence of one frame before any body colour is known; in units of the noise where not stated otherwise."""

    frame: Float[Array, "H W 3"]  # linear
    plate: Float[Array, "H W 3"]  # linear, the frame's exposure
    noise: Float[Array, "H W 3"]  # standard deviation of frame - plate, linear
    difference: Float[Array, "H W 3"]  # (frame - plate) / noise
    change: Float[Array, "H W"]  # mean square of `difference` around a pixel; 1 where nothing moved
    body: Bool[Array, "H W"]  # where the main moving thing was seen at all
    texture_alpha: Float[Array, "H W"]
    texture_precision: Float[Array, "H W"]
    shadow_misfit: Float[Array, "H W"]  # squared distance to the nearest darkened plate colour
    shadow_depth: Float[Array, "H W"]  # |1 - k| of that colour


def gather_evidence(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], empty: Bool[Array, "H W"] | None = None
) -> Evidence:
    """Measure the noise and find what changed.

    Args:
        frame_linear: linear light in [0, 1].
        plate_linear: linear light in [0, 1], in the frame's exposure.
        empty: pixels that are known to show background only; the least changed 60 % when not given.
    """
    plate_srgb = linear_to_srgb(plate_linear)
    difference_srgb = (linear_to_srgb(frame_linear) - plate_srgb).astype(np.float32)
    magnitude = cv2.GaussianBlur(np.abs(difference_srgb).max(-1), (0, 0), 2)
    if empty is None:
        empty = magnitude <= np.quantile(magnitude, 0.6)
    for _ in range(2):
        noise = noise_linear(noise_srgb(difference_srgb, plate_srgb, empty), np.maximum(plate_linear, frame_linear))
        difference = (frame_linear - plate_linear) / noise
        change = cv2.GaussianBlur(dot(difference, difference) / 3, (0, 0), 1.5)
        body = main_change(change)
        away = cv2.distanceTransform(1 - body.astype(np.uint8), cv2.DIST_L2, 3) > 0.03 * max(body.shape)
        empty = away if away.mean() > 0.05 else empty
    alpha, precision = texture_evidence(frame_linear, plate_linear, noise)
    misfit, depth = shadow_evidence(frame_linear, plate_linear, noise)
    return Evidence(frame_linear, plate_linear, noise, difference, change, body, alpha, precision, misfit, depth)


def main_change(change: Float[Array, "H W"], threshold: float = 6.0) -> Bool[Array, "H W"]:
    """Return the changed pixels of the largest thing that changed, with the pieces close to it.

    Dark clothes in front of something dark cut a body into pieces: a piece nearer to the main one than a tenth of the
    main one's longer side belongs to it if it has a hundredth of its energy. A second person, a waving tree and
    speckles do not.

    Args:
        change: squared difference of frame and plate, in variances of the noise.
        threshold: change above which a pixel counts.
    """
    seen = cv2.morphologyEx((change > threshold).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    joined = cv2.dilate(seen, _disc(0.005 * max(seen.shape)))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(joined)
    if count < 2:
        return np.zeros(seen.shape, bool)
    energy = np.bincount(labels.ravel(), weights=(np.minimum(change, 400) * seen).ravel(), minlength=count)
    energy[0] = 0
    main = int(energy.argmax())
    reach = 0.1 * max(boxes[main, cv2.CC_STAT_WIDTH], boxes[main, cv2.CC_STAT_HEIGHT])
    kept = labels == main
    for _ in range(3):  # a shoe may hang on a shin that hangs on the thigh
        near = np.unique(labels[cv2.distanceTransform(1 - kept.astype(np.uint8), cv2.DIST_L2, 3) < reach])
        kept = np.isin(labels, [label for label in near if energy[label] >= 0.01 * energy[main]])
    return kept & (seen > 0)


def _disc(radius: float) -> Shaped[Array, "d d"]:
    side = 2 * max(1, round(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def texture_evidence(
    frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"], noise: Float[Array, "H W 3"]
) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
    """Return alpha as 1 - slope of the frame over the plate in each window, and its precision.

    Args:
        frame: linear light.
        plate: linear light, in the frame's exposure.
        noise: standard deviation of `frame - plate`, linear light.
    """
    side = 2 * _WINDOW_RADIUS_PX + 1

    def mean(x: np.ndarray) -> np.ndarray:
        return cv2.blur(x, (side, side), borderType=cv2.BORDER_REFLECT_101)

    unit = mean(noise).mean(-1, keepdims=True)
    i, b = frame / unit, plate / unit
    mean_i, mean_b = mean(i), mean(b)
    covariance = mean(dot(i, b)) - dot(mean_i, mean_b)
    variance_b = np.maximum(mean(dot(b, b)) - dot(mean_b, mean_b), 1e-6)
    variance_i = np.maximum(mean(dot(i, i)) - dot(mean_i, mean_i), 0)
    # Noise in the plate itself flattens the slope; texture hardly above it is no evidence.
    slope = covariance / np.maximum(variance_b - 3, 0.3 * variance_b)
    misfit = np.maximum(variance_i - slope * covariance, 0) / 3
    precision = 0.1 * side**2 * np.maximum(variance_b - _LEAST_TEXTURE, 0) / (1 + misfit)
    return np.clip(1 - slope, 0, 1).astype(np.float32), np.minimum(precision, _MOST_PRECISE).astype(np.float32)


def shadow_evidence(
    frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"], noise: Float[Array, "H W 3"], darkest: float = 0.45
) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
    """Explain each pixel as a shadow `k B` with `darkest` <= k <= 1.1.

    Args:
        frame: linear light.
        plate: linear light, in the frame's exposure.
        noise: standard deviation of `frame - plate`, linear light.
        darkest: least share of the plate's light.

    Returns:
        the squared misfit in variances of the noise, and how far k is from 1.
    """
    i, b = frame / noise, plate / noise
    share = np.clip(dot(i, b) / np.maximum(dot(b, b), 1e-6), darkest, 1.1)
    rest = i - share[..., None] * b
    misfit = cv2.GaussianBlur(dot(rest, rest), (0, 0), 1.0)
    return misfit, np.abs(cv2.GaussianBlur(share, (0, 0), 1.0) - 1)


def solve_matte(evidence: Evidence) -> Float[Array, "H W"]:
    """Alternate between the body's smooth colours and the matte that follows from them.

    Args:
        evidence: evidence of one frame, by `gather_evidence`.
    """
    seen = cv2.morphologyEx(evidence.body.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    inside = cv2.distanceTransform(seen, cv2.DIST_L2, 3)
    outside = _far_from(evidence.body)
    presence = np.clip(evidence.change / 16, 0, 1) * np.clip(inside / 6, 0, 1)
    square = dot(evidence.difference, evidence.difference)
    energy = cv2.GaussianBlur(square, (0, 0), 1.0)
    # Shade is never exactly neutral: some share of the change may be a change of colour.
    shadow_like = np.exp(-evidence.shadow_misfit / (_SHADOW_TOLERANCE + _SHADOW_TINT * energy))
    # A faint even darkening or brightening is the person's light and shade in the room.
    faint = shadow_like * np.clip((0.2 - evidence.shadow_depth) / 0.08, 0, 1)
    texture = evidence.texture_precision * (1 - faint) * (evidence.change > 4)
    size = np.sqrt(square) + 1e-3
    brighter = (1 / (1 + np.exp(-4 * evidence.difference.sum(-1) / size))).astype(np.float32)
    weights = (np.clip(inside / 10, 0, 1) ** 3 * presence * (1 - 0.99 * shadow_like) + 1e-7).astype(np.float32)
    alpha = np.zeros_like(weights)
    for _ in range(_ROUNDS):
        value, precision, shadow, opaque = _two_colours(evidence, weights, brighter, alpha)
        shadow = np.maximum(np.maximum(shadow, faint), shadow_like * _remote(opaque * presence * (1 - shadow_like)))
        shown = texture * (1 - shadow)
        total = precision + shown + outside
        joint = (value * (1 - shadow) * precision + evidence.texture_alpha * shown) / total
        alpha = np.clip(smooth_where_unsure(joint.astype(np.float32), total.astype(np.float32), _STIFFNESS), 0, 1)
        trust = shown / (shown + 100)
        opaque = np.minimum(opaque, 1.4 * (1 - trust) + trust * (evidence.texture_alpha + 0.1))
        weights = (opaque**8 * presence * (1 - shadow) * (1 - 0.99 * shadow_like) + 1e-7).astype(np.float32)
    return _without_small_holes(alpha, texture / (texture + 100))


def _without_small_holes(alpha: Float[Array, "H W"], trust: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Fill gaps that the body encloses wholly, smaller than a hundredth of it: a white mask before a white wall.

    Args:
        alpha: matte so far.
        trust: certainty by texture; a gap through which the background's texture is seen stays.
    """
    opaque = alpha > 0.5
    _, labels, boxes, _ = cv2.connectedComponentsWithStats((~opaque).astype(np.uint8), connectivity=4)
    left, top, width, height, area = boxes.T
    at_edge = (left == 0) | (top == 0) | (left + width == alpha.shape[1]) | (top + height == alpha.shape[0])
    small = ~at_edge & (area < 0.01 * opaque.sum())
    small[0] = False  # the opaque pixels themselves
    # Two pixels more than the gap: its soft rim is an artefact too.
    gaps = cv2.dilate(small[labels].astype(np.uint8), _disc(2)) > 0
    return np.where(gaps, 1 - trust * (1 - alpha), alpha).astype(np.float32)


def _remote(certain: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Return 0 at the certain body, rising to 1 from a twentieth of its size away, beyond the reach of dark blur."""
    mask = certain > 0.5
    if not mask.any():
        return np.zeros(mask.shape, np.float32)
    distance = cv2.distanceTransform(1 - mask.astype(np.uint8), cv2.DIST_L2, 3)
    return (1 - np.exp(-((distance / (0.05 * _extent(mask))) ** 2))).astype(np.float32)


def _two_colours(
    evidence: Evidence, weights: Float[Array, "H W"], brighter: Float[Array, "H W"], alpha: Float[Array, "H W"]
) -> tuple[Float[Array, "H W"], Float[Array, "H W"], Float[Array, "H W"], Float[Array, "H W"]]:
    """Join two hypotheses per pixel: the body colour seen nearby in front of darker things, and of brighter ones.

    One smooth F would lose a dark shirt beside a bright arm. Where the hypotheses disagree the precision falls, so that
    a place which only one of them leaves open is filled from its surroundings.

    Returns:
        alpha's value and precision, the shadow's share, and how opaque the pixel looks.
    """
    count = np.repeat(brighter[..., None], 3, -1)
    local_share = spread_colours(count, weights, _SMALLEST_COLOUR_PATCH_PX)[..., 0]
    energy = dot(evidence.difference, evidence.difference)
    parts = []
    for member, prior in ((brighter, local_share), (1 - brighter, 1 - local_share)):
        colours = spread_colours(evidence.frame, weights * member + 1e-9, _SMALLEST_COLOUR_PATCH_PX)
        share, value, variance, misfit, contrast = colour_evidence(evidence, colours, alpha)
        likelihood = (np.clip(prior, 0, 1) + 0.02) * np.exp(-misfit / (6 + 0.1 * energy))
        trust = contrast / (contrast + 100)
        opaque = trust * np.clip(share, 0, 1.4) + (1 - trust) * alpha
        parts.append((likelihood, value, variance, misfit, opaque))
    first, second = parts
    r = first[0] / (first[0] + second[0])
    value, opaque, misfit = (r * first[k] + (1 - r) * second[k] for k in (1, 4, 3))
    variance = r * (first[2] + (first[1] - value) ** 2) + (1 - r) * (second[2] + (second[1] - value) ** 2)
    misfit = cv2.GaussianBlur(misfit, (0, 0), 1.0)
    shadow = 1 / (1 + (evidence.shadow_misfit + 6) ** 2 / (0.25 * misfit + 1e-3) ** 2)
    return value, np.minimum(1 / variance, _MOST_PRECISE), shadow, opaque


def colour_evidence(
    evidence: Evidence, colours: Float[Array, "H W 3"], alpha: Float[Array, "H W"]
) -> tuple[Float[Array, "H W"], Float[Array, "H W"], Float[Array, "H W"], Float[Array, "H W"], Float[Array, "H W"]]:
    """Return alpha by one body colour F per pixel, and its terms.

    Args:
        evidence: evidence of one frame, by `gather_evidence`.
        colours: F, linear light.
        alpha: matte so far: where it is small, F is less certain.

    Returns:
        <I-B, F-B> / |F-B|^2 unclipped, alpha by it, its variance, the squared rest, |F-B|^2.
    """
    direction = (colours - evidence.plate) / evidence.noise
    length = np.maximum(dot(direction, direction), 1e-6)
    share = dot(evidence.difference, direction) / length
    value = np.clip(share, 0, 1)
    rest = evidence.difference - value[..., None] * direction
    misfit = dot(rest, rest)
    # The body's colour varies around F: the effect on the share, relative to the distance from B to F.
    varied, apart = _COLOUR_SPREAD * colours + _DARK_SPREAD, colours - evidence.plate
    spread = dot(varied, varied) / np.maximum(dot(apart, apart), 1e-6)
    # Where F is B's colour the pixel has no evidence: keep the surroundings' value.
    open_share = 1 / (1 + 0.1 / np.clip(spread, 1e-6, 10))
    likely = np.maximum(np.maximum(value, alpha), open_share)
    variance = (1 + 0.1 * misfit) / length + 0.15 * likely**2 * spread
    value = (1 - open_share) * value + open_share * np.maximum(value, alpha)
    return share, value, np.minimum(variance, 1.0), misfit, length


def dot(a: Float[Array, "H W 3"], b: Float[Array, "H W 3"]) -> Float[Array, "H W"]:
    """Return the product over the colour channels (numpy's sum over a short last axis is ten times slower).

    Args:
        a: one image.
        b: another one.
    """
    return np.einsum("hwc,hwc->hw", a, b)


def _far_from(body: Bool[Array, "H W"]) -> Float[Array, "H W"]:
    """Return the precision of alpha = 0, growing with distance from the change; gaps of a tenth of a body are open."""
    reach = 0.05 * _extent(body)
    grown = cv2.distanceTransform(1 - body.astype(np.uint8), cv2.DIST_L2, 3) < reach
    closed = cv2.distanceTransform(np.pad(grown.astype(np.uint8), 1, mode="edge"), cv2.DIST_L2, 3)[1:-1, 1:-1] > reach
    distance = cv2.distanceTransform(1 - (closed | body).astype(np.uint8), cv2.DIST_L2, 3)
    return (1000 * np.clip((distance - 2) / 6, 0, 1)).astype(np.float32)


def _extent(mask: Bool[Array, "H W"]) -> int:
    """Return longer side of a mask's box [px]; 1 where it is empty."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return int(max(rows[-1] - rows[0], columns[-1] - columns[0])) + 1 if rows.size else 1
