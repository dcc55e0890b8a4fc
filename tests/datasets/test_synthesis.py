"""Cases are reproducible to the bit, hold the blur they promise, and their files tell one story."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.datasets.blur_bins import wanted_interval
from hfb.datasets.case import Case, load_case
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.sources import open_motions
from hfb.datasets.set_spec import SetSpec
from hfb.datasets.synthetic import motion_search, synthesis
from hfb.datasets.synthetic.sharp import load_sharp
from hfb.datasets.synthetic.synthesis import make_case
from hfb.datasets.truth import Truth, load_truth
from hfb.errors import InputError
from hfb.evaluation.metrics import blur_rate, soft_iou
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.camera import PinholeCamera
from hfb.io.clip import read_clip
from hfb.io.media.images.image_io import read_matte, read_picture_srgb
from hfb.motion.clock import subframe_times_s
from hfb.motion.static_pose import load_first_body
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.rendering.backends import make_rasterizer
from tests.shared import SHARED_DATA

REAL_MOTIONS, REAL_BACKGROUNDS = SHARED_DATA / "cmu_bvh", SHARED_DATA / "backgrounds" / "polyhaven"
USABLE = tuple(range(8))
SINGLE = SetSpec(set="bt-amass", seed=7, fill="even", size_px=96)
EASY = SetSpec(set="bt-amass", seed=3, fill="even", size_px=96, easy=True)
CLOTHED = SetSpec(set="bc-cape", seed=7, fill="even", size_px=96, frames=4)

Make = Callable[[SetSpec, int], Case]


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Cases, each made once for all tests."""
    made: dict[tuple[SetSpec, int], Case] = {}

    def make(spec: SetSpec, number: int) -> Case:
        if (spec, number) not in made:
            made[spec, number] = make_case(spec, number, USABLE, tmp_path_factory.mktemp("case"))
        return made[spec, number]

    return make


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def seen_by_fit(truth: Truth, rows: np.ndarray, size_px: int) -> np.ndarray:
    """Silhouettes of the body that is fitted, at rows of the true motion."""
    body = load_default_body()
    camera = PinholeCamera.from_matrix(torch.from_numpy(truth.motion.K), size_px, size_px)
    vertices = pose_rows(truth.motion, rows, body).vertices
    return make_rasterizer("coverage", "cpu", 1).render(vertices, None, camera, body.mesh)[..., 3].numpy()


def test_the_same_bytes_whatever_else_is_made(make: Make, tmp_path: Path) -> None:
    first, third = make(SINGLE, 1), make(SINGLE, 3)
    synthesis._shelf.cache_clear()
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        again = make_case(SINGLE, 3, USABLE, tmp_path / "third")
        make_case(SINGLE, 1, USABLE, tmp_path / "first")
    finally:
        assert torch.get_num_threads() == 2
        torch.set_num_threads(threads)
    assert content(tmp_path / "third") == content(third.folder)
    assert content(tmp_path / "first") == content(first.folder)
    assert (again.number, again.blur_rate) == (third.number, third.blur_rate)
    other = make_case(SINGLE.model_copy(update={"seed": 8}), 1, USABLE, tmp_path / "other")
    assert (other.folder / "frame_0.png").read_bytes() != first.frame_paths()[0].read_bytes()


@pytest.mark.parametrize(("spec", "number"), [(SINGLE, 1), (SINGLE, 3), (SINGLE, 6), (EASY, 5), (CLOTHED, 3)])
def test_the_blur_rate_is_the_promised_one_and_the_truths(make: Make, spec: SetSpec, number: int) -> None:
    case = make(spec, number)
    low, high = wanted_interval(spec.set, spec.frames, spec.fill, number)
    assert low <= case.blur_rate < high
    assert case.facts["bin"] == [low, high]
    truth = load_truth(case.truth)
    rates = [blur_rate(truth.silhouettes[truth.motion.rows_of(k)].astype(np.float32)) for k in range(spec.frames)]
    np.testing.assert_allclose(case.facts["blur_rates"], rates)
    assert case.blur_rate == pytest.approx(np.mean(rates))


