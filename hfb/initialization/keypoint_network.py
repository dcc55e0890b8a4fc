"""2D keypoints of the person in the matte, by a user's ONNX network: RTMPose, RTMW or ViTPose.

Input: the matte's box, 1.25 times as large, upright in the network's own size, RGB normalised as ImageNet. Outputs are
told apart by their shapes, for an input of H x W px and K keypoints of a known layout:

- SimCC (Li et al. 2022; RTMPose, RTMW): (1, K, s W) and (1, K, s H), one bin per 1/s px; the largest is the place
- heatmaps (ViTPose): (1, K, h, w), whose first and last pixels' centres are the input's (Huang et al. 2020, "The devil
  is in the details", which ViTPose is trained with); the peak is a Gaussian's (Zhang et al. 2020, DARK, eq. 9)
"""

from pathlib import Path

import cv2
import numpy as np

from hfb.errors import InputError
from hfb.initialization.joint_layouts import COCO_17, MORE_THAN_COCO
from hfb.initialization.landmarks import LANDMARKS, Region, cut_region
from hfb.initialization.person_landmarks import GRAYS, before_gray, stick_agreement
from hfb.matting.matting_protocol import matte_region
from hfb.networks.network_files import is_onnx
from hfb.networks.runtimes import OnnxNetwork, Outputs, normalised
from hfb.typing import Array, Float

_PADDING = 1.25
_USUAL_PX = (256, 192)
_SIDES_PX = range(32, 1537)  # of an input
_COUNTS = (17, 26, 133)
_LEAST_LOG = 1e-3
_BLUR_PX = 11  # of heatmaps before the peak is placed; both as in the papers' own evaluation
_ENDS = {"index": "wrist", "heel": "ankle", "foot_index": "ankle"}


