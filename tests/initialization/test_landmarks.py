"""The networks' decoding, with and without the networks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_line, height_m
from hfb.config import InitConfig, MattingConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.initialization import initializer, landmarks
from hfb.initialization.initializer import make_initializer
from hfb.initialization.landmarks import LANDMARK, Landmarks, PoseNetworks, Region, cut_region, networks_ready
from hfb.initialization.person_landmarks import before_gray, draw_stick_figure, find_landmarks, seen_all_ways
from hfb.initialization.silhouette_fit import matte_level, overlap
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.matting.methods import make_matting
from hfb.motion.static_pose import FirstBody
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer

needs_networks = pytest.mark.skipif(not networks_ready(), reason="the pose networks are not there (hfb models fetch)")


def test_anchor_count_is_the_detectors() -> None:
    anchors = landmarks._anchors()
    assert anchors.shape == (2254, 2)
    assert np.allclose(anchors[0], 0.5 / 28)
    assert np.allclose(anchors[-1], 6.5 / 7)


def test_region_cut_is_centred_and_turned() -> None:
    """A mark above the centre of a person who leans to the right comes out above the centre."""
    picture = np.zeros((200, 300, 3), np.float32)
    picture[98:103, 178:183] = 1  # 30 px to the right of (150, 100)
    crop = cut_region(picture, Region(150.5, 100.5, 120.0, np.pi / 2), 60)
    y, x = (float(v) for v in np.argwhere(crop[..., 0] > 0.5).mean(0))
    assert (x, y) == pytest.approx((29.5, 14.5), abs=1)
    upright = cut_region(picture, Region(150.5, 100.5, 120.0, 0.0), 60)
    y, x = (float(v) for v in np.argwhere(upright[..., 0] > 0.5).mean(0))
    assert (x, y) == pytest.approx((44.5, 29.5), abs=1)


def test_stick_figure_survives_absurd_points() -> None:
    points = np.random.default_rng(0).normal(0, 1e6, (33, 2))
    assert draw_stick_figure(points, (40, 30)).shape == (40, 30)
    assert draw_stick_figure(np.full((33, 2), 15.0), (40, 30)).sum() > 0


def test_before_gray_is_another_plate_in_the_picture() -> None:
    """Where the matte is right nothing of the plate is left, and what it lacks near the person stays.

    Somebody else, far from the matte, is gone.
    """
    rng = np.random.default_rng(0)
    person, plate = rng.uniform(0.1, 0.5, (2, 100, 90, 3)).astype(np.float32)
    alpha = np.zeros((100, 90), np.float32)
    alpha[20:80, 20:50] = rng.uniform(0.1, 1, (60, 30))
    alpha[40:60, 80:] = 1
    matte = alpha.copy()
    matte[:, 46:] = 0
    frame = alpha[..., None] * person + (1 - alpha[..., None]) * plate
    seen = before_gray(frame, plate, matte, 0.6)
    expected = linear_to_srgb(alpha[..., None] * person + (1 - alpha[..., None]) * 0.6)
    np.testing.assert_allclose(seen[:, :46], expected[:, :46], atol=1e-5)
    lacking = slice(20, 80), slice(46, 50)
    np.testing.assert_allclose(seen[lacking], linear_to_srgb(np.clip(0.6 + frame - plate, 0, 1))[lacking], atol=1e-5)
    np.testing.assert_allclose(seen[:, 80:], linear_to_srgb(np.full_like(seen[:, 80:], 0.6)), atol=1e-6)


def a_standing_person(seed: int) -> Landmarks:
    """Random places, shoulders a trunk's length of 40 px above the hips."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(20, 80, (33, 2))
    for side, x in (("left", 60), ("right", 40)):
        pixels[LANDMARK[f"{side}_shoulder"]], pixels[LANDMARK[f"{side}_hip"]] = (x, 30), (x, 70)
    region = Region(50.0, 60.0, 90.0, 0.2)
    return Landmarks(pixels, rng.normal(0, 0.3, (33, 3)), rng.random(33), 1.0, region, region)


def test_mirrored_landmarks_change_sides_and_return() -> None:
    found = a_standing_person(1)
    turned = found.mirrored(100)
    assert np.allclose(turned.pixels[LANDMARK["left_knee"]], [100, 0] + found.pixels[LANDMARK["right_knee"]] * [-1, 1])
    assert np.allclose(turned.world[LANDMARK["mouth_left"]], found.world[LANDMARK["mouth_right"]] * [-1, 1, 1])
    assert turned.region == Region(50.0, 60.0, 90.0, -0.2)
    again = turned.mirrored(100)
    for name in ("pixels", "world", "visibility"):
        assert np.allclose(getattr(again, name), getattr(found, name))


