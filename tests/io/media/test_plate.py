"""The background: median, still span, and plates that must be refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.media.footage import Footage, open_footage
from hfb.io.media.images.image_io import write_png
from hfb.io.media.plate import check_plate, find_plate, seems_to_hold_person

HEIGHT, WIDTH = 60, 90


def scene() -> np.ndarray:
    """A wall with posters."""
    rng = np.random.default_rng(3)
    wall = np.full((HEIGHT, WIDTH, 3), 0.55, np.float32)
    for _ in range(12):
        top, left = rng.integers(0, HEIGHT - 12), rng.integers(0, WIDTH - 18)
        wall[top : top + rng.integers(4, 12), left : left + rng.integers(4, 18)] = rng.uniform(0.2, 0.9, 3)
    return wall


def with_person(picture: np.ndarray, left: int, number: int) -> np.ndarray:
    """Somebody in clothes whose pattern moves with them, an arm up or down."""
    out = picture.copy()
    body = np.random.default_rng(8).uniform(0, 1, (30, 12, 3)).astype(np.float32)
    out[20:50, left : left + 12] = np.roll(body, number % 3, axis=0)
    out[26 - 4 * (number % 3) : 30, left + 12 : left + 18] = (0.8, 0.6, 0.5)
    return out


def footage(folder: Path, places: list[int | None]) -> Footage:
    rng = np.random.default_rng(0)
    for number, left in enumerate(places):
        picture = scene() if left is None else with_person(scene(), left, left)
        write_png(folder / f"{number:03d}.png", np.clip(picture + rng.normal(0, 0.004, picture.shape), 0, 1))
    return open_footage(folder, fps=25)


WALK: list[int | None] = list(range(2, 62, 3))


def test_the_median_of_a_walk_is_the_empty_scene(tmp_path: Path) -> None:
    plate, told = find_plate(footage(tmp_path, WALK), "median")
    assert np.abs(plate - scene()).max() < 0.05
    assert "median of 19 frames" in told


def test_the_longest_still_span(tmp_path: Path) -> None:
    places = [*WALK[:6], None, None, None, *WALK[6:12], *[None] * 9, *WALK[12:]]
    plate, told = find_plate(footage(tmp_path, places), "still")
    assert np.abs(plate - scene()).max() < 0.03
    assert "frames 15 to 23" in told
    with pytest.raises(InputError, match="something moves all the time"):
        find_plate(footage(tmp_path / "walk", WALK), "still")


def test_a_still_span_in_which_somebody_waits_is_passed_over(tmp_path: Path) -> None:
    places = [*[40] * 12, *WALK[:14], *[None] * 7, *WALK[14:]]
    plate, told = find_plate(footage(tmp_path / "both", places), "still")
    assert np.abs(plate - scene()).max() < 0.03
    assert "frames 26 to 32" in told
    with pytest.raises(InputError, match="still holds the person"):
        find_plate(footage(tmp_path / "waits", [*[40] * 12, *WALK]), "still")


def test_a_plate_from_a_file(tmp_path: Path) -> None:
    walk = footage(tmp_path / "frames", WALK)
    write_png(tmp_path / "plate.png", scene())
    plate, told = find_plate(walk, tmp_path / "plate.png")
    assert np.abs(plate - scene()).max() < 0.003
    assert "plate.png" in told


def test_plates_that_do_not_belong(tmp_path: Path) -> None:
    walk = footage(tmp_path, WALK)
    with pytest.raises(InputError, match=r"90 x 60.*80 x 60"):
        check_plate(scene()[:, :80], walk)
    with pytest.raises(InputError, match="nearly everywhere"):
        check_plate(scene()[:, ::-1].copy(), walk)
    with pytest.raises(InputError, match="nearly everywhere"):
        check_plate(np.roll(scene(), 6, axis=1), walk)
    check_plate(scene(), walk)


def test_a_plate_that_still_holds_the_person(tmp_path: Path) -> None:
    walk = footage(tmp_path / "walk", WALK)
    with pytest.raises(InputError, match="still holds the person"):
        check_plate(with_person(scene(), 40, 0), walk)
    waits = footage(tmp_path / "waits", [*[10] * 13, *WALK[6:14]])  # the median keeps who stands still most of the time
    with pytest.raises(InputError, match="still holds the person"):
        find_plate(waits, "median")


def test_a_few_frames_make_a_doubt_of_it(tmp_path: Path) -> None:
    write_png(tmp_path / "plate.png", with_person(scene(), 40, 0))
    _, told = find_plate(footage(tmp_path / "few", WALK[:14]), tmp_path / "plate.png")
    assert "seems that the background still holds the person" in told
    with pytest.raises(InputError, match="still holds the person"):
        find_plate(footage(tmp_path / "more", WALK[:15]), tmp_path / "plate.png")


def test_who_stands_still_is_no_ghost(tmp_path: Path) -> None:
    check_plate(scene(), footage(tmp_path / "still", [30] * 15))
    both = [with_person(with_person(scene(), 60, 0), left, left) for left in WALK[:16]]
    for number, picture in enumerate(both):
        write_png(tmp_path / "two" / f"{number:03d}.png", picture)
    check_plate(scene(), open_footage(tmp_path / "two", fps=25))


def test_one_frame_may_tell_a_plate_that_holds_the_person() -> None:
    for left in (2, 14, 66):
        frame = with_person(scene(), left, left)
        smeared = cv2.blur(frame, (15, 1))
        for seen in (frame, np.where(np.abs(frame - scene()).max(-1, keepdims=True) > 0, smeared, frame)):
            assert not seems_to_hold_person(seen, scene())
            assert seems_to_hold_person(seen, with_person(scene(), 40, 0))
