"""The default matte and the projection: composites with known alpha, the ways a plate can be wrong, real frames."""

from pathlib import Path

import numpy as np
import pytest

from hfb.config import MattingConfig
from hfb.errors import InputError
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.video_reading import read_frames
from hfb.matting.matting_protocol import KnownBackground, matte_region, shrink
from hfb.matting.methods import make_matting
from hfb.photometry import linear_to_srgb, srgb_to_linear
from tests.matting.silhouettes import Composite, composite, generated_plate
from tests.shared import average_frames

matting = make_matting(MattingConfig())
projection = KnownBackground()  # what test_network.py says of the network holds of it, too


def soft_iou(matte: np.ndarray, alpha: np.ndarray) -> float:
    return float(np.minimum(matte, alpha).sum() / np.maximum(matte, alpha).sum())


def band_error(matte: np.ndarray, alpha: np.ndarray) -> float:
    """Mean error where the truth is neither empty nor full."""
    return float(np.abs(matte - alpha)[(alpha > 0.02) & (alpha < 0.98)].mean())


def plain_difference(scene: Composite) -> np.ndarray:
    """What anybody would try first: |I - B| relative to its 97th percentile."""
    difference = np.abs(linear_to_srgb(scene.frame) - linear_to_srgb(scene.plate)).max(-1)
    return np.clip((difference - 0.04) / (np.percentile(difference, 97) - 0.04), 0, 1)


@pytest.mark.parametrize("kind", ["flat", "clouds", "stripes"])
@pytest.mark.parametrize("blur_px", [8, 24])
def test_known_alpha_on_generated_plates(kind: str, blur_px: int) -> None:
    errors, overlaps, plain = [], [], []
    for seed in range(3):
        scene = composite(generated_plate(kind), blur_px, seed)
        matte = matting(scene.frame, scene.plate)
        errors.append(band_error(matte, scene.alpha))
        overlaps.append(soft_iou(matte, scene.alpha))
        plain.append(soft_iou(plain_difference(scene), scene.alpha))
    assert np.mean(errors) < 0.15
    assert np.mean(overlaps) > 0.85
    assert np.mean(overlaps) > np.mean(plain) + 0.05


def test_known_alpha_on_real_plates(shared_data: Path) -> None:
    files = sorted((shared_data / "backgrounds").rglob("*.jpg"))[::20]
    overlaps = []
    for seed, file in enumerate(files):
        plate = shrink(srgb_to_linear(read_picture_srgb(file)).astype(np.float32), 384)
        scene = composite(plate, 20, seed, shadow=0.3 * (seed % 2))
        overlaps.append(soft_iou(matting(scene.frame, scene.plate), scene.alpha))
    assert np.mean(overlaps) > 0.82
    assert np.min(overlaps) > 0.6


def test_a_sharp_figure_is_full_inside_and_empty_outside() -> None:
    scene = composite(generated_plate("clouds"), 0, 3)
    matte = matting(scene.frame, scene.plate)
    assert matte[scene.alpha == 1].mean() > 0.93
    assert matte[scene.alpha == 0].mean() < 0.01


def test_exposure_and_shadow_change_little() -> None:
    plain = composite(generated_plate("clouds"), 16, 1)
    before = soft_iou(projection(plain.frame, plain.plate), plain.alpha)
    for changed in (
        composite(generated_plate("clouds"), 16, 1, gain=1.08),
        composite(generated_plate("clouds"), 16, 1, shadow=0.35),
    ):
        assert soft_iou(projection(changed.frame, changed.plate), changed.alpha) > before - 0.06


def test_large_pictures_give_the_same_matte() -> None:
    """The solution's size is bounded; the matte comes back in the frame's."""
    scene = composite(generated_plate("clouds"), 16, 2)
    large = [np.repeat(np.repeat(p, 4, 0), 4, 1) for p in (scene.frame, scene.plate)]
    matte = projection(*large)
    assert matte.shape == large[0].shape[:2]
    assert soft_iou(shrink(matte[..., None].repeat(3, -1), 300)[..., 0], projection(scene.frame, scene.plate)) > 0.9


def test_deterministic() -> None:
    scene = composite(generated_plate("stripes"), 16, 4)
    assert np.array_equal(projection(scene.frame, scene.plate), projection(scene.frame, scene.plate))


def test_nobody_is_a_sentence() -> None:
    plate = generated_plate("clouds")
    rng = np.random.default_rng(0)
    noisy = np.clip(plate + rng.normal(0, 0.004, plate.shape), 0, 1).astype(np.float32)
    for frame in (plate, noisy, np.clip(noisy * 1.1, 0, 1)):
        with pytest.raises(InputError, match="does not differ from the background plate"):
            projection(frame, plate)


def test_another_size_names_both() -> None:
    plate = generated_plate("flat")
    with pytest.raises(InputError, match=r"240 x 300 .* 200 x 300"):
        projection(plate, plate[:, :200])


def test_another_scene_is_a_sentence() -> None:
    with pytest.raises(InputError, match="nearly everywhere"):
        matting(generated_plate("stripes"), generated_plate("clouds"))


def test_region_has_a_margin_inside_the_picture() -> None:
    matte = np.zeros((50, 40), np.float32)
    matte[10:30, 5:15] = 1
    assert matte_region(matte, margin=0.1) == (8, 3, 32, 17)
    assert matte_region(matte, margin=2.0) == (0, 0, 50, 40)
    with pytest.raises(InputError):
        matte_region(np.zeros((5, 5), np.float32))


def test_real_averaged_video(shared_data: Path) -> None:
    """A man on one leg, 15 frames averaged: one piece, neither thin nor the whole room."""
    folder = shared_data / "pose2sim_balancing"
    frame = average_frames(read_frames(folder / "cam04_f000-059.mp4", 20, 35))
    plate = srgb_to_linear(read_picture_srgb(folder / "cam04_plate.png")).astype(np.float32)
    matte = matting(frame, plate)
    assert 100_000 < matte.sum() < 220_000
    top, left, bottom, right = matte_region(matte, margin=0.0, threshold=0.3)
    assert 450 < bottom - top < 950
    assert 350 < right - left < 900


def test_real_shutter_blur(shared_data: Path) -> None:
    """True in-camera blur, dark clothes in front of dark furniture; the man's middle must not be a hole."""
    folder = shared_data / "bodypose3d_walkin"
    frame, plate = (srgb_to_linear(read_picture_srgb(folder / n)).astype(np.float32) for n in ("f006.png", "plate.png"))
    matte = matting(frame, plate)
    top, left, bottom, right = matte_region(matte, margin=0.0, threshold=0.5)
    assert bottom - top > 500
    assert right - left < 330
    assert matte[150:300, 425:475].mean() > 0.9  # the black shirt
