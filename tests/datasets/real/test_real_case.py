"""Whole cases: the mean of the frames, the truth at the right instants and places, the same bits every time."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.model import Body
from hfb.datasets.case import Case, load_case
from hfb.datasets.real import real_case
from hfb.datasets.real.case_windows import choose, real_windows
from hfb.datasets.real.markers import body_columns
from hfb.datasets.real.real_case import make_numbered_real_case, make_real_case
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.real.true_joints import pixels_of, without_leaps
from hfb.datasets.synthetic.sharp import load_sharp
from hfb.datasets.truth import load_joint_truth
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.initializer import Matte, Picture
from hfb.io.clip import read_clip
from hfb.io.media.images.image_io import read_matte, read_picture_srgb
from hfb.motion.static_pose import FirstBody
from hfb.photometry import linear_to_srgb, srgb_to_linear
from tests.datasets.real.videos import BODY, FPS, HEIGHT, WIDTH, figure, joints_m, write_recording
from tests.shared import SHARED_DATA

_AVERAGE = 5


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> RealSpec:
    """A folder with one short recording; pictures are not scaled."""
    folder = tmp_path_factory.mktemp("videos")
    write_recording(folder, count=14)
    return RealSpec(videos=folder, average=_AVERAGE, frames=2, size_px=384)


@pytest.fixture(scope="module")
def case(spec: RealSpec, tmp_path_factory: pytest.TempPathFactory) -> Case:
    """The case that starts at frame 2."""
    window = next(window for window in real_windows(spec)[0] if window.first == 2)
    return make_real_case(spec, 7, window, tmp_path_factory.mktemp("cases") / "case_0007")


def _digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def _camera(case: Case) -> PinholeCamera:
    facts = case.facts["camera"]
    return PinholeCamera.from_matrix(torch.tensor(facts["K"]), facts["height"], facts["width"])


def test_the_blurred_frame_is_the_mean_of_linear_light(case: Case) -> None:
    left, top, width, height = case.facts["crop"]
    for window, path in enumerate(case.frame_paths()):
        sharp = [figure(2 + window * _AVERAGE + j) / np.float64(255) for j in range(_AVERAGE)]
        mean = linear_to_srgb(np.mean([srgb_to_linear(one) for one in sharp], axis=0))
        inner = mean[top : top + height, left : left + width]
        # The video's RGB is lossless; the file's own rounding is half a level.
        np.testing.assert_allclose(read_picture_srgb(path), inner, atol=0.6 / 255)


def test_the_truth_lies_on_the_clock_and_in_the_picture(case: Case) -> None:
    truth = load_joint_truth(case.truth)
    columns, joints = body_columns(BODY)
    assert truth.smpl_joints.tolist() == joints
    assert len(joints) == 12
    np.testing.assert_allclose(truth.times_s, np.arange(2 * _AVERAGE) / FPS, atol=1e-12)
    for row in range(2 * _AVERAGE):
        np.testing.assert_allclose(truth.joints[row], joints_m(2 + row)[columns], atol=1e-9)
    camera = _camera(case)
    left, top = case.facts["crop"][:2]
    expected = joints_m(2)[columns][:, :2] / 4.0 * 200.0 + (WIDTH / 2, HEIGHT / 2) + 0.5 - (left, top)
    np.testing.assert_allclose(pixels_of(truth.joints[:1], camera)[0], expected, atol=1e-6)
    assert case.facts["joints_inside_matte"] > 0.95


def test_clip_and_facts_agree_with_the_clock(case: Case) -> None:
    clip = read_clip(case.clip)
    assert clip.exposure.fps is not None
    assert 1 / clip.exposure.fps == pytest.approx(_AVERAGE / FPS)
    assert clip.exposure.exposure_s(1 / clip.exposure.fps) == pytest.approx((_AVERAGE - 1) / FPS)
    assert clip.camera.K is not None
    np.testing.assert_allclose(clip.camera.K, case.facts["camera"]["K"])
    assert (case.number, case.frames, case.facts["set"]) == (7, 2, "b-aist")
    assert case.facts["truth"] == "multi-view"
    assert "triangulated" in case.facts["truth_source"]
    assert {"left_hip", "right_wrist"} < set(case.facts["truth_joints"])
    assert case.facts["truth_offset_mm"]["left_hip"] == [20, 50]
    assert case.start_paths()[0].exists() is False
    assert load_case(case.folder).facts == case.facts


def test_mattes_cutouts_and_blur_rate(case: Case) -> None:
    left, top, width, height = case.facts["crop"]
    room_free = [
        (np.abs(figure(2 + j).astype(int) - (230, 30, 40)).max(-1) == 0)[top : top + height, left : left + width]
        for j in range(_AVERAGE)
    ]
    true = np.mean(room_free, axis=0)
    assert np.abs(read_matte(case.true_matte_paths()[0]) - true).mean() < 0.03
    rate = np.any(room_free, axis=0).sum() / room_free[0].sum() - 1
    assert case.facts["blur_rates"][0] == pytest.approx(rate, rel=0.15)
    cutouts = load_sharp(case, 0)
    assert cutouts.shape == (8, height, width, 4)
    for u, cutout in zip(np.arange(8) / 7, cutouts, strict=True):
        mask = room_free[round(float(u) * (_AVERAGE - 1))]
        assert np.minimum(mask, cutout[..., 3]).sum() / np.maximum(mask, cutout[..., 3]).sum() > 0.85


def test_the_middle_is_a_sharp_frame(case: Case) -> None:
    left, top, width, height = case.facts["crop"]
    for window, path in enumerate(case.middle_paths()):
        true = figure(2 + window * _AVERAGE + _AVERAGE // 2)[top : top + height, left : left + width]
        np.testing.assert_allclose(read_picture_srgb(path) * 255, true, atol=0.6)


def test_a_single_frame_is_an_exposure_too(spec: RealSpec, tmp_path: Path) -> None:
    """Sharp frames, open for the whole interval, whose truth is known in the middle."""
    sharp = spec.model_copy(update={"set": "real", "average": (1,)})
    window = next(window for window in real_windows(sharp)[0] if window.first == 3)
    case = make_real_case(sharp, 1, window, tmp_path / "case")
    assert (case.facts["set"], case.facts["average"], case.blur_rate) == ("real", 1, 0)
    assert (case.facts["recording"], case.facts["video"]) == (window.place, f"{window.place}/cam01_walk.mp4")
    assert case.facts["exposure_s"] == case.facts["interval_s"] == pytest.approx(1 / FPS)
    truth = load_joint_truth(case.truth)
    np.testing.assert_allclose(truth.times_s, [0.5 / FPS, 1.5 / FPS])
    columns, _ = body_columns(BODY)
    for row in range(2):
        np.testing.assert_allclose(truth.joints[row], joints_m(3 + row)[columns], atol=1e-9)
    left, top, width, height = case.facts["crop"]
    for row, path in enumerate(case.frame_paths()):
        true = figure(3 + row)[top : top + height, left : left + width]
        np.testing.assert_allclose(read_picture_srgb(path) * 255, true, atol=0.6)
        assert path.read_bytes() == case.middle_paths()[row].read_bytes()
    assert read_clip(case.clip).exposure.exposure_s(1 / FPS) == pytest.approx(1 / FPS)


def test_numbers_follow_the_order_of_choice_and_each_has_the_same_bits(spec: RealSpec, tmp_path: Path) -> None:
    short = spec.model_copy(update={"average": (2,), "frames": 1})
    windows, _ = real_windows(short)
    chosen = choose(windows, 2, short.seed)[1]
    second = make_numbered_real_case(short, 2, tmp_path / "two")
    assert second.facts["first_frame"] == chosen.first
    assert _digests(make_real_case(short, 2, chosen, tmp_path / "again").folder) == _digests(second.folder)
    for number in (0, len(windows) + 1):
        with pytest.raises(InputError, match=f"{len(windows)} windows"):
            make_numbered_real_case(short, number, tmp_path / "none")


class _ByTheMattesBox:
    """An initialiser of the test's own: an upright body in rest pose, as high as the matte and in its middle."""

    def __call__(self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body):
        rows, columns = np.nonzero(np.asarray(matte) > 0.5)
        height_m = float(body.template[:, 1].max() - body.template[:, 1].min())
        depth = camera.fy * height_m / float(rows.max() - rows.min() + 1)
        middle = torch.tensor([columns.mean() + 0.5, (rows.min() + rows.max() + 1) / 2])
        pose = torch.zeros(24, 3)
        pose[0, 0] = torch.pi
        place = camera.unproject(middle, torch.tensor(depth)).float()
        return FirstBody(pose, place, torch.zeros(10), "box")


