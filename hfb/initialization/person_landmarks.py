"""Landmarks of the person in the matte: of many proposals the one that agrees best with it.

Blur makes the detector miss and the second network invent limbs, whereas the matte shows where the person is. So
regions come from the detector and from the matte itself, the networks look at the person before a gray and a light
wall in place of the plate, and every result is drawn as a stick figure and compared with the matte. In the region of
the best one all landmark networks look at both walls and at their mirror images, where errors differ; medians count.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import cv2
import numpy as np

from hfb.initialization.landmarks import LANDMARK, Landmarks, PoseNetworks, Region
from hfb.matting.matting_protocol import matte_region
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float, Shaped

GRAYS = (0.21, 0.6)
"""Walls before which a person is looked at, linear light: dark clothes show before one, pale ones before the other."""
_NEAR, _NOTHING = 0.2, 0.02
"""Share of the matte's box beyond which nothing is the person's, and the alpha below which a matte is empty."""
_STICK_FIGURE_PX = 128
_LEAST_SCORE = 0.5
_SURE_AGREEMENT, _GOOD_AGREEMENT, _REGIONS = 0.65, 0.55, 8
"""Other regions are tried until the figure is sure, or, after so many, good: the first six may be the detector's."""
# Limbs as (from, to, radius relative to the trunk's length).
_LIMBS = (
    ("left_shoulder", "left_elbow", 0.10),
    ("left_elbow", "left_wrist", 0.08),
    ("left_wrist", "left_index", 0.07),
    ("right_shoulder", "right_elbow", 0.10),
    ("right_elbow", "right_wrist", 0.08),
    ("right_wrist", "right_index", 0.07),
    ("left_hip", "left_knee", 0.15),
    ("left_knee", "left_ankle", 0.10),
    ("left_heel", "left_foot_index", 0.07),
    ("right_hip", "right_knee", 0.15),
    ("right_knee", "right_ankle", 0.10),
    ("right_heel", "right_foot_index", 0.07),
    ("left_shoulder", "right_shoulder", 0.12),
    ("left_hip", "right_hip", 0.16),
)


def find_landmarks(
    networks: PoseNetworks,
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    matte: Float[Array, "H W"],
) -> tuple[Landmarks, float] | None:
    """Return the best landmarks with their agreement (see `stick_agreement`), or None where no region held a person.

    Args:
        networks: loaded pose networks.
        frame_linear: the blurred frame, linear light.
        plate_linear: the background plate, linear light in the frame's exposure.
        matte: the person's share of each pixel, not empty.
    """
    pictures = [before_gray(frame_linear, plate_linear, matte, gray) for gray in GRAYS]
    best: tuple[Landmarks, float] | None = None
    best_value, of_picture = 0.0, pictures[0]
    for number, region in enumerate(_proposals(networks, pictures, matte), start=1):
        for picture in pictures:
            found = networks.locate(picture, region)
            if found.score < _LEAST_SCORE:
                continue
            again = networks.locate(picture, found.next_region)
            found = again if again.score >= found.score - 0.05 else found
            agreement = stick_agreement(found.pixels, matte)
            value = agreement * (0.5 + 0.5 * found.score)
            if value > best_value:
                best, best_value, of_picture = (found, agreement), value, picture
        if best is not None and best[1] > (_SURE_AGREEMENT if number < _REGIONS else _GOOD_AGREEMENT):
            break
    if best is None:
        return None
    median = seen_all_ways(networks, [of_picture, *(one for one in pictures if one is not of_picture)], best[0])
    return median, stick_agreement(median.pixels, matte)


def seen_all_ways(networks: PoseNetworks, pictures: Sequence[Float[Array, "H W 3"]], found: Landmarks) -> Landmarks:
    """Return the medians of all networks' landmarks in all images and their mirror images, in the same region.

    Few of the looks confuse limbs, and not the same ones. Looks that see nobody do not count.

    Args:
        networks: loaded pose networks.
        pictures: the image in which the best network found them, and others of the same person.
        found: the landmarks.
    """
    width, looks = pictures[0].shape[1], [found]
    for opinion, picture in product(networks.opinions, pictures):
        if opinion or picture is not pictures[0]:
            looks.append(networks.locate(picture, found.region, opinion))
        mirror_image = np.ascontiguousarray(picture[:, ::-1])
        looks.append(networks.locate(mirror_image, found.region.mirrored(width), opinion).mirrored(width))
    looks = [one for one in looks if one.score >= _LEAST_SCORE]
    return replace(
        found,
        pixels=np.median([one.pixels for one in looks], axis=0),
        world=np.median([one.world for one in looks], axis=0),
        visibility=np.mean([one.visibility for one in looks], axis=0),
    )


def _proposals(
    networks: PoseNetworks, pictures: Sequence[Float[Array, "H W 3"]], matte: Float[Array, "H W"]
) -> Iterator[Region]:
    """Yield regions to try, the likeliest first: the detector around the matte, then the matte's own box and axis."""
    top, left, bottom, right = matte_region(matte, margin=0.3)
    window = (slice(top, bottom), slice(left, right))
    for picture in pictures:
        for region in networks.detect(picture[window]):
            moved = Region(region.x + left, region.y + top, region.size, region.angle, region.score)
            if _near(moved, matte):
                yield moved
    top, left, bottom, right = matte_region(matte, margin=0.0)
    rows, columns = np.mgrid[top:bottom, left:right] + 0.5
    weight = matte[top:bottom, left:right].astype(np.float64)
    weight /= weight.sum()
    y, x = float((rows * weight).sum()), float((columns * weight).sum())
    spread = np.cov(np.stack([columns.ravel(), rows.ravel()]), aweights=weight.ravel(), bias=True)
    values, axes = np.linalg.eigh(spread)
    along = axes[:, 1] * (-1 if axes[1, 1] > 0 else 1)  # the long axis, pointing up
    angle = float(np.arctan2(along[0], -along[1]))
    size = max(1.25 * (bottom - top), 1.25 * (right - left), 5.2 * float(np.sqrt(values[1])))
    for turn in (0.0, angle, angle / 2, -0.5, 0.5):
        for scale in (1.0, 1.25):
            yield Region(x, y, size * scale, turn)


