"""A plate that does not belong to the frame is told; noise, shadow, a small gain and a small movement are none."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.datasets.example import write_example
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.video_reading import read_frames
from hfb.matting.plate_check import find_plate_mismatch
from hfb.photometry import srgb_to_linear
from tests.matting.silhouettes import Composite, composite, generated_plate, seen
from tests.matting.test_alignment import moved
from tests.shared import average_frames


def photograph(shared_data: Path, number: int) -> Composite:
    """A figure that moved before one of the photographs, with a shadow on the floor where the number is odd."""
    file = sorted((shared_data / "backgrounds" / "budgie").glob("*.jpg"))[number]
    plate = cv2.resize(linear(file), (384, 256), interpolation=cv2.INTER_AREA)
    return composite(plate, 24, number, shadow=0.35 * (number % 2))


def linear(file: Path) -> np.ndarray:
    return srgb_to_linear(read_picture_srgb(file)).astype(np.float32)


def lit(picture: np.ndarray, gain: float) -> np.ndarray:
    return seen(np.clip(gain * picture, 0, 1), 0.0, np.random.default_rng(0))


def shifted(picture: np.ndarray, right_px: float, down_px: float, turn_deg: float = 0.0) -> np.ndarray:
    return np.clip(moved(picture, right_px, down_px, turn_deg), 0, 1)


@pytest.mark.parametrize("number", [1, 4])
def test_what_belongs_together_passes(shared_data: Path, number: int) -> None:
    scene = photograph(shared_data, number)
    noisy = seen(scene.frame, 0.03, np.random.default_rng(1))
    for frame in (scene.frame, noisy, lit(scene.frame, 0.82), lit(scene.frame, 1.22)):
        assert find_plate_mismatch(frame, scene.plate) is None
    assert find_plate_mismatch(lit(scene.frame, 1.1), shifted(scene.plate, 2.2, -1.5, 0.1)) is None


def test_what_does_not_is_told(shared_data: Path) -> None:
    scene = photograph(shared_data, 1)
    for movement in ((4, 2), (0, 6), (-10, 3), (0, 0, 1.5)):
        said = find_plate_mismatch(scene.frame, shifted(scene.plate, *movement))
        assert said is not None
        assert "do not lie on each other" in said
        assert "exposure (by" not in said
    for gain in (0.5, 1.5):
        said = find_plate_mismatch(lit(scene.frame, gain), scene.plate)
        assert said is not None
        assert f"differ in exposure (by a factor of about {gain}" in said
        assert "lie on each other" not in said
    both = find_plate_mismatch(lit(scene.frame, 1.6), shifted(scene.plate, 5, 2))
    assert both is not None
    assert "do not lie on each other (about 5 px apart) and differ in exposure" in both


def test_the_example_moved_across_what_hides_it(tmp_path: Path) -> None:
    """The network takes the moved edges of this room for the person: outside of its matte nothing differs."""
    paths = write_example(tmp_path, 8)
    frame, plate = linear(paths.frame), linear(paths.background)
    assert find_plate_mismatch(frame, plate) is None
    assert find_plate_mismatch(frame, shifted(plate, 0, 6)) is not None


def test_distances_are_the_pictures_own(shared_data: Path) -> None:
    scene = photograph(shared_data, 4)
    frame, plate = (cv2.resize(one, None, fx=4, fy=4) for one in (scene.frame, shifted(scene.plate, 4, 0)))
    assert "about 16 px apart" in str(find_plate_mismatch(frame, plate))


def test_without_edges_or_without_room_there_is_nothing_to_judge() -> None:
    flat = np.full((40, 30, 3), 0.3, np.float32)
    assert find_plate_mismatch(flat, flat) is None
    assert find_plate_mismatch(flat[:6, :5], flat[:6, :5]) is None
    rng = np.random.default_rng(0)
    assert find_plate_mismatch(seen(generated_plate("flat"), 0.01, rng), generated_plate("flat")) is None


def test_real_clips_pass(shared_data: Path) -> None:
    room = shared_data / "bodypose3d_walkin"
    assert find_plate_mismatch(linear(room / "f006.png"), linear(room / "plate.png")) is None
    for folder, clip, plate in (
        ("pose2sim_balancing", "cam01_f000-059.mp4", "cam01_plate.png"),
        ("sports2d_park", "demo.mp4", "plate.png"),
    ):
        frame = average_frames(read_frames(shared_data / folder / clip, 20, 26))
        assert find_plate_mismatch(frame, linear(shared_data / folder / plate)) is None


@pytest.mark.parametrize(("right_px", "down_px"), [(14.0, -9.0), (22.0, -10.0), (-30.0, 10.0)])
@pytest.mark.parametrize("seed", [1, 3])
def test_a_stabilised_crop_that_moved_far_is_told_with_its_distance(
    tmp_path: Path, seed: int, right_px: float, down_px: float
) -> None:
    paths = write_example(tmp_path, seed)
    said = find_plate_mismatch(linear(paths.frame), shifted(linear(paths.background), right_px, down_px))
    found = re.search(r"\(about (\d+) px apart\)", str(said))
    assert found is not None
    assert int(found[1]) == pytest.approx(np.hypot(right_px, down_px), abs=1)
