"""The matting network: against the projection on figures it never saw, and the promises of the Protocol."""

import hashlib
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load

from hfb.config import MattingConfig
from hfb.datasets.example import write_example
from hfb.datasets.truth import load_truth
from hfb.errors import InputError
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.video_reading import read_frames
from hfb.matting.matte_network import CHANNELS, WIDTHS, MatteNetwork, features
from hfb.matting.matting_protocol import KnownBackground, Matting, matte_region, shrink
from hfb.matting.methods import make_matting
from hfb.matting.network import NetworkMatting, RenderConditionedMatting
from hfb.matting.second_look import EVIDENCE_CHANNELS, colour_evidence
from hfb.matting.third_look import FIT_CHANNELS, SHARED_CHANNELS, fit_evidence
from hfb.photometry import srgb_to_linear
from tests.matting.silhouettes import composite, generated_plate
from tests.shared import average_frames

matting = make_matting(MattingConfig(method="network"))


def soft_iou(matte: np.ndarray, alpha: np.ndarray) -> float:
    return float(np.minimum(matte, alpha).sum() / np.maximum(matte, alpha).sum())


def test_is_chosen_by_the_configuration() -> None:
    assert isinstance(matting, NetworkMatting)
    assert isinstance(matting, Matting)


def test_better_than_the_projection_on_jointed_figures() -> None:
    """Figures of lines and circles: no body, no clothes of the training."""
    mine, theirs = [], []
    for kind in ("flat", "clouds", "stripes"):
        for blur_px, seed in ((0, 10), (8, 11), (24, 12), (48, 13)):
            scene = composite(generated_plate(kind), blur_px, seed, shadow=0.3 * (seed % 2))
            mine.append(soft_iou(matting(scene.frame, scene.plate), scene.alpha))
            theirs.append(soft_iou(KnownBackground()(scene.frame, scene.plate), scene.alpha))
    assert np.mean(mine) > 0.85
    assert np.mean(mine) > np.mean(theirs)
    assert np.min(mine) > 0.6


def test_a_matte_that_a_fit_refines_is_nearly_the_whole_search() -> None:
    scene = composite(generated_plate("clouds"), 16, 11)
    quick, whole = (make_matting(MattingConfig(), quick=quick)(scene.frame, scene.plate) for quick in (True, False))
    assert not np.array_equal(quick, whole)
    assert soft_iou(quick, whole) > 0.85


def test_better_than_the_projection_on_the_example(tmp_path: Path) -> None:
    mine, theirs = [], []
    for seed in range(3):
        paths = write_example(tmp_path / str(seed), seed)
        frame, plate = (
            srgb_to_linear(read_picture_srgb(path)).astype(np.float32) for path in (paths.frame, paths.background)
        )
        alpha = load_truth(paths.truth).silhouettes.mean(0)
        mine.append(soft_iou(matting(frame, plate), alpha))
        theirs.append(soft_iou(KnownBackground()(frame, plate), alpha))
    assert np.mean(mine) > np.mean(theirs) + 0.02


def test_exposure_and_shadow_change_little() -> None:
    plain = composite(generated_plate("clouds"), 16, 1)
    before = soft_iou(matting(plain.frame, plain.plate), plain.alpha)
    for changed in (
        composite(generated_plate("clouds"), 16, 1, gain=1.08),
        composite(generated_plate("clouds"), 16, 1, shadow=0.35),
    ):
        assert soft_iou(matting(changed.frame, changed.plate), changed.alpha) > before - 0.06


def test_nobody_is_a_sentence() -> None:
    rng = np.random.default_rng(0)
    for kind in ("flat", "clouds", "stripes"):
        plate = generated_plate(kind)
        noisy = np.clip(plate + rng.normal(0, 0.004, plate.shape), 0, 1).astype(np.float32)
        for frame in (plate, noisy, np.clip(noisy * 1.1, 0, 1)):
            with pytest.raises(InputError, match="does not differ from the background plate"):
                matting(frame, plate)


def test_another_size_and_another_scene_are_sentences() -> None:
    plate = generated_plate("flat")
    with pytest.raises(InputError, match=r"240 x 300 .* 200 x 300"):
        matting(plate, plate[:, :200])
    with pytest.raises(InputError, match="nearly everywhere"):
        matting(1 - plate, plate)


