"""The networks' decoding, with and without the networks."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import InitConfig, MattingConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.initialization import initializer, landmarks
from hfb.initialization.initializer import make_initializer
from hfb.initialization.landmarks import LANDMARK, PoseNetworks, Region, cut_region, networks_ready
from hfb.initialization.person_landmarks import draw_stick_figure, find_landmarks
from hfb.initialization.silhouette_fit import matte_level, overlap
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.matting.methods import make_matting
from hfb.motion.static_pose import FirstBody
from hfb.photometry import srgb_to_linear
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
    found = find_landmarks(PoseNetworks(), frame_srgb, matte)
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


@needs_networks
def test_an_empty_room_falls_back_to_the_matte(monkeypatch: pytest.MonkeyPatch) -> None:
    room = np.random.default_rng(0).random((120, 160, 3)).astype(np.float32) * 0.1 + 0.4
    matte = np.zeros((120, 160), np.float32)
    matte[40:80, 60:90] = 1
    found = find_landmarks(PoseNetworks(), room, matte)
    assert found is None or found[1] < 0.35
    searched = FirstBody(torch.zeros(24, 3), torch.zeros(3), torch.zeros(10), "matte")
    monkeypatch.setattr(initializer, "search_by_matte", lambda *_: (searched, 0.5))
    camera = PinholeCamera.from_focal(200.0, 120, 160)
    first = make_initializer(InitConfig(method="auto"))(room, room, matte, camera, load_default_body())
    assert first is searched