@pytest.mark.parametrize(("score", "moved"), [(0.9, True), (0.3, False)])
def test_what_the_mirror_image_shows_counts_half(score: float, moved: bool) -> None:
    found = a_standing_person(2)
    beside = found.pixels.copy()
    beside[LANDMARK["left_wrist"]] += 10, 0
    other = replace(found, pixels=beside, world=found.world + 0.1, score=score)

    class Mirror(PoseNetworks):
        opinions = range(1)

        def __init__(self) -> None: ...

        def locate(self, picture_srgb: np.ndarray, region: Region, opinion: int = 0) -> Landmarks:
            assert region == found.region.mirrored(100)
            assert picture_srgb[0, 0, 0] == 1
            return other.mirrored(100)

    picture = np.zeros((100, 100, 3), np.float32)
    picture[0, -1] = 1
    both = seen_all_ways(Mirror(), [picture], found)
    expected = found.pixels.copy()
    expected[LANDMARK["left_wrist"]] += (5, 0) if moved else (0, 0)
    assert np.allclose(both.pixels, expected)
    assert np.allclose(both.world, found.world + (0.05 if moved else 0))


def test_the_median_of_all_networks_walls_and_mirror_images_counts() -> None:
    found = a_standing_person(2)
    shifts = {0: 4.0, 1: 8.0, 2: 16.0, 3: 100.0}

    class Walls(PoseNetworks):
        """Network and picture say how far the person is moved; the third confuses limbs, the last shows nobody."""

        opinions = range(2)

        def __init__(self) -> None: ...

        def locate(self, picture_srgb: np.ndarray, region: Region, opinion: int = 0) -> Landmarks:
            level = int(picture_srgb[0, 0, 0])
            moved = replace(found, world=found.world + shifts[level] + opinion, score=0.2 if level == 3 else 0.9)
            moved = replace(moved, pixels=found.pixels + (40 if level == 2 else 0))
            return moved if region == found.region else replace(moved, world=found.world + 1 - opinion).mirrored(100)

    pictures = [np.full((100, 100, 3), level, np.float32) for level in shifts]
    told = seen_all_ways(Walls(), pictures, found)
    # network 0: as found, 8, 16, mirrored 1, 1, 1; network 1: 5, 9, 17, mirrored 0, 0, 0
    assert np.allclose(told.world, found.world + 1)
    assert np.allclose(told.pixels, found.pixels)


@needs_networks
def test_an_image_and_its_mirror_image_give_the_same_person(shared_data: Path) -> None:
    picture = read_picture_srgb(shared_data / "bodypose3d_walkin" / "f006.png").astype(np.float32)
    networks, width = PoseNetworks(), picture.shape[1]
    region = networks.detect(picture)[0]
    turned = np.ascontiguousarray(picture[:, ::-1])
    here = networks.locate(picture, region)
    there = networks.locate(turned, region.mirrored(width))
    alone = np.abs(there.mirrored(width).world - here.world).max()
    one = seen_all_ways(networks, [picture], here)
    two = seen_all_ways(networks, [turned], there).mirrored(width)
    assert alone > 0.01
    assert np.abs(two.world - one.world).max() < 1e-4


def test_without_networks_it_says_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path))
    with pytest.raises(InputError, match="hfb models fetch"):
        make_initializer(InitConfig(method="mediapipe"))
    assert make_initializer(InitConfig(method="auto")) is not None


@needs_networks
def test_a_real_blurred_walk(shared_data: Path) -> None:
    folder = shared_data / "bodypose3d_walkin"
    frame_srgb = read_picture_srgb(folder / "f006.png")
    frame, plate = (srgb_to_linear(p).astype(np.float32) for p in (frame_srgb, read_picture_srgb(folder / "plate.png")))
    matte = make_matting(MattingConfig())(frame, plate)
    found = find_landmarks(PoseNetworks(), frame, plate, matte)
    assert found is not None
    at = found[0].pixels
    assert found[1] > 0.5
    assert at[LANDMARK["nose"], 1] < at[LANDMARK["left_hip"], 1] < at[LANDMARK["left_ankle"], 1]
    camera = PinholeCamera.from_focal(float(np.hypot(720, 720)), 720, 720)
    body = load_default_body()
    first = make_initializer(InitConfig(method="auto"))(frame, plate, matte, camera, body)
    assert first.source == "mediapipe"
    assert overlap(first, matte_level(matte, camera, 128), body, make_rasterizer()) > 0.7
    assert float(AnatomicalPrior()(first.pose[None, 1:])[0]) < 60
    assert 1.5 < float(first.translation[2]) < 6
    assert float(height_m(body, first.betas)) == pytest.approx(height_line(body)[0], abs=1e-4)


@needs_networks
def test_an_empty_room_falls_back_to_the_matte(monkeypatch: pytest.MonkeyPatch) -> None:
    room = np.random.default_rng(0).random((120, 160, 3)).astype(np.float32) * 0.1 + 0.4
    matte = np.zeros((120, 160), np.float32)
    matte[40:80, 60:90] = 1
    found = find_landmarks(PoseNetworks(), room, room, matte)
    assert found is None or found[1] < 0.35
    searched = FirstBody(torch.zeros(24, 3), torch.zeros(3), torch.zeros(10), "matte")
    monkeypatch.setattr(initializer, "search_by_matte", lambda *_: (searched, 0.5))
    camera = PinholeCamera.from_focal(200.0, 120, 160)
    first = make_initializer(InitConfig(method="auto"))(room, room, matte, camera, load_default_body())
    assert first is searched