def test_empty_real_plates_stay_empty(shared_data: Path) -> None:
    """Nothing moved: the network itself, before anything is thrown away, says so everywhere."""
    rng = np.random.default_rng(3)
    means = []
    for file in sorted((shared_data / "backgrounds" / "polyhaven").glob("*_0.jpg"))[3::8]:
        plate = shrink(srgb_to_linear(read_picture_srgb(file)).astype(np.float32), 256)
        frame = np.clip(plate * 1.02 + rng.normal(0, 0.006, plate.shape), 0, 1).astype(np.float32)
        means.append(matting.look(frame, plate).mean())  # type: ignore[attr-defined]
    assert np.mean(means) < 0.01


@pytest.mark.parametrize("size", [(300, 240), (37, 61), (20, 9)])
def test_any_size(size: tuple[int, int]) -> None:
    scene = composite(generated_plate("clouds", *size), 4, 2)
    assert NetworkMatting().look(scene.frame, scene.plate).shape == size
    if min(size) > 30:
        assert matting(scene.frame, scene.plate).shape == size


def test_large_pictures_give_the_same_matte() -> None:
    scene = composite(generated_plate("clouds"), 16, 2)
    large = [np.repeat(np.repeat(picture, 4, 0), 4, 1) for picture in (scene.frame, scene.plate)]
    matte = matting(*large)
    assert matte.shape == large[0].shape[:2]
    assert matte.dtype == np.float32
    assert soft_iou(shrink(matte[..., None].repeat(3, -1), 300)[..., 0], matting(scene.frame, scene.plate)) > 0.9


def test_deterministic_and_leaves_torch_its_threads() -> None:
    scene = composite(generated_plate("stripes"), 16, 4)
    before, mattes = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            mattes.append(NetworkMatting()(scene.frame, scene.plate))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    first = mattes[0]
    assert all(np.array_equal(first, other) for other in mattes)
    assert np.array_equal(first, matting(torch.from_numpy(scene.frame), torch.from_numpy(scene.plate)))
    assert first.min() >= 0
    assert first.max() <= 1


def test_shipped_files_belong_together() -> None:
    folder = resources.files("hfb.matting") / "data"
    content = (folder / "matting.safetensors").read_bytes()
    about = json.loads((folder / "matting.json").read_text())
    weights = load(content)
    assert len(content) <= 1.5e6
    assert about["sha256"] == hashlib.sha256(content).hexdigest()
    assert about["parameters"] == sum(value.numel() for value in weights.values())
    assert (about["channels"], tuple(about["widths"])) == (CHANNELS, WIDTHS)
    assert all(value.dtype == torch.float16 and value.isfinite().all() for value in weights.values())
    assert set(weights) == set(MatteNetwork().state_dict())
    assert about["held_out"]["network all"]["iou"] > about["held_out"]["projection all"]["iou"]


@pytest.mark.parametrize(
    ("name", "channels"),
    [("second_look", CHANNELS + EVIDENCE_CHANNELS), ("third_look", SHARED_CHANNELS + FIT_CHANNELS)],
)
def test_a_later_network_belongs_to_its_files(name: str, channels: int) -> None:
    folder = resources.files("hfb.matting") / "data"
    content = (folder / f"{name}.safetensors").read_bytes()
    about = json.loads((folder / f"{name}.json").read_text())
    assert len(content) <= 1.5e6
    assert about["sha256"] == hashlib.sha256(content).hexdigest()
    assert about["channels"] == channels
    assert about["parameters"] == sum(value.numel() for value in load(content).values())


def test_the_second_look_is_nearer_than_the_first() -> None:
    first, second = [], []
    for kind, seed in (("clouds", 21), ("stripes", 22), ("flat", 23)):
        scene = composite(generated_plate(kind), 24, seed)
        band = (scene.alpha > 0.05) & (scene.alpha < 0.95)
        looks = matting.look(scene.frame, scene.plate), matting.look_twice(scene.frame, scene.plate)[0]  # type: ignore[attr-defined]
        for alpha, told in zip(looks, (first, second), strict=True):
            told.append(np.abs(alpha - scene.alpha)[band].mean())
    assert np.mean(second) < np.mean(first)


