"""A frame's exposure over its plate's: found whoever stands before it, exactly 1 where it is the same, undone."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.datasets.example import write_example
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.video_reading import read_frames
from hfb.matting.exposure_match import NO_GAIN, Gain, describe_gains, frame_gain, in_plate_exposure
from hfb.matting.network import NetworkMatting
from hfb.photometry import srgb_to_linear
from tests.matting.silhouettes import composite, generated_plate, seen
from tests.shared import average_frames

GAINS: tuple[Gain, ...] = ((1.25,) * 3, (0.8,) * 3, (1.1, 1, 0.9), (1.06,) * 3, (0.6,) * 3, (1.7,) * 3)


def room(shared_data: Path, number: int) -> np.ndarray:
    file = sorted((shared_data / "backgrounds" / "budgie").glob("*.jpg"))[number]
    return cv2.resize(linear(file), (384, 256), interpolation=cv2.INTER_AREA)


def linear(file: Path) -> np.ndarray:
    return srgb_to_linear(read_picture_srgb(file)).astype(np.float32)


def lit(picture: np.ndarray, gain: Gain | float) -> np.ndarray:
    """As a camera would have shown it: clipped, and in eight bits again."""
    return seen(picture * np.float32(gain), 0.0, np.random.default_rng(0))


def error(found: Gain, true: Gain | float) -> float:
    return float(np.abs(np.log(np.array(found) / true)).max())


@pytest.mark.parametrize("noise", [0.0, 0.006, 0.03])
@pytest.mark.parametrize("kind", ["flat", "clouds", "stripes"])
def test_the_same_exposure_is_exactly_one(kind: str, noise: float) -> None:
    scene = composite(generated_plate(kind), 24, 2, noise, shadow=0.35)
    assert frame_gain(scene.frame, scene.plate) == NO_GAIN


def test_the_example_and_real_clips_are_exactly_one(tmp_path: Path, shared_data: Path) -> None:
    paths = write_example(tmp_path, 8)
    assert frame_gain(linear(paths.frame), linear(paths.background)) == NO_GAIN
    walk = shared_data / "bodypose3d_walkin"
    assert frame_gain(linear(walk / "f006.png"), linear(walk / "plate.png")) == NO_GAIN
    for folder, clip, plate in (
        ("pose2sim_balancing", "cam01_f000-059.mp4", "cam01_plate.png"), ("sports2d_park", "demo.mp4", "plate.png")
    ):  # fmt: skip
        frame = average_frames(read_frames(shared_data / folder / clip, 20, 26))
        assert frame_gain(frame, linear(shared_data / folder / plate)) == NO_GAIN


@pytest.mark.parametrize("true", GAINS)
def test_what_it_finds(shared_data: Path, true: Gain) -> None:
    """Within a third of a percent, noise and clipped windows or not; channels alike have one value."""
    for plate in (generated_plate("clouds"), generated_plate("stripes"), room(shared_data, 1)):
        scene = composite(plate, 24, 4, 0.01)
        found = frame_gain(lit(scene.frame, true), scene.plate)
        assert error(found, true) < 0.0034
        assert (len(set(found)) == 1) == (len(set(true)) == 1)


@pytest.mark.parametrize("true", [1.0, 1.25, 0.8])
def test_somebody_who_covers_half_of_it_a_shade_and_a_plate_beside_it(shared_data: Path, true: float) -> None:
    plate = room(shared_data, 1)
    half = plate.copy()
    half[:, 60:250] = (0.32, 0.2, 0.14)  # a plain coat, very near
    shaded = plate.copy()
    shaded[:, :128] *= 0.8
    both = half.copy()
    both[:, 345:] *= 0.75
    for picture in (half, shaded, both, np.roll(composite(plate, 24, 4).frame, (1, 2), (0, 1))):
        frame = seen(picture * np.float32(true), 0.01, np.random.default_rng(1))
        assert error(frame_gain(frame, plate), true) < 0.01


def test_nothing_to_tell_by_is_one() -> None:
    plate = generated_plate("clouds")
    rng = np.random.default_rng(3)
    other = cv2.resize(rng.uniform(0, 1, (30, 24, 3)).astype(np.float32), plate.shape[1::-1])
    for frame, empty in (
        (other, plate), (np.ones_like(plate), plate), (np.zeros_like(plate), plate), (plate, np.zeros_like(plate)),
        (plate * 0.2, plate), (plate[:6, :5] * 1.2, plate[:6, :5]),
    ):  # fmt: skip
        assert frame_gain(frame.astype(np.float32), empty) == NO_GAIN


@pytest.mark.parametrize("true", [1.25, 0.8, 1.7])
def test_the_frame_in_its_plates_exposure(shared_data: Path, true: float) -> None:
    """As it was before, but for the steps of eight bits and for what of the person was clipped."""
    scene = composite(room(shared_data, 1), 24, 4, 0.004)
    bright = lit(scene.frame, true)
    even = in_plate_exposure(bright, scene.plate, (true,) * 3)
    person, kept = scene.alpha[..., None] > 0.01, scene.frame * true < 0.97
    off = np.abs(even - scene.frame)
    assert off[kept].max() < 0.012
    assert off[~kept & ~person].max(initial=0) < 0.06  # the plate's own noise
    assert even.max() <= 1
    assert in_plate_exposure(bright, scene.plate, NO_GAIN) is bright


def test_a_window_that_is_clipped_in_one_of_them_is_none_in_the_other() -> None:
    plate = np.full((20, 20, 3), 0.5, np.float32)
    plate[:10], plate[10:15] = 0.9, 1.0  # as bright as 1.3
    bright = np.minimum(plate * 1.25, 1)
    np.testing.assert_allclose(in_plate_exposure(bright, plate, (1.25,) * 3), plate, atol=1e-6)
    dark = plate * np.float32(0.8)
    dark[10:15] = min(1.3 * 0.8, 1)
    np.testing.assert_allclose(in_plate_exposure(dark, plate, (0.8,) * 3), plate, atol=1e-6)


def test_a_faint_limb_before_a_clipped_wall_stays_in_all_channels() -> None:
    """Red is clipped in frame and plate alike; blue shows a tenth less light, and so does red afterwards."""
    plate = np.full((8, 8, 3), (0.95, 0.9, 0.6), np.float32)
    fan = plate.copy()
    fan[2:5] *= 0.9
    even = in_plate_exposure(np.minimum(fan * 1.25, 1), plate, (1.25,) * 3)
    np.testing.assert_allclose(even, fan, atol=1e-5)


@pytest.mark.parametrize("true", [1.25, 0.8])
def test_the_matte_is_the_same(shared_data: Path, true: float) -> None:
    scene = composite(room(shared_data, 1), 24, 4, 0.004)
    bright = lit(scene.frame, true)
    matting = NetworkMatting()
    before, after = (
        matting(one, scene.plate)
        for one in (scene.frame, in_plate_exposure(bright, scene.plate, frame_gain(bright, scene.plate)))
    )
    assert np.abs(before - after).mean() < 0.002


def test_what_it_says() -> None:
    assert describe_gains([NO_GAIN, NO_GAIN]) is None
    assert describe_gains([(1.25,) * 3]) == "frame 0 has 1.25 times the background's exposure: evened out"
    told = describe_gains([NO_GAIN, (1.25,) * 3, (1.1, 1.0, 0.9)])
    assert told == (
        "2 of 3 frames have 1.00 to 1.25 times the background's exposure and another white balance: evened out"
    )
