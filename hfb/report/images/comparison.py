"""An image that compares a method's sub-frames with the true ones."""

import cv2
import numpy as np
import torch

from hfb.evaluation.prediction import Prediction
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.report.images.strip import captioned, stacked
from hfb.typing import Array, Float

_CELL_PX = 144
_SHOWN = 3


def draw_comparison(
    observation: Observation, prediction: Prediction, sharp: Float[Array, "T Q H W 4"] | None
) -> Float[Array, "Y X 3"]:
    """Draw per frame the input and predicted sub-frames, and below them the re-blurred image and the true ones.

    Args:
        observation: blurred frames, plate, mattes and camera.
        prediction: one with ``pictures``.
        sharp: true sub-frames, premultiplied linear colour and silhouette; None leaves them out.

    Raises:
        ValueError: the prediction has no images.
    """
    if prediction.pictures is None:
        raise ValueError("there is nothing to draw: the prediction has no pictures")
    left, top, width, height = observation.region()
    window = (slice(max(top, 0), max(top + height, 0)), slice(max(left, 0), max(left + width, 0)))
    frames = observation.mattes.shape[0]
    claimed = prediction.pictures.reshape(frames, -1, *prediction.pictures.shape[1:])
    rows = []
    for frame in range(frames):
        above = [("input", observation.to_srgb(observation.frames_linear[frame]).numpy())]
        below = [("re-blurred", _composed(claimed[frame].mean(0), observation))]
        above += _subframes("claimed", claimed[frame], observation)
        below += _subframes("true", sharp[frame], observation) if sharp is not None else []
        for line in (above, below):
            rows.append(np.concatenate([captioned(_small(picture[window]), name) for name, picture in line], 1))
    return stacked(rows).clip(0, 1)


def _subframes(
    name: str, pictures: Float[Array, "Q H W 4"], observation: Observation
) -> list[tuple[str, Float[Array, "H W 3"]]]:
    shown = np.linspace(0, len(pictures) - 1, _SHOWN).round().astype(int)
    return [(f"{name} {index + 1}/{len(pictures)}", _composed(pictures[index], observation)) for index in shown]


def _composed(picture: Float[Array, "H W 4"], observation: Observation) -> Float[Array, "H W 3"]:
    return observation.to_srgb(compose(torch.from_numpy(picture), observation.plate_linear)).numpy()


def _small(picture: Float[Array, "H W 3"]) -> Float[Array, "h w 3"]:
    scale = _CELL_PX / max(picture.shape[:2])
    size = (max(round(picture.shape[1] * scale), 1), max(round(picture.shape[0] * scale), 1))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
