"""33 landmarks of a person by MediaPipe's two pose networks, run under LiteRT.

The networks are used as their model cards describe them: a detector proposes regions (centre of the hips, size
and upright direction of the whole body), a second network finds the landmarks in the turned square region, in the
image and in metres. The decoding is written from those descriptions. Input images are sRGB.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np

from hfb.errors import InputError
from hfb.networks.mediapipe_files import LandmarkChoice, networks_in_use
from hfb.typing import Array, Float

LANDMARKS = (
    "nose",
    "left_eye_inner",
    "left_eye",
    "left_eye_outer",
    "right_eye_inner",
    "right_eye",
    "right_eye_outer",
    "left_ear",
    "right_ear",
    "mouth_left",
    "mouth_right",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_pinky",
    "right_pinky",
    "left_index",
    "right_index",
    "left_thumb",
    "right_thumb",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
    "left_heel",
    "right_heel",
    "left_foot_index",
    "right_foot_index",
)
LANDMARK = {name: index for index, name in enumerate(LANDMARKS)}
_OTHER_SIDE = [LANDMARK[name.replace("left", "-").replace("right", "left").replace("-", "right")] for name in LANDMARKS]

_DETECTOR_PX, _LANDMARK_PX = 224, 256
_STRIDES = (8, 16, 32, 32, 32)
_ANCHORS_PER_CELL = 2
_REGION_SCALE = 1.25
_one_at_a_time = Lock()  # an interpreter belongs to one thread at a time


@dataclass(frozen=True)
class Region:
    """A rotated square of the image around the whole person.

    Attributes:
        x: its centre [px], near the hips.
        y: its centre [px], near the hips.
        size: its side [px].
        angle: clockwise turn of the person's upright direction [rad]; 0 stands upright.
        score: the detector's score, 0 to 1.
    """

    x: float
    y: float
    size: float
    angle: float
    score: float = 1.0

    def mirrored(self, width_px: float) -> "Region":
        """Return the same square of the mirror image.

        Args:
            width_px: width of the image [px].
        """
        return replace(self, x=width_px - self.x, angle=-self.angle)


@dataclass(frozen=True)
class Landmarks:
    """The second network's result in one region.

    Attributes:
        pixels: x, y [px of the image] of the 33 points.
        world: metres, hips at the origin; x right, y down, z away along the view ray of the region's centre.
        visibility: probability that a point is inside the image and not hidden.
        score: probability that there is a person in the region.
        next_region: region for the next pass over the same person.
    """

    pixels: Float[Array, "33 2"]
    world: Float[Array, "33 3"]
    visibility: Float[Array, "33"]
    score: float
    region: Region
    next_region: Region

    def mirrored(self, width_px: float) -> "Landmarks":
        """Return the mirror image: left and right change places.

        Args:
            width_px: width of the image [px].
        """
        return replace(
            self,
            pixels=self.pixels[_OTHER_SIDE] * (-1, 1) + (width_px, 0),
            world=self.world[_OTHER_SIDE] * (-1, 1, 1),
            visibility=self.visibility[_OTHER_SIDE],
            region=self.region.mirrored(width_px),
            next_region=self.next_region.mirrored(width_px),
        )


def networks_ready(choice: LandmarkChoice = "auto") -> bool:
    """Return whether the files and the interpreter are available. Raises InputError as `networks_in_use`.

    Args:
        choice: which landmark network.
    """
    try:
        import ai_edge_litert.interpreter  # noqa: F401
    except ImportError:
        return False
    return bool(networks_in_use(choice))


class PoseNetworks:
    """The networks, loaded; one thread, deterministic.

    Attributes:
        opinions: numbers of the landmark networks, the best first.

    Args:
        choice: choice among the landmark networks.

    Raises:
        InputError: a file or the interpreter is missing; the text says how to get it.
    """

    def __init__(self, choice: LandmarkChoice = "auto") -> None:
        files = networks_in_use(choice)
        if not files:
            raise InputError("the pose networks are not there; run `hfb models fetch`, or use `--init.method matte`.")
        self._detector, *self._landmarkers = map(_load, files)
        self.opinions = range(len(self._landmarkers))

    def detect(self, picture_srgb: Float[Array, "H W 3"], least_score: float = 0.3, most: int = 3) -> list[Region]:
        """Detect people in an image, best first, none overlapping another's centre.

        Args:
            picture_srgb: the image.
            least_score: lowest score of a returned detection.
            most: detections that are returned.
        """
        height, width = picture_srgb.shape[:2]
        side = max(height, width)
        left, top = (side - width) / 2, (side - height) / 2
        scale = _DETECTOR_PX / side
        # Pixel centres lie at half-integers in the image, at integers in OpenCV.
        warp = np.array([[scale, 0, (left + 0.5) * scale - 0.5], [0, scale, (top + 0.5) * scale - 0.5]])
        reduced = _reduce(picture_srgb, scale)
        warp[:, :2] *= picture_srgb.shape[0] / reduced.shape[0]
        square = cv2.warpAffine(reduced, warp, (_DETECTOR_PX, _DETECTOR_PX), flags=cv2.INTER_LINEAR)
        boxes, scores = self._run(self._detector, square * 2 - 1, ("Identity", "Identity_1"))
        scores = 1 / (1 + np.exp(-np.clip(scores.reshape(-1), -50, 50)))
        anchors = _anchors()
        regions: list[Region] = []
        for index in np.argsort(-scores):
            if scores[index] < least_score or len(regions) == most:
                break
            points = boxes.reshape(len(anchors), -1)[index, 4:].reshape(-1, 2) / _DETECTOR_PX + anchors[index]
            hips, reach = points[0] * side - (left, top), points[1] * side - (left, top)
            region = _region(hips, reach, float(scores[index]))
            if all(np.hypot(region.x - r.x, region.y - r.y) > 0.25 * max(region.size, r.size) for r in regions):
                regions.append(region)
        return regions

    def locate(self, picture_srgb: Float[Array, "H W 3"], region: Region, opinion: int = 0) -> Landmarks:
        """Return the landmarks of the person in a region.

        Args:
            picture_srgb: the image.
            region: square around the person.
            opinion: number of the landmark network that is asked.
        """
        crop = cut_region(picture_srgb, region, _LANDMARK_PX)
        points, score, world = self._run(self._landmarkers[opinion], crop, ("Identity", "Identity_1", "Identity_4"))
        points = points.reshape(39, 5).astype(np.float64)
        cosine, sine = np.cos(region.angle), np.sin(region.angle)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        pixels = ((points[:, :2] / _LANDMARK_PX - 0.5) * region.size) @ turn.T + (region.x, region.y)
        metres = world.reshape(39, 3).astype(np.float64)
        metres[:, :2] = metres[:, :2] @ turn.T
        return Landmarks(
            pixels=pixels[:33],
            world=metres[:33],
            visibility=1 / (1 + np.exp(-np.clip(np.minimum(points[:33, 3], points[:33, 4]), -50, 50))),
            score=float(score.reshape(-1)[0]),
            region=region,
            next_region=_region(pixels[33], pixels[34], float(score.reshape(-1)[0])),
        )

    @staticmethod
    def _run(network: Any, picture: Float[Array, "H W 3"], outputs: tuple[str, ...]) -> list[np.ndarray]:
        with _one_at_a_time:
            network.set_tensor(network.get_input_details()[0]["index"], picture[None].astype(np.float32))
            network.invoke()
            by_name = {detail["name"]: detail["index"] for detail in network.get_output_details()}
            return [network.get_tensor(by_name[name]) for name in outputs]


def cut_region(picture_srgb: Float[Array, "H W 3"], region: Region, side_px: int) -> Float[Array, "s s 3"]:
    """Resample the turned square as an upright image; black outside the frame.

    Args:
        picture_srgb: the image.
        region: square to cut out.
        side_px: side of the result [px].
    """
    scale = min(1.0, 2 * side_px / region.size)
    reduced = _reduce(picture_srgb, scale)
    scale = reduced.shape[0] / picture_srgb.shape[0]
    cosine, sine = np.cos(region.angle), np.sin(region.angle)
    step = region.size / side_px
    # Crop pixel centre (i + 0.5) -> offset from the region's centre -> image -> reduced image's index.
    linear = np.array([[cosine, -sine], [sine, cosine]]) * step
    offset = linear @ np.full(2, 0.5 - side_px / 2) + (region.x, region.y)
    warp = np.hstack([linear * scale, (offset * scale - 0.5)[:, None]])
    return cv2.warpAffine(reduced, warp, (side_px, side_px), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def _reduce(picture: Float[Array, "H W 3"], scale: float) -> Float[Array, "h w 3"]:
    """Average areas so that the following interpolation skips no pixel; never enlarges."""
    picture = np.asarray(picture, np.float32)
    if scale >= 1:
        return picture
    height, width = picture.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def _region(hips: Float[Array, "2"], reach: Float[Array, "2"], score: float) -> Region:
    """Return the square around the circle through `reach` (above the head of an upright person) about the hips."""
    dx, dy = reach - hips
    angle = np.pi / 2 - np.arctan2(-dy, dx)
    angle -= 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))
    size = max(2.0, 2 * _REGION_SCALE * float(np.hypot(dx, dy)))
    return Region(float(hips[0]), float(hips[1]), size, float(angle), score)


@lru_cache
def _anchors() -> Float[Array, "2254 2"]:
    """Return centres of the detector's anchors: two per cell and layer, layers of one stride share a grid."""
    centres = []
    for stride in sorted(set(_STRIDES)):
        cells = -(-_DETECTOR_PX // stride)
        grid = (np.arange(cells) + 0.5) / cells
        y, x = np.meshgrid(grid, grid, indexing="ij")
        repeat = _ANCHORS_PER_CELL * _STRIDES.count(stride)
        centres.append(np.repeat(np.stack([x, y], -1).reshape(-1, 2), repeat, axis=0))
    return np.concatenate(centres)


def forget_networks() -> None:
    """Free the networks' memory, 186 MB of all three; they are loaded again at their next use."""
    _load.cache_clear()


@lru_cache
def _load(path: Path) -> Any:
    """Return an interpreter of LiteRT, which has no types; one per process, since the largest takes 105 MB and .1 s.

    A file of this name is used only with the content that is known.
    """
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError:
        raise InputError("the pose networks need ai-edge-litert; run `pip install ai-edge-litert`.") from None
    interpreter = Interpreter(model_path=str(path), num_threads=1)
    interpreter.allocate_tensors()
    return interpreter