class KeypointNetwork:
    """A network of 2D keypoints, loaded.

    Args:
        path: its ONNX file.

    Raises:
        InputError: something else.
    """

    def __init__(self, path: Path) -> None:
        """Load the file and run it once, so that another network is refused before anything is made."""
        if not is_onnx(path):
            raise InputError(f"{path}: --init keypoints takes an ONNX file, whose shapes say what it is; export it so")
        self._network = OnnxNetwork(path)
        shapes = self._network.input_shapes()
        (shape,) = shapes if len(shapes) == 1 else ((),)
        sides = tuple(usual if side is None else side for side, usual in zip(shape[2:], _USUAL_PX, strict=False))
        if (
            len(shape) != 4
            or shape[0] not in (1, None)
            or shape[1] not in (3, None)
            or not all(side in _SIDES_PX for side in sides)
        ):
            takes = " and ".join(map(str, shapes)).replace("None", "any")
            raise InputError(f"{path} takes {takes}: --init keypoints needs one input of (1, 3, height, width)")
        self._height, self._width = sides
        self._look(np.zeros((*sides, 3), np.float32))

    def find(
        self, frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], matte: Float[Array, "H W"]
    ) -> Float[Array, "K 3"]:
        """Return x, y [px] and confidence of the person's keypoints.

        Blur misleads such networks, and so does what stands behind a person: the person is looked at before walls of
        two grays, and the figure that agrees better with the matte is kept.

        Args:
            frame_linear: the blurred frame, linear light.
            plate_linear: the background plate, linear light in the frame's exposure.
            matte: the person's share of each pixel, not empty.
        """
        top, left, bottom, right = matte_region(matte, margin=0.0)
        step = _PADDING * max((bottom - top) / self._height, (right - left) / self._width)
        side = max(self._height, self._width)
        square = Region((left + right) / 2, (top + bottom) / 2, step * side, 0.0)
        rows, columns = ((side - one) // 2 for one in (self._height, self._width))
        found = []
        for gray in GRAYS:
            crop = cut_region(before_gray(frame_linear, plate_linear, matte, gray), square, side)
            points = self._look(crop[rows : rows + self._height, columns : columns + self._width])
            points[:, :2] = (points[:, :2] + (columns, rows) + 0.5 - side / 2) * step + (square.x, square.y)
            found.append(points)
        return max(found, key=lambda points: stick_agreement(_as_landmarks(points), matte))

    def _look(self, crop_srgb: Float[Array, "h w 3"]) -> Float[Array, "K 3"]:
        """Return x, y, confidence in a crop, (0, 0) being its first pixel's centre."""
        outputs = self._network([normalised(crop_srgb, "imagenet", "rgb")])
        shapes = [one.shape for one in outputs.arrays]
        counts = {shape[1] for shape in shapes if len(shape) in (3, 4) and shape[0] == 1}
        if len(counts) == 1 and counts <= {*_COUNTS}:
            lengths = [shape[2:] for shape in shapes]
            if [*map(len, lengths)] == [1, 1]:
                for x, y in ((0, 1), (1, 0)):
                    bins = lengths[x][0] / self._width
                    if bins >= 1 and bins == lengths[y][0] / self._height:
                        across, down = outputs.arrays[x][0], outputs.arrays[y][0]
                        sure = np.minimum(across.max(1), down.max(1))  # as the less sure of both axes
                        return np.column_stack([across.argmax(1) / bins, down.argmax(1) / bins, sure])
            if [*map(len, lengths)] == [2] and min(lengths[0]) > 2:
                (height, width) = lengths[0]
                if height * self._width == width * self._height:
                    scale = (self._width - 1) / (width - 1), (self._height - 1) / (height - 1)
                    return _peaks(outputs.arrays[0][0]) * (*scale, 1)
        raise InputError(self._refusal(outputs))

    def _refusal(self, outputs: Outputs) -> str:
        shapes = " and ".join(str(one.shape) for one in outputs.arrays[:4])
        return (
            f"{outputs.source} gives {shapes} for an input of {self._height} x {self._width} px: --init keypoints "
            f"needs RTMPose's (1, K, {2 * self._width}) and (1, K, {2 * self._height}) or ViTPose's (1, K, "
            f"{self._height // 4}, {self._width // 4}) with K = {', '.join(map(str, _COUNTS))} keypoints"
        )


def _peaks(maps: Float[Array, "K h w"]) -> Float[Array, "K 3"]:
    """Return the peaks: from the largest pixel one step of Newton's method on the logarithm, a Gaussian's parabola."""
    rows = []
    for one in maps:
        y, x = (int(at) for at in np.unravel_index(one.argmax(), one.shape))
        smooth = cv2.GaussianBlur(one, (_BLUR_PX, _BLUR_PX), 0, borderType=cv2.BORDER_CONSTANT)
        smooth *= one.max() / max(float(smooth.max()), 1e-9)
        around = np.pad(np.log(np.maximum(smooth, _LEAST_LOG)), 1, mode="edge")[y : y + 3, x : x + 3].astype(np.float64)
        slope = np.array([around[1, 2] - around[1, 0], around[2, 1] - around[0, 1]]) / 2
        across = (around[2, 2] - around[2, 0] - around[0, 2] + around[0, 0]) / 4
        bend = around[1, [0, 2]].sum() - 2 * around[1, 1], around[[0, 2], 1].sum() - 2 * around[1, 1]
        curvature = np.array([[bend[0], across], [across, bend[1]]])
        is_peak = bend[0] < 0 and np.linalg.det(curvature) > 1e-12
        offset = np.clip(-np.linalg.solve(curvature, slope), -1, 1) if is_peak else np.zeros(2)
        rows.append((x + offset[0], y + offset[1], float(one.max())))
    return np.array(rows)


def _as_landmarks(points: Float[Array, "K 3"]) -> Float[Array, "33 2"]:
    """Return places of MediaPipe's landmarks, of which a stick figure is drawn; hands and feet end where unknown."""
    named = dict(enumerate(COCO_17)) | MORE_THAN_COCO.get(len(points), {})
    at = {name: points[number, :2] for number, name in named.items()}
    for side in ("left", "right"):
        for end, joint in _ENDS.items():
            at.setdefault(f"{side}_{end}", at[f"{side}_{joint}"])
    return np.stack([at.get(name, at["nose"]) for name in LANDMARKS])
