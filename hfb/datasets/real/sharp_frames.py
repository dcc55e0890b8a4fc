"""One pass over the sharp frames of a case: the sum of each long exposure, and each frame's matte."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from hfb.datasets.real.shutter import Shutter
from hfb.datasets.real.view import Box, View
from hfb.datasets.synthetic.sharp import SHARP_SUBFRAMES
from hfb.errors import InputError
from hfb.matting.network import NetworkMatting
from hfb.typing import Array, Bool, Float

_USUAL_AREA = (0.6, 1.6)  # of the window's median: a mask outside is a matte that failed, not a moving person

OnFrame = Callable[[Float[Array, "H W 3"], Float[Array, "H W"]], None]


@dataclass(frozen=True)
class Exposure:
    """One blurred frame and the sharp frames behind it, linear light.

    Attributes:
        mean: mean of the K sharp frames.
        matte: mean of their mattes, a pseudo truth as good as the matting.
        masks: pixels in which each sharp matte is 0.5 or more.
        cutouts: the sharp frames nearest to u = i / 7, premultiplied with their mattes.
        middle: the sharp frame in the middle; of an even number the later one of the two.
    """

    mean: Float[Array, "H W 3"]
    matte: Float[Array, "H W"]
    masks: Bool[Array, "K H W"]
    cutouts: Float[Array, "8 H W 4"]
    middle: Float[Array, "H W 3"]

    def blur_rate(self) -> float:
        """Return |union of the masks| / |one mask| - 1.

        The median mask replaces the first one, and masks of an unusual area are ignored, so that a single bad matte has
        no influence.
        """
        areas = self.masks.sum((1, 2)).astype(float)
        usual = float(np.median(areas))
        kept = (areas >= _USUAL_AREA[0] * usual) & (areas <= _USUAL_AREA[1] * usual)
        return float(self.masks[kept].any(0).sum() / np.median(areas[kept]) - 1)


def expose(
    view: View,
    plate: Float[Array, "H W 3"],
    first: int,
    shutter: Shutter,
    boxes: list[Box] | None,
    on_frame: OnFrame | None,
) -> list[Exposure]:
    """Average the windows of a case, one frame in memory at a time.

    Args:
        view: window onto the video.
        plate: through the same view, linear.
        first: number of the case's first frame in the video.
        shutter: sharp frames per blurred one, and blurred frames.
        boxes: possible region of the person in each sharp frame, in the case's images; None for the whole view.
        on_frame: called with every sharp frame and its matte.

    Raises:
        InputError: a frame cannot be read or shows nobody.
    """
    matting = NetworkMatting(blurred=False)
    frames = view.footage.stored_frames(first, first + shutter.frames * shutter.average)
    done = []
    for window in range(shutter.frames):
        total, alphas = np.zeros(plate.shape), np.zeros(plate.shape[:2])
        masks, sharp = [], []
        middle = plate
        for index in range(shutter.average):
            frame = view.see(next(frames))
            matte = matting(frame, plate) * _allowed(view, boxes, window * shutter.average + index)
            if not (matte >= 0.5).any():
                raise InputError(f"{view.footage.path}: no person in frame {first + window * shutter.average + index}.")
            total += frame
            alphas += matte
            masks.append(matte >= 0.5)
            middle = frame if index == shutter.average // 2 else middle
            premultiplied = np.clip(frame - (1 - matte[..., None]) * plate, 0, 1) * (matte[..., None] > 0)
            if index in _nearest(shutter.average):
                sharp.append(np.concatenate([premultiplied, matte[..., None]], -1).astype(np.float32))
            if on_frame is not None:
                on_frame(frame, matte)
        order = sorted(set(_nearest(shutter.average)))
        cutouts = np.stack([sharp[order.index(index)] for index in _nearest(shutter.average)])
        mean, matte = total / shutter.average, alphas / shutter.average
        done.append(Exposure(mean.astype(np.float32), matte.astype(np.float32), np.stack(masks), cutouts, middle))
    return done


def _nearest(average: int) -> list[int]:
    """Return the sharp frame nearest to each of u = i / 7."""
    return [round(i / (SHARP_SUBFRAMES - 1) * (average - 1)) for i in range(SHARP_SUBFRAMES)]


def _allowed(view: View, boxes: list[Box] | None, index: int) -> Float[Array, "H W"]:
    """Return 1 in the chosen person's possible region, 0 elsewhere; the step is softened over a pixel."""
    allowed = np.ones((view.camera.height, view.camera.width), np.float32)
    if view.body is not None:
        allowed *= view.body
    if boxes is not None:
        box = boxes[index]
        inside = np.zeros_like(allowed)
        inside[
            max(0, int(box.top)) : max(0, int(box.bottom) + 1), max(0, int(box.left)) : max(0, int(box.right) + 1)
        ] = 1
        allowed *= inside
    return np.asarray(cv2.blur(allowed, (3, 3)), np.float32)