@pytest.mark.parametrize(("spec", "number"), [(SINGLE, 1), (CLOTHED, 3)])
def test_files_are_complete_and_plain(make: Make, spec: SetSpec, number: int) -> None:
    case = make(spec, number)
    assert load_case(case.folder) == case
    expected = [case.background, case.clip, case.truth, case.folder / "case.json", *case.frame_paths()]
    expected += [*case.start_paths(), *case.true_matte_paths(), *case.sharp_paths()]
    assert {path.name for path in expected} == set(content(case.folder))
    json.loads((case.folder / "case.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    for path in case.start_paths():
        assert load_first_body(path).source
    for path in (case.background, *case.frame_paths()):
        assert read_picture_srgb(path).shape == (spec.size_px, spec.size_px, 3)


@pytest.mark.parametrize(("spec", "number"), [(SINGLE, 6), (CLOTHED, 3)])
def test_clip_toml_gives_the_fit_the_truths_clock_and_camera(make: Make, spec: SetSpec, number: int) -> None:
    case = make(spec, number)
    clip, truth = read_clip(case.clip), load_truth(case.truth).motion
    assert clip.exposure.fps is not None
    assert clip.camera.K is not None
    interval_s = 1 / clip.exposure.fps
    exposure_s = clip.exposure.exposure_s(interval_s)
    assert exposure_s is not None
    assert exposure_s <= interval_s <= 1.2501 * exposure_s
    instants = len(truth.rows_of(0))
    times, frames = subframe_times_s(spec.frames, instants, exposure_s, interval_s)
    assert np.array_equal(truth.times_s, times)
    assert np.array_equal(truth.frame_index, frames)
    assert np.array_equal(truth.K, np.array(clip.camera.K))
    eight = subframe_times_s(spec.frames, 8, exposure_s, interval_s)[0]
    assert np.abs(times[:, None] - eight).min(0).max() < 1e-9  # a fit's instants are among the truth's
    assert 0.04 < exposure_s < 0.51
    if spec.set == "bc-cape":
        on_grid = (truth.times_s + case.facts["motion"]["start_s"]) * 600
        np.testing.assert_allclose(on_grid, np.round(on_grid), atol=1e-6)


def test_an_easy_frame_is_the_mean_of_its_sharp_renders(make: Make) -> None:
    case = make(EASY, 5)
    truth, matte = load_truth(case.truth), read_matte(case.true_matte_paths()[0])
    silhouettes = seen_by_fit(truth, truth.motion.rows_of(0), EASY.size_px)
    np.testing.assert_allclose(silhouettes.mean(0), matte, atol=2e-5)
    assert np.array_equal(silhouettes >= 0.5, truth.silhouettes)
    sharp = load_sharp(case, 0)
    every = (len(silhouettes) - 1) // 7
    assert np.abs(sharp[..., 3] - silhouettes[::every]).max() < 0.51 / 255
    plate = read_picture_srgb(case.background)
    frame = read_picture_srgb(case.frame_paths()[0])
    assert np.array_equal(frame[matte == 0], plate[matte == 0])
    # Where nothing moves in or out (all instants covered), eight colours nearly are the mean of all of them.
    mean = sharp[..., :3].mean(0) + (1 - sharp[..., 3].mean(0))[..., None] * srgb_to_linear(plate)
    assert np.abs(linear_to_srgb(mean) - frame)[matte > 0].mean() < 0.02
    weights = np.ones(8)
    weights[[0, -1]] = 0.5  # a better rule for the mean over the exposure, whose ends count half
    assert abs(np.average(sharp[..., 3], axis=0, weights=weights) - matte).mean() < 0.01


@pytest.mark.parametrize(("spec", "number", "least"), [(SINGLE, 6, 0.93), (CLOTHED, 3, 0.7)])
def test_the_truth_is_not_the_fits_own_render(make: Make, spec: SetSpec, number: int, least: float) -> None:
    """No inverse crime: another mesh and noise; yet the same person in the same pose."""
    case = make(spec, number)
    truth = load_truth(case.truth)
    np.testing.assert_allclose(
        pose_rows(truth.motion, np.arange(len(truth.motion.trans)), load_default_body()).joints.numpy(),
        truth.motion.joints,
        atol=1e-5,
    )
    rows = truth.motion.rows_of(0)[::9]
    pairs = zip(seen_by_fit(truth, rows, spec.size_px) >= 0.5, truth.silhouettes[rows], strict=True)
    overlap = float(np.mean([soft_iou(a.astype(np.float32), b.astype(np.float32)) for a, b in pairs]))
    assert least < overlap < (0.9995 if spec.set == "bt-amass" else 0.97)
    empty = read_matte(case.true_matte_paths()[0]) == 0
    frame, plate = (srgb_to_linear(read_picture_srgb(path))[empty] for path in (case.frame_paths()[0], case.background))
    assert 0.001 < (frame - plate).std() < 0.02


@pytest.mark.parametrize(("spec", "number"), [(SINGLE, 1), (SINGLE, 6), (CLOTHED, 3)])
def test_the_person_is_framed(make: Make, spec: SetSpec, number: int) -> None:
    case = make(spec, number)
    seen = np.max([read_matte(path) for path in case.true_matte_paths()], axis=0) > 0
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    assert min(rows[0], columns[0]) >= 3
    assert max(rows[-1], columns[-1]) < spec.size_px - 3
    longer = max(np.ptp(rows), np.ptp(columns)) + 1
    assert 0.5 * spec.size_px < longer < 0.92 * spec.size_px
    head, pelvis = load_truth(case.truth).motion.joints[0, [15, 0]]
    assert head[1] < pelvis[1] + 0.3  # y is down: not upside-down


def test_recorded_clothing_is_worn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion that brings its clothing for this body is shown in it, another body's clothing is not."""
    body = load_default_body()
    spec = SetSpec(set="bc-cape", seed=1, fill="natural", size_px=64)
    recorded = open_motions(None, 1)

    def made_with(clothing: np.ndarray | None, name: str) -> int:
        monkeypatch.setattr(
            synthesis, "_shelf", lambda *_: lambda index: replace(recorded.load(index), clothing=clothing)
        )
        return int(load_truth(make_case(spec, 1, [3], tmp_path / name).truth).silhouettes[0].sum())

    nothing = np.zeros((len(body.template), 3))
    wide = nothing.copy()
    wide[:, 2] = 0.1 * np.sign(body.template[:, 2].numpy())
    generated = made_with(None, "generated")
    assert made_with(nothing, "bare") != generated
    assert made_with(np.zeros((100, 3)), "of another body") == generated
    assert made_with(wide, "wide") > made_with(nothing, "bare again")


def still(index: int) -> MotionClip:
    return MotionClip(f"still {index}", np.zeros((240, 24, 3)), np.zeros((240, 3)), 120.0)


def test_motionless_motions_cannot_blur(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(synthesis, "_shelf", lambda *_: still)
    monkeypatch.setattr(motion_search, "_DRAWS", 9)
    for fill in ("even", "natural"):
        with pytest.raises(InputError, match=r"blur rate from 0\.05"):
            make_case(SINGLE.model_copy(update={"fill": fill}), 1, [0], tmp_path)
    assert not (tmp_path / "case.json").exists()


def test_motions_that_are_too_short_are_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        synthesis,
        "_shelf",
        lambda *_: lambda index: replace(still(index), poses=np.zeros((3, 24, 3)), translations=np.zeros((3, 3))),
    )
    with pytest.raises(InputError, match="livelier"):
        make_case(SINGLE, 2, [0], tmp_path)
    with pytest.raises(InputError, match="no motion can be read"):
        make_case(SINGLE, 2, [], tmp_path)


@pytest.mark.skipif(not (REAL_MOTIONS.is_dir() and REAL_BACKGROUNDS.is_dir()), reason="no real recordings here")
def test_real_motions_before_real_backgrounds(tmp_path: Path) -> None:
    spec = SetSpec(seed=2, fill="natural", size_px=64, frames=2, motions=REAL_MOTIONS, backgrounds=REAL_BACKGROUNDS)
    case = make_case(spec, 1, [2, 5, 60, 80], tmp_path)
    assert 0.05 <= case.blur_rate < 1.1
    assert case.facts["motion"]["name"] in [open_motions(REAL_MOTIONS, 2).names()[index] for index in (2, 5, 60, 80)]
    assert (REAL_BACKGROUNDS / case.facts["background"]).is_file()
