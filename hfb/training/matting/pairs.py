"""Composites of known alpha for comparing matting methods: a clothed figure with motion blur of exact length.

A silhouette of a held-out figure wears a held-out texture and slides along a straight path during the exposure, so
that every ramp of alpha is known; or it moves as a person does, scaled so that its fastest joint smears that far.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hfb.photometry import srgb_to_linear
from hfb.training.matting.figures import GARMENTS, PHOTO, SIZE_PX
from hfb.training.matting.scenes import Difficulty, Scene, cast_shadows, draw_colours, path_kernel, take_picture

SIDE_PX = 320
TROUBLES = ("none", "shadow", "gain", "misplaced", "noise", "jpeg", "all")
KINDS = ("slide, photograph", "slide, clothes", "slide, garments", "person, clothes", "person, garments")
_LONGER_PX = 200  # of the sharp figure


@dataclass(frozen=True)
class Pair:
    """One texture before one background, with one camera defect."""

    kind: str
    smear_px: int
    trouble: str
    scene: Scene


def draw_pairs(bank: Path, plates: list[np.ndarray], photos: list[np.ndarray], per_kind: int) -> list[Pair]:
    """Draw all pairs, the same on every call: each kind and smear over textures and backgrounds.

    Args:
        bank: a file of matting-bank --held-out.
        plates: backgrounds, uint8 sRGB.
        photos: textures, uint8 sRGB.
        per_kind: pairs of each kind and smear.
    """
    figures = np.load(bank, mmap_mode="r")
    smears = np.array([one["smear_px"] for one in json.loads(bank.with_suffix(".json").read_text())["figures"]])
    pairs = []
    for smear_px in (24, 72):
        for place, kind in enumerate(KINDS):
            slides = kind.startswith("slide")
            near = smears < 1.5 if slides else np.abs(np.log(smears / smear_px + 1e-3)) < 0.35
            usable = np.flatnonzero(near)
            for number in range(per_kind):
                rng = np.random.default_rng([17, smear_px, place, number])
                which = int(usable[number % len(usable)])
                plate = _cut(plates[(7 * number + place) % len(plates)], SIDE_PX, rng)
                worn = _cut(photos[(5 * number + 3 * place + 1) % len(photos)], SIZE_PX, rng)
                scale = _LONGER_PX / (0.78 * SIZE_PX) if slides else smear_px / smears[which]
                layers = _layers(figures[which], kind, worn, plate, rng)
                colour, alpha = _placed(layers, scale, smear_px if slides else 0, rng)
                trouble = TROUBLES[number % len(TROUBLES)]
                pairs.append(Pair(kind, smear_px, trouble, _photographed(colour, alpha, plate, trouble, rng)))
    return pairs


def _cut(picture: np.ndarray, side: int, rng: np.random.Generator) -> np.ndarray:
    """Cut a square of a photograph in linear light, (side, side, 3)."""
    whole = min(picture.shape[:2])
    size = int(whole * rng.uniform(0.6, 1))
    top, left = (int(rng.integers(0, room + 1)) for room in (picture.shape[0] - size, picture.shape[1] - size))
    square = picture[top : top + size, left : left + size].astype(np.float32) / 255
    return cv2.resize(srgb_to_linear(square).astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)


def _layers(
    channels: np.ndarray, kind: str, photo: np.ndarray, plate: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return (SIZE_PX, SIZE_PX, 4): premultiplied light, and coverage."""
    alpha = channels[0].astype(np.float32)[..., None] / 255
    if kind.endswith("photograph"):
        return np.concatenate([photo * alpha, alpha], -1)
    if kind.endswith("clothes"):
        return np.concatenate([(channels[PHOTO].astype(np.float32).transpose(1, 2, 0) / 255) ** 2, alpha], -1)
    colours = draw_colours(plate, Difficulty(hard_share=0.1), rng)
    worn = channels[1 : 1 + len(GARMENTS)].astype(np.float32).transpose(1, 2, 0) / 255
    return np.concatenate([worn @ colours, alpha], -1)


def _placed(layers: np.ndarray, scale: float, smear_px: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a scaled figure near the middle, smeared along a line: (premultiplied light, alpha), SIDE_PX square."""
    offset = (SIDE_PX - scale * SIZE_PX) / 2 + rng.uniform(-8, 8, 2)
    matrix = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
    placed = cv2.warpAffine(layers.astype(np.float32), matrix, (SIDE_PX, SIDE_PX), flags=cv2.INTER_LINEAR)
    if smear_px:
        placed = cv2.filter2D(placed, -1, _line(smear_px, rng.uniform(0, np.pi)), borderType=cv2.BORDER_CONSTANT)
    alpha = np.clip(placed[..., 3], 0, 1)
    return np.clip(placed[..., :3], 0, alpha[..., None]), alpha


def _line(length_px: float, angle_rad: float) -> np.ndarray:
    along = (np.arange(8 * int(length_px)) + 0.5) / 8 - length_px / 2
    return path_kernel(along[:, None] * np.array([np.cos(angle_rad), np.sin(angle_rad)]))


def _photographed(
    colour: np.ndarray, alpha: np.ndarray, plate: np.ndarray, trouble: str, rng: np.random.Generator
) -> Scene:
    """Simulate the camera: always shot noise and eight bits, and one defect or all of them."""
    has = {trouble} if trouble != "all" else set(TROUBLES)
    lit = plate * cast_shadows(alpha, rng) if "shadow" in has else plate
    frame = colour + (1 - alpha[..., None]) * lit
    if "gain" in has:
        gain = np.exp(rng.choice([-1, 1]) * rng.uniform(0.05, 0.15) + rng.normal(0, 0.01, 3))
        frame = frame * gain.astype(np.float32)
    if "misplaced" in has:
        turn, shift = np.radians(rng.uniform(-0.15, 0.15)), rng.uniform(-1.2, 1.2, 2)
        middle = SIDE_PX / 2
        matrix = np.array([[1, -turn, shift[0] + turn * middle], [turn, 1, shift[1] - turn * middle]])
        size = (SIDE_PX, SIDE_PX)
        plate = cv2.warpAffine(plate, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    noise = 0.02 if "noise" in has else 0.004
    frame = take_picture(frame, noise, "jpeg" in has, rng)
    return Scene(frame, take_picture(plate, 0.3 * noise, "jpeg" in has, rng), alpha)
