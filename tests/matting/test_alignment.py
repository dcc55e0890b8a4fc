"""A plate beside the frame: its movement is found behind a person, to a tenth of a pixel, and only where there is."""

import cv2
import numpy as np
import pytest

from hfb.matting.alignment import aligned_plate, find_movement
from tests.matting.silhouettes import composite, generated_plate


def moved(picture: np.ndarray, right_px: float, down_px: float, turn_deg: float = 0.0) -> np.ndarray:
    """What a camera sees that was shifted and turned about the picture's middle."""
    height, width = picture.shape[:2]
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), turn_deg, 1.0)
    matrix[:, 2] += (right_px, down_px)
    return cv2.warpAffine(picture, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize(("right_px", "down_px", "turn_deg"), [(0.6, -0.4, 0.0), (-1.3, 0.9, 0.15), (2.4, 1.0, -0.1)])
@pytest.mark.parametrize("gain", [1.0, 1.12])
def test_finds_a_small_movement_behind_a_person(right_px: float, down_px: float, turn_deg: float, gain: float) -> None:
    scene = composite(generated_plate("clouds"), 24, 3, gain=gain)
    plate = moved(scene.plate, right_px, down_px, turn_deg)
    movement = find_movement(scene.frame, plate)
    assert movement is not None
    height, width = plate.shape[:2]
    # Where the corners of the frame lie in the plate, against where they were put.
    corners = np.array([[0, 0, 1], [width - 1, 0, 1], [0, height - 1, 1], [width - 1, height - 1, 1]], float)
    wanted = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), turn_deg, 1.0)
    wanted[:, 2] += (right_px, down_px)
    apart = corners @ movement.matrix(height, width).T - corners @ wanted.T
    assert np.hypot(*apart.T).max() < 0.15
    inside = (slice(8, -8), slice(8, -8))
    empty = scene.alpha[inside] < 0.01
    after = np.abs(aligned_plate(scene.frame, plate) - scene.plate)[inside][empty].mean()
    assert after < 0.35 * np.abs(plate - scene.plate)[inside][empty].mean()


@pytest.mark.parametrize("kind", ["flat", "clouds", "stripes"])
def test_leaves_a_plate_that_lies_right(kind: str) -> None:
    scene = composite(generated_plate(kind), 24, 5, shadow=0.3)
    assert find_movement(scene.frame, scene.plate) is None
    assert aligned_plate(scene.frame, scene.plate) is scene.plate


def test_another_scene_is_not_moved() -> None:
    assert find_movement(generated_plate("stripes"), generated_plate("clouds")) is None


def test_a_moved_plate_costs_the_matte_little() -> None:
    from hfb.matting.matting import KnownBackground

    scene = composite(generated_plate("stripes"), 16, 7)
    right = np.abs(KnownBackground()(scene.frame, scene.plate) - scene.alpha).mean()
    beside = np.abs(KnownBackground()(scene.frame, moved(scene.plate, 0.9, -0.6)) - scene.alpha).mean()
    assert beside < 1.5 * right + 0.004
