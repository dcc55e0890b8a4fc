"""Textures that slide before other textures, made from nothing: alpha is known exactly, no photograph, no body."""

import cv2
import numpy as np

from tests.matting.silhouettes import Composite, seen

SIDE_PX = 256
TEXTURES = ("plain", "gradient", "smooth", "fine", "pink", "stripes", "checks")
SHAPES = ("figure", "capsule", "disc", "rectangle")
_INSTANTS = 49
_LIMBS = (  # of the figure, in shares of the picture's side: from, to, width
    ((0.5, 0.3), (0.5, 0.52), 0.15),
    ((0.5, 0.18), (0.5, 0.18), 0.11),
    ((0.46, 0.5), (0.42, 0.7), 0.075),
    ((0.42, 0.7), (0.43, 0.9), 0.055),
    ((0.54, 0.5), (0.6, 0.7), 0.075),
    ((0.6, 0.7), (0.57, 0.9), 0.055),
    ((0.45, 0.27), (0.36, 0.4), 0.05),
    ((0.36, 0.4), (0.3, 0.5), 0.04),
    ((0.55, 0.27), (0.65, 0.38), 0.05),
    ((0.65, 0.38), (0.7, 0.5), 0.04),
)


def slide(number: int, smear_px: float) -> Composite:
    """Pair `number` of a texture and a background: every texture is worn in turn, over another one each round."""
    rng = np.random.default_rng([number, 77])
    round_of, worn = divmod(number, len(TEXTURES))
    cloth = texture(TEXTURES[worn], rng)
    plate = texture(TEXTURES[(3 * round_of + worn + 2) % len(TEXTURES)], rng)
    mask = _shape(SHAPES[number % len(SHAPES)])
    layers = np.concatenate([cloth * mask[..., None], mask[..., None]], -1)
    angle_rad = rng.uniform(0, np.pi)
    step = smear_px * np.array([np.cos(angle_rad), np.sin(angle_rad)])
    moved = [
        cv2.warpAffine(layers, np.array([[1, 0, t * step[0]], [0, 1, t * step[1]]]), (SIDE_PX, SIDE_PX))
        for t in np.linspace(-0.5, 0.5, _INSTANTS)
    ]
    mean = np.mean(moved, 0)
    alpha = mean[..., 3]
    frame = mean[..., :3] + (1 - alpha[..., None]) * plate
    return Composite(seen(frame, 0.004, rng), seen(plate, 0.004, rng), alpha.astype(np.float32))


def texture(kind: str, rng: np.random.Generator) -> np.ndarray:
    """(SIDE_PX, SIDE_PX, 3) in linear light."""
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float32)
    one, other = rng.uniform(0, 0.9, (2, 3)).astype(np.float32)
    if kind in ("plain", "gradient"):
        share = x / SIDE_PX if kind == "gradient" else np.ones_like(x)
    elif kind == "stripes":
        angle, period_px = rng.uniform(0, np.pi), rng.uniform(10, 30)
        share = (np.sin((x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi / period_px) > 0).astype(np.float32)
    elif kind == "checks":
        cell_px = int(rng.integers(8, 24))
        share = ((x // cell_px + y // cell_px) % 2).astype(np.float32)
    else:
        grains_px = {"smooth": (21.0,), "fine": (1.5,), "pink": (16.0, 5.0, 1.2)}[kind]
        clouds = sum(_clouds(grain_px, rng) for grain_px in grains_px) / np.sqrt(len(grains_px))
        return np.clip(0.3 + 0.18 * clouds, 0, 1).astype(np.float32)
    return one * share[..., None] + other * (1 - share[..., None])


def _clouds(grain_px: float, rng: np.random.Generator) -> np.ndarray:
    """Blurred noise in three colours, mean 0 and deviation 1."""
    noise = cv2.GaussianBlur(rng.normal(size=(SIDE_PX, SIDE_PX, 3)), (0, 0), grain_px)
    return (noise - noise.mean((0, 1))) / noise.std((0, 1))


def _shape(name: str) -> np.ndarray:
    """Coverage of a shape in the middle, (SIDE_PX, SIDE_PX), antialiased."""
    fine = 4 * SIDE_PX
    mask = np.zeros((fine, fine), np.uint8)

    def bar(start: tuple[float, float], end: tuple[float, float], width: float) -> None:
        first, last = ((round(point[0] * fine), round(point[1] * fine)) for point in (start, end))
        cv2.line(mask, first, last, 255, round(width * fine))

    if name == "disc":
        bar((0.5, 0.5), (0.5, 0.5), 0.44)
    elif name == "capsule":
        bar((0.5, 0.3), (0.5, 0.7), 0.22)
    elif name == "rectangle":
        mask[fine // 4 : 3 * fine // 4, round(0.35 * fine) : round(0.65 * fine)] = 255
    else:
        for limb in _LIMBS:
            bar(*limb)
    return cv2.resize(mask, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA).astype(np.float32) / 255
