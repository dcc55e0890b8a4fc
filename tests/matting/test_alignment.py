"""A plate beside the frame: its movement is found behind a person, to a tenth of a pixel, and only where there is."""

import cv2
import numpy as np
import pytest

from hfb.matting.alignment import Movement, aligned_plate, find_movement, moved_plate
from hfb.photometry import linear_to_srgb
from tests.matting.silhouettes import composite, generated_plate
from tests.matting.textures import texture


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
    from hfb.matting.matting_protocol import KnownBackground

    scene = composite(generated_plate("stripes"), 16, 7)
    right = np.abs(KnownBackground()(scene.frame, scene.plate) - scene.alpha).mean()
    beside = np.abs(KnownBackground()(scene.frame, moved(scene.plate, 0.9, -0.6)) - scene.alpha).mean()
    assert beside < 1.5 * right + 0.004


def shifted_exactly(picture: np.ndarray, right_px: float, down_px: float) -> np.ndarray:
    """The same picture sampled elsewhere, by Fourier's shift theorem; its mirror images continue it."""
    height, width = picture.shape[:2]
    tile = np.concatenate([picture, picture[:, ::-1]], 1)
    tile = np.concatenate([tile, tile[::-1]], 0)
    down, right = np.fft.fftfreq(2 * height)[:, None, None], np.fft.fftfreq(2 * width)[None, :, None]
    phase = np.exp(-2j * np.pi * (right * right_px + down * down_px))
    moved = np.fft.ifft2(np.fft.fft2(tile, axes=(0, 1)) * phase, axes=(0, 1)).real
    return moved[:height, :width].astype(np.float32)


def band_limited(kind: str) -> np.ndarray:
    """A texture without the sharpest edges, as a lens shows it: only such a picture can be shifted exactly."""
    return cv2.GaussianBlur(texture(kind, np.random.default_rng(1)), (0, 0), 0.7)


def encoded(picture_linear: np.ndarray) -> np.ndarray:
    """Levels of 8 bits, the border left out."""
    return 255 * linear_to_srgb(np.clip(picture_linear, 0, 1))[12:-12, 12:-12]


@pytest.mark.parametrize("kind", ["smooth", "fine", "pink", "stripes", "checks"])
@pytest.mark.parametrize("shift_px", [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.95])
@pytest.mark.parametrize("axis", ["right", "down"])
def test_a_fraction_of_a_pixel_is_found_and_undone(kind: str, shift_px: float, axis: str) -> None:
    frame = band_limited(kind)
    wanted = np.array([shift_px, 0.0] if axis == "right" else [0.0, shift_px])
    plate = shifted_exactly(frame, *wanted)
    movement = find_movement(frame, plate)
    assert movement is not None
    np.testing.assert_allclose(movement.shift * max(frame.shape), wanted, atol=0.01)

    back = aligned_plate(frame, plate)
    left_over = np.abs(encoded(back) - encoded(frame)).mean()
    assert left_over <= 0.2 * np.abs(encoded(plate) - encoded(frame)).mean() + 0.01
    if kind in ("smooth", "fine", "pink"):  # edges of stripes and checks hold more than any kernel can shift
        assert left_over <= 0.05


@pytest.mark.parametrize("size", [(96, 160), (720, 1280)])
def test_a_moved_plate_lands_where_the_movement_says(size: tuple[int, int]) -> None:
    """A ramp shows the place of every pixel; OpenCV's cubic kernel shows 0.136 px for 0.1."""
    height, width = size
    ramp = np.repeat((np.mgrid[:height, :width].sum(0) / (height + width)).astype(np.float32)[..., None], 3, -1)
    for shift_px in (0.05, 0.1, 0.26, 0.3, 0.75):
        moved = moved_plate(ramp, Movement(np.array([shift_px, 0.0]) / max(size), 0.0, 0.0))
        inside = (moved - ramp)[16:-16, 16:-16] * (height + width)
        np.testing.assert_allclose(inside, shift_px, atol=0.002)


def test_a_large_plate_is_right_to_a_hundredth_of_its_own_pixels() -> None:
    frame = cv2.resize(band_limited("pink"), (1280, 960), interpolation=cv2.INTER_LANCZOS4)
    movement = find_movement(frame, shifted_exactly(frame, 0.3, -0.2))
    assert movement is not None
    np.testing.assert_allclose(movement.shift * 1280, [0.3, -0.2], atol=0.01)