def test_an_estimator_stands_in_for_joints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without joints, calibration and plate: the median, the assumed camera, a body in every sharp frame."""
    monkeypatch.setattr(real_case, "make_initializer", lambda config, rasterizer: _ByTheMattesBox())
    write_recording(tmp_path / "videos", count=50)  # long enough for a clean median
    for name in ("walk.trc", "Calib.toml", "cam01_plate.png"):
        (tmp_path / "videos" / name).unlink()
    spec = RealSpec(videos=tmp_path / "videos", average=4, estimator="matte", size_px=128)
    window = next(window for window in real_windows(spec)[0] if window.first == 4)
    case = make_real_case(spec, 1, window, tmp_path / "case")
    truth = load_joint_truth(case.truth)
    assert truth.smpl_joints.tolist() == list(range(24))
    assert (case.facts["truth"], case.facts["truth_source"], case.facts["plate"]) == ("estimator", "box", "median")
    assert case.facts["camera"]["source"] == "assumed"
    assert max(case.facts["camera"]["height"], case.facts["camera"]["width"]) == 128
    assert any("pseudo truth" in remark for remark in case.facts["remarks"])
    # The pelvis walks with the figure: 3 px per frame of the video, at the case's scale.
    pelvis = pixels_of(truth.joints, _camera(case))[:, 0, 0]
    assert np.polyfit(np.arange(4), pelvis, 1)[0] == pytest.approx(3 * 128 / case.facts["crop"][3], rel=0.2)


def test_an_empty_window_is_no_case(tmp_path: Path) -> None:
    write_recording(tmp_path / "videos", count=60)  # the figure has left the picture by frame 50
    for name in ("walk.trc", "Calib.toml"):
        (tmp_path / "videos" / name).unlink()
    spec = RealSpec(videos=tmp_path / "videos", average=3, estimator="matte")
    window = next(window for window in real_windows(spec)[0] if window.first == 57)
    with pytest.raises(InputError, match="nobody moves"):
        make_real_case(spec, 1, window, tmp_path / "case")
    assert not (tmp_path / "case" / "case.json").exists()


def test_leaps_are_unknown_and_steady_motion_is_kept() -> None:
    rng = np.random.default_rng(0)
    start = rng.normal(0, 0.5, (24, 3))
    walk = start + np.arange(9)[:, None, None] * np.array([0.05, 0, 0])
    walk[4:, :, 2] += 3.0  # the whole person's distance flickers: not seen from the pelvis
    np.testing.assert_array_equal(without_leaps(walk), walk)
    wrong = walk.copy()
    wrong[4, 20] += (0, 0.9, 0)
    found = without_leaps(wrong)
    assert np.isnan(found[4, 20]).all()
    assert np.isfinite(np.delete(found.reshape(-1, 3), 4 * 24 + 20, axis=0)).all()
    wrong[4] = -walk[4]
    wrong[4, 0] = walk[4, 0]
    assert np.isnan(without_leaps(wrong)[4]).all()


@pytest.mark.skipif(not (SHARED_DATA / "pose2sim_balancing").is_dir(), reason="no shared data (set HFB_SHARED_DATA)")
def test_real_joints_lie_on_the_real_person(tmp_path: Path) -> None:
    """Both cameras; joints of thin limbs lie near the mask's edge, so not every one is inside it."""
    spec = RealSpec(videos=SHARED_DATA / "pose2sim_balancing", average=3, size_px=384)
    windows, refused = real_windows(spec)
    assert refused == {}
    assert {window.recording.shift for window in windows} == {-1}  # a flaw of that data, found from the pictures
    for number, window in enumerate(choose(windows, 2, 0), start=1):
        case = make_real_case(spec, number, window, tmp_path / str(number))
        assert case.facts["joints_inside_matte"] > 0.8
        truth = load_joint_truth(case.truth)
        thigh = (
            truth.joints[:, truth.smpl_joints.tolist().index(1)] - truth.joints[:, truth.smpl_joints.tolist().index(4)]
        )
        assert np.all((np.linalg.norm(thigh, axis=-1) > 0.3) & (np.linalg.norm(thigh, axis=-1) < 0.55))
    assert {window.recording.video.name[:5] for window in choose(windows, 2, 0)} == {"cam01", "cam04"}
