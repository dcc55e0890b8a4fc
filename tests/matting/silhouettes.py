"""Composites whose alpha is known exactly: a jointed figure that moves during the exposure, over any plate."""

from dataclasses import dataclass

import cv2
import numpy as np

from hfb.photometry import linear_to_srgb, srgb_to_linear

SUBFRAMES = 17


@dataclass(frozen=True)
class Composite:
    """One blurred frame: sRGB quantised to 8 bits with sensor noise, given in linear light."""

    frame: np.ndarray
    plate: np.ndarray
    alpha: np.ndarray


def composite(
    plate_linear: np.ndarray, blur_px: float, seed: int, noise: float = 0.006, gain: float = 1.0, shadow: float = 0.0
) -> Composite:
    """The figure, about four fifths of the plate's height, in front of it; all parts in other colours."""
    rng = np.random.default_rng(seed)
    height, width = plate_linear.shape[:2]
    layers = [
        _figure(height, width, blur_px, t, np.random.default_rng(seed)) for t in np.linspace(-0.5, 0.5, SUBFRAMES)
    ]
    colour, alpha = (np.mean([layer[k] for layer in layers], 0) for k in (0, 1))
    lit = plate_linear * (1 - shadow * _shadow(height, width)[..., None])
    frame = (colour + (1 - alpha[..., None]) * lit) * gain
    return Composite(seen(frame, noise, rng), seen(plate_linear, noise / 3, rng), alpha.astype(np.float32))


def seen(light: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Light as a camera gives it: noise and eight bits in sRGB, in linear light again."""
    encoded = linear_to_srgb(np.clip(light, 0, 1)) + rng.normal(0, sigma, light.shape)
    return srgb_to_linear(np.round(np.clip(encoded, 0, 1) * 255) / 255).astype(np.float32)


def generated_plate(kind: str, height: int = 300, width: int = 240) -> np.ndarray:
    """A background in linear light: flat wall, coarse clouds of colour, or fine stripes."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    if kind == "flat":
        encoded = np.full((height, width, 3), 0.6) + 0.08 * (y / height)[..., None]
    elif kind == "clouds":
        encoded = cv2.resize(rng.uniform(0.15, 0.85, (12, 10, 3)), (width, height), interpolation=cv2.INTER_CUBIC)
    else:
        encoded = 0.5 + 0.25 * np.stack([np.sin(x / 3), np.sin((x + y) / 4), np.cos(y / 3)], -1)
    return srgb_to_linear(np.clip(encoded, 0.02, 0.98)).astype(np.float32)


def _shadow(height: int, width: int) -> np.ndarray:
    mask = np.zeros((height, width), np.float32)
    cv2.ellipse(mask, (int(width * 0.55), int(height * 0.93)), (width // 4, height // 25), 0, 0, 360, 1.0, -1)
    return cv2.GaussianBlur(mask, (0, 0), height / 80)


def _figure(height: int, width: int, blur: float, t: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied colour and alpha at one instant, antialiased by supersampling."""
    up, size = 3, height * 0.8
    canvas = np.zeros((height * up, width * up, 3), np.float32)
    mask = np.zeros(canvas.shape[:2], np.float32)
    shirt, trousers, shoe = (srgb_to_linear(rng.uniform(0.05, 0.9, 3)) for _ in range(3))
    skin = srgb_to_linear(np.array([0.8, 0.6, 0.5]) * rng.uniform(0.4, 1.1))
    angle = {name: rng.normal(0, 0.25) for name in ("trunk", "arm", "arm2", "leg", "leg2")}
    speed = {name: rng.normal(0, 1) * blur / (size * 0.35) for name in angle}
    speed["trunk"] *= 0.2
    drift = rng.normal(0, blur * 0.3, 2)
    now = {name: angle[name] + speed[name] * t for name in angle}
    hips = np.array([width * 0.5, height * 0.52]) + drift * t

    def step(turn: float, length: float) -> np.ndarray:
        return np.array([np.sin(turn), np.cos(turn)]) * length * size

    def limb(start: np.ndarray, end: np.ndarray, radius: float, colour: np.ndarray) -> None:
        ends = [tuple(round(float(v) * up) for v in point) for point in (start, end)]
        for picture, value in ((canvas, tuple(colour)), (mask, 1.0)):
            cv2.line(picture, *ends, value, max(1, int(radius * size * 2 * up)))

    neck = hips - step(now["trunk"], 0.3)
    for side, name in ((1, "leg"), (-1, "leg2")):
        turn = now[name] + 0.2 * side
        knee = hips + (side * 0.05 * size, 0) + step(turn, 0.24)
        foot = knee + step(turn - 0.2, 0.24)
        limb(hips + (side * 0.05 * size, 0), knee, 0.05, trousers)
        limb(knee, foot, 0.035, trousers)
        limb(foot, foot + (0.06 * size, 0), 0.025, shoe)
    limb(hips, neck + (0, 0.04 * size), 0.085, shirt)
    head = neck - step(now["trunk"], 0.09)
    limb(head, head - step(now["trunk"], 0.03), 0.055, skin)
    for side, name in ((1, "arm"), (-1, "arm2")):
        shoulder = neck + (side * 0.085 * size, 0.03 * size)
        elbow = shoulder + step(now[name] + 0.5 * side, 0.16)
        limb(shoulder, elbow, 0.032, shirt)
        limb(elbow, elbow + step(now[name] + 0.8 * side, 0.17), 0.025, skin)
    return tuple(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA) for part in (canvas, mask))
