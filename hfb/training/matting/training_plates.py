"""Backgrounds of the matting images: photographs, generated rooms, and patterns."""

from pathlib import Path

import cv2
import numpy as np

from hfb.datasets.synthetic.backgrounds import room_background
from hfb.io.media.images.image_io import read_picture_srgb

ROOMS, PATTERNS = 160, 200
_LONGER_PX = 640


def read_photos(folders: list[Path], held_out: bool) -> list[np.ndarray]:
    """Read uint8 sRGB images; every fourth scene of a folder (names up to the last underscore) is held out.

    Args:
        folders: of .jpg and .png files.
        held_out: whether to read the held-out scenes or the others.
    """
    photos = []
    for folder in folders:
        files = sorted(path for path in folder.glob("*.*") if path.suffix in (".jpg", ".png"))
        scenes = sorted({path.stem.rsplit("_", 1)[0] for path in files})
        for path in files:
            if (scenes.index(path.stem.rsplit("_", 1)[0]) % 4 == 3) == held_out:
                picture = read_picture_srgb(path)
                scale = min(1.0, _LONGER_PX / max(picture.shape[:2]))
                size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
                photos.append((cv2.resize(picture, size, interpolation=cv2.INTER_AREA) * 255).astype(np.uint8))
    return photos


def make_rooms(count: int, seed: int) -> list[np.ndarray]:
    """Generate rooms as in the synthetic sets, uint8 sRGB.

    Args:
        count: how many.
        seed: of the random numbers.
    """
    rooms = (room_background(256, 256, np.random.default_rng([seed, 1, number])) for number in range(count))
    return [(room * 255).astype(np.uint8) for room in rooms]


def make_patterns(count: int, seed: int) -> list[np.ndarray]:
    """Generate walls, gradients, clouds of every scale, stripes, bricks and checks, uint8 sRGB.

    Args:
        count: how many.
        seed: of the random numbers.
    """
    return [_pattern(256, np.random.default_rng([seed, 2, number])) for number in range(count)]


def _pattern(size: int, rng: np.random.Generator) -> np.ndarray:
    rows, columns = np.mgrid[:size, :size].astype(np.float32) / size
    base = rng.uniform(0.05, 0.95) + rng.normal(0, 0.12, 3)
    other = rng.uniform(0, 1, 3) if rng.random() < 0.5 else base + rng.normal(0, 0.12, 3)
    angle, period = rng.uniform(0, np.pi) if rng.random() < 0.4 else rng.integers(2) * np.pi / 2, rng.uniform(0.02, 0.3)
    along = np.cos(angle) * columns + np.sin(angle) * rows
    across = -np.sin(angle) * columns + np.cos(angle) * rows
    kind = rng.choice(["wall", "clouds", "stripes", "bricks", "checks"], p=[0.3, 0.3, 0.15, 0.1, 0.15])
    if kind == "clouds":
        share = np.zeros((size, size), np.float32)
        roughness = rng.uniform(0.3, 1.1)
        for octave in range(1, 8):
            noise = rng.normal(0, 1, (2**octave + 1, 2**octave + 1)).astype(np.float32)
            share += roughness**octave * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
        share = np.clip(0.5 + share / (4 * share.std()), 0, 1)
    elif kind == "stripes":
        share = (np.sin(2 * np.pi * along / period) > rng.uniform(-0.7, 0.7)).astype(np.float32)
    elif kind == "bricks":
        course = np.floor(along / period)
        joint = (along / period % 1 < 0.1) | ((across / period / 2 + course % 2 / 2) % 1 < 0.05)
        brick = (course * 31 + np.floor(across / period / 2 + course % 2 / 2) * 17) % 7 / 7
        share = np.where(joint, 1, 0.3 * brick).astype(np.float32)
    elif kind == "checks":
        share = ((np.floor(along / period) + np.floor(across / period)) % 2).astype(np.float32)
    else:
        share = np.zeros((size, size), np.float32)
    picture: np.ndarray = base + share[..., None] * (other - base)
    light = 1 + rng.uniform(-0.4, 0.4) * (along - 0.5) + rng.uniform(-0.3, 0.3) * (across - 0.5)
    grain = cv2.GaussianBlur(rng.normal(0, 1, picture.shape), (0, 0), rng.uniform(0.6, 2)) * rng.uniform(0, 0.05)
    picture = cv2.GaussianBlur(picture * light[..., None] + grain, (0, 0), rng.uniform(0.4, 1.5))
    return (np.clip(picture, 0, 1) * 255).astype(np.uint8)