def test_the_true_colours_give_the_true_share() -> None:
    """A flat red figure before gray: with the right matte at hand, every way to the colour says alpha."""
    alpha = np.clip(np.linspace(-0.5, 1.5, 64), 0, 1)[None].repeat(48, 0).astype(np.float32)
    plate = np.full((48, 64, 3), 0.3, np.float32)
    frame = alpha[..., None] * np.array([0.7, 0.1, 0.1], np.float32) + (1 - alpha[..., None]) * plate
    told = colour_evidence(frame, plate, alpha, np.full_like(alpha, -3))
    assert told.shape == (EVIDENCE_CHANNELS, 48, 64)
    for channel in (6, 9, 12):  # by the near, the far and the unmixed colour
        assert np.abs(told[channel] + 0.5 - alpha).mean() < 0.05


def test_a_fit_that_explains_the_picture_leaves_nothing_and_tells_the_share() -> None:
    alpha = np.clip(np.linspace(-0.5, 1.5, 64), 0, 1)[None].repeat(48, 0).astype(np.float32)
    plate = generated_plate("clouds")[:48, :64] * 0.7 + 0.2
    colour = alpha[..., None] * np.array([0.7, 0.1, 0.1], np.float32)
    frame = colour + (1 - alpha[..., None]) * plate
    told = fit_evidence(frame, plate, np.dstack([colour, alpha]))
    assert told.shape == (FIT_CHANNELS, 48, 64)
    assert np.abs(told[3] + 0.5 - alpha).mean() < 0.03  # by its colours
    assert np.allclose(told[6] + 0.5, alpha, atol=1e-6)
    assert np.abs(told[7:]).max() < 1e-3
    wider = np.roll(np.dstack([colour, alpha]), -8, 1)  # it covers what is the plate's
    assert np.abs(fit_evidence(frame, plate, wider)[7:, :, 8:28]).max() > 0.5


def test_the_third_look_keeps_what_no_fit_can_wear_and_drops_what_it_wears_by_mistake() -> None:
    """A bag in the first matte but not in the fit is kept; an arm of the fit over the visible plate is not added."""
    scene = composite(generated_plate("clouds"), 8, 21)
    body = scene.alpha
    rows, columns = np.nonzero(body > 0.5)
    bag = np.zeros_like(body)
    bag[int(np.median(rows)) - 10 : int(np.median(rows)) + 10, columns.max() - 4 : columns.max() + 16] = 1
    bag *= 1 - body
    frame = (1 - bag[..., None]) * scene.frame + bag[..., None] * np.array([0.6, 0.05, 0.3], np.float32)
    arm = np.zeros_like(body)
    arm[int(np.median(rows)) - 4 : int(np.median(rows)) + 4, max(0, columns.min() - 30) : columns.min() - 4] = 1
    fitted = np.dstack([frame * body[..., None], body])
    fitted[arm > 0] = [*frame[body > 0.9].mean(0), 1.0]
    alpha = RenderConditionedMatting(frame, scene.plate, np.maximum(body, bag)).matte(fitted)
    assert alpha[bag > 0.9].mean() > 0.8
    assert alpha[arm > 0].mean() < 0.15


def test_the_third_look_leaves_out_who_was_left_out() -> None:
    """Of two people one is meant: neither his matte nor his fit has the other one."""
    scene = composite(generated_plate("clouds"), 8, 21)
    two, plate, alpha = (np.concatenate([one, one], 1) for one in (scene.frame, scene.plate, scene.alpha))
    alpha[:, scene.alpha.shape[1] :] = 0
    found = RenderConditionedMatting(two, plate, alpha).matte(np.dstack([two * alpha[..., None], alpha]))
    assert soft_iou(found, alpha) > 0.9
    assert found[:, scene.alpha.shape[1] + 30 :].max() == 0


def test_where_the_third_look_sees_nobody_the_matte_stays() -> None:
    plate = generated_plate("flat")
    matte = np.zeros(plate.shape[:2], np.float32)
    matte[100:140, 100:120] = 0.9
    assert np.array_equal(
        RenderConditionedMatting(plate, plate, matte).matte(np.zeros((*matte.shape, 4), np.float32)), matte
    )


def test_features_say_the_same_of_a_darker_scene() -> None:
    """A shadow is one number: the ratio's three channels agree where light is lost, whatever the plate's colour."""
    plate = generated_plate("clouds") * 0.7 + 0.2
    seen = features(plate * 0.6, plate)
    assert seen.shape == (CHANNELS, *plate.shape[:2])
    assert np.ptp(seen[9:12], axis=0).max() < 0.03
    assert np.allclose(seen[9:12], np.log(0.6), atol=0.05)


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