def _near(region: Region, matte: Float[Array, "H W"]) -> bool:
    """Return whether the region's middle holds a part of the matte, since a bystander in the plate is a person, too."""
    half = max(2, round(region.size * 0.2))
    y, x = round(region.y), round(region.x)
    middle = matte[max(0, y - half) : max(0, y + half), max(0, x - half) : max(0, x + half)]
    return bool(middle.size and middle.max() > 0.2)


def before_gray(
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    matte: Float[Array, "H W"],
    gray: float,
) -> Float[Array, "H W 3"]:
    """Return the person before a gray wall, sRGB: eq. (1) with another plate.

    The plate that shows through the blur goes, too, unlike in the product of frame and matte. A limb that the matte
    lacks stays where it differs from the plate; what is far from the matte is somebody else, and goes.

    Args:
        frame_linear: the blurred frame, linear light.
        plate_linear: the background plate, linear light in the frame's exposure.
        matte: the person's share of each pixel, not empty.
        gray: the wall, linear light.
    """
    wall = linear_to_srgb(np.full(3, gray, np.float32))
    picture = np.broadcast_to(wall, frame_linear.shape).copy()
    top, left, bottom, right = matte_region(matte, margin=_NEAR)
    inner = (slice(top, bottom), slice(left, right))
    alpha, reach = matte[inner], _NEAR * max(bottom - top, right - left)
    apart = cv2.distanceTransform((alpha < _NOTHING).astype(np.uint8), cv2.DIST_L2, 3)
    near = np.clip(2 - 2 * apart / reach, 0, 1)[..., None]
    seen = frame_linear[inner] + (1 - alpha[..., None]) * (gray - plate_linear[inner])
    picture[inner] += near * (linear_to_srgb(np.clip(seen, 0, 1)) - picture[inner])
    return picture


def stick_agreement(pixels: Float[Array, "33 2"], matte: Float[Array, "H W"]) -> float:
    """Return the soft IoU (sum min / sum max) of the matte and a stick figure with typical limb widths.

    Args:
        pixels: places of the landmarks [px].
        matte: the person's share of each pixel.
    """
    top, left, bottom, right = matte_region(matte, margin=0.25)
    scale = _STICK_FIGURE_PX / max(bottom - top, right - left)
    size = (max(8, round((right - left) * scale)), max(8, round((bottom - top) * scale)))
    target = cv2.resize(matte[top:bottom, left:right], size, interpolation=cv2.INTER_AREA)
    figure = draw_stick_figure((pixels - (left, top)) * scale, (size[1], size[0])).astype(np.float32)
    # Parts of the figure outside the image count against it only where the image could have shown them.
    return float(np.minimum(target, figure).sum() / max(np.maximum(target, figure).sum(), 1e-6))


def draw_stick_figure(pixels: Float[Array, "33 2"], shape: tuple[int, int]) -> Shaped[Array, "h w"]:
    """Draw a figure of 0 and 1: trunk, head and limbs as thick lines.

    Args:
        pixels: places of the landmarks [px].
        shape: height and width of the image [px].
    """
    figure = np.zeros(shape, np.uint8)
    at = {name: pixels[index] for name, index in LANDMARK.items()}
    shoulders = (at["left_shoulder"] + at["right_shoulder"]) / 2
    hips = (at["left_hip"] + at["right_hip"]) / 2
    trunk = trunk_length(pixels)
    for start, end, radius in _LIMBS:
        _line(figure, at[start], at[end], 2 * radius * trunk)
    outline = [at[n] for n in ("left_shoulder", "right_shoulder", "right_hip", "left_hip")]
    cv2.fillConvexPoly(figure, cv2.convexHull(np.round(outline).astype(np.int32)), 1)
    _line(figure, shoulders, hips, 0.45 * trunk)
    head = (at["left_ear"] + at["right_ear"]) / 2
    _line(figure, shoulders, head, 0.22 * trunk)
    _line(figure, head, head + 0.1 * (head - shoulders), 0.42 * trunk)
    return figure


def trunk_length(pixels: Float[Array, "33 2"]) -> float:
    """Return the length of a person's trunk in the image [px], or what a thigh says where it is foreshortened.

    Args:
        pixels: places of the landmarks [px].
    """
    at = {name: pixels[index] for name, index in LANDMARK.items()}
    along = at["left_shoulder"] + at["right_shoulder"] - at["left_hip"] - at["right_hip"]
    return max(float(np.hypot(*along)) / 2, 0.6 * float(np.hypot(*(at["left_hip"] - at["left_knee"]))), 2.0)


def _line(figure: Shaped[Array, "h w"], start: Float[Array, "2"], end: Float[Array, "2"], thickness: float) -> None:
    limit = 4 * max(figure.shape)
    first, last = (tuple(int(v) for v in np.clip(np.round(p), -limit, limit)) for p in (start, end))
    cv2.line(figure, first, last, 1, max(1, min(round(thickness), 255)))
