"""Methods that are told the truth: they must use it, and nothing must use it by accident."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.case import Case
from hfb.datasets.synthetic.sharp import save_sharp
from hfb.datasets.truth import JointTruth, save_joint_truth, save_truth
from hfb.errors import InputError
from hfb.evaluation.baselines.build import make_method
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.evaluation.baselines.oracles import SharpMiddle, TrueFront, TrueMatte, TrueStart, TwoStageOracle
from hfb.evaluation.baselines.true_bodies import true_bodies
from hfb.evaluation.judge import judge
from hfb.evaluation.metrics import mpjpe_mm
from hfb.evaluation.prediction import Prediction
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.fronts import mirrored_in_depth
from hfb.io.media.images.image_io import write_matte, write_png
from hfb.motion.static_pose import FirstBody, rescale_first_body
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from tests.evaluation.baselines.cases import bare_case
from tests.scenes import Scene, moving_scene

_SIZE = 48


def case_of(scene: Scene, folder: Path) -> Case:
    """The scene's truth as the files of a case; its colours are all red."""
    body = load_default_body()
    frames = len(scene.observation.mattes)
    save_truth(folder / "truth.npz", scene.truth)
    boxes = []
    for frame in range(frames):
        write_matte(folder / f"matte_{frame}.png", scene.observation.mattes[frame].numpy())
        rows = frame * 15 + np.linspace(0, 14, 8).round().astype(int)
        vertices = pose_rows(scene.truth.motion, rows, body).vertices
        red = torch.tensor([1.0, 0, 0]).expand(8, 8, 3)
        sharp = make_rasterizer().render(vertices, red, scene.observation.camera, body.mesh).numpy()
        boxes.append(save_sharp(folder / f"sharp_{frame}.png", sharp))
    return bare_case(folder, frames, sharp=boxes, camera={"height": _SIZE, "width": _SIZE})


class Recorder:
    """A method that only notes what it was shown."""

    name = "recorder"

    def __call__(self, case: Case, observation: Observation, starts: list[FirstBody]) -> Prediction:
        self.observation, self.starts = observation, starts
        return Prediction(None, None, None, 0.0)


def test_the_true_matte_takes_the_place_of_the_estimated_one(tmp_path: Path) -> None:
    scene, recorder = moving_scene(load_default_body(), _SIZE, frames=2), Recorder()
    case = case_of(scene, tmp_path)
    poor = replace(scene.observation, mattes=0.5 * scene.observation.mattes)
    TrueMatte("recorder@true-matte", recorder)(case, poor, scene.middle)
    assert torch.allclose(recorder.observation.mattes, scene.observation.mattes, atol=1e-4)
    assert torch.equal(recorder.observation.frames_linear, poor.frames_linear)


def test_the_true_start_is_the_middle_of_each_exposure(tmp_path: Path) -> None:
    """Through the method `static`, whose prediction is its start."""
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2)
    case = case_of(scene, tmp_path)
    wrong = [replace(first, pose=first.pose + 0.3, betas=first.betas + 1) for first in scene.middle]
    told = make_method(method_spec("static@true-start"), body)(case, scene.observation, wrong).motion
    expected = make_method(method_spec("static"), body)(case, scene.observation, scene.middle).motion
    assert told is not None
    assert expected is not None
    assert np.allclose(told.joints, expected.joints, atol=1e-5)


def test_the_true_height_is_told_to_the_fit(tmp_path: Path) -> None:
    """To each frame's where they are fitted alone; the start, of another height, is nobody's business."""
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2)
    case = case_of(scene, tmp_path)
    tall = torch.zeros(10)
    tall[0] = 2.0
    starts = [rescale_first_body(first, tall, body) for first in scene.middle]
    true_m = float(height_m(body, torch.from_numpy(scene.truth.motion.betas)))
    for name in ("best-settled-no-directions", "best-frames-settled-no-directions"):
        found = make_method(method_spec(f"{name}@true-height"), body)(case, scene.observation, starts).motion
        free = make_method(method_spec(name), body)(case, scene.observation, starts).motion
        assert found is not None
        assert free is not None
        assert float(height_m(body, torch.from_numpy(found.betas))) == pytest.approx(true_m, abs=1e-4)
        assert float(height_m(body, torch.from_numpy(free.betas))) > true_m + 0.05


def test_a_height_in_another_body_is_not_known(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE)
    case = case_of(replace(scene, truth=replace(scene.truth, betas_space="smpl")), tmp_path)
    method = make_method(method_spec("best-settled@true-height"), body)
    with pytest.raises(InputError, match="the true person's height is not known"):
        method(case, scene.observation, scene.middle)


def test_the_truth_of_another_body_gives_no_shape(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE)
    case = case_of(scene, tmp_path)
    save_truth(case.truth, replace(scene.truth, betas_space="smpl"))
    start = [replace(scene.middle[0], betas=scene.middle[0].betas + 1)]
    motion = make_method(method_spec("static@true-start"), body)(case, scene.observation, start).motion
    assert motion is not None
    assert motion.betas.tolist() == 10 * [1.0]


class RedOnlyInitializer:
    """Finds the truth, but only in a picture whose person is red where the matte is."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.silhouettes = scene.truth.silhouettes

    def __call__(self, frame_linear, plate_linear, matte, camera, body) -> FirstBody:  # type: ignore[no-untyped-def]
        expected = compose(
            torch.cat([matte[..., None] * torch.tensor([1.0, 0, 0]), matte[..., None]], -1), plate_linear
        )
        assert torch.allclose(frame_linear, expected, atol=0.02)
        shared = [(np.asarray(matte) >= 0.5) == silhouette for silhouette in self.silhouettes]
        row = int(np.argmax([one.mean() for one in shared]))
        if row == 14:  # nobody is found in the very last sub-frame
            raise InputError("nobody")
        motion = self.scene.truth.motion
        pose, place = (torch.from_numpy(one[row]).float() for one in (motion.poses, motion.trans))
        return FirstBody(pose.reshape(24, 3), place, torch.zeros(10), "truth")


def test_a_two_stage_oracle_sees_the_true_sub_frames(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, step_m=0.3)
    case = case_of(scene, tmp_path)
    oracle = TwoStageOracle("oracle", RedOnlyInitializer(scene), 8, 0, body)
    motion = oracle(case, scene.observation, scene.middle).motion
    assert motion is not None
    nearest = np.abs(scene.truth.motion.times_s[None] - motion.times_s[:, None]).argmin(1)
    true = scene.truth.motion.joints[nearest]
    assert mpjpe_mm(motion.joints[:7], true[:7]) < 1
    assert np.allclose(motion.joints[7], motion.joints[6])  # the miss is bridged by its neighbour


def test_the_simulated_estimator_is_as_good_as_without_blur(tmp_path: Path) -> None:
    """METRO's 70 mm of the lowest blur, in every sub-frame, the same for the same seed."""
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2, step_m=0.3)
    case = case_of(scene, tmp_path)
    method = make_method(method_spec("oracle-simulated"), body)
    motion, again = (method(case, scene.observation, scene.middle).motion for _ in range(2))
    assert motion is not None
    assert again is not None
    assert np.array_equal(motion.poses, again.poses)
    nearest = np.abs(scene.truth.motion.times_s[None] - motion.times_s[:, None]).argmin(1)
    assert 30 < mpjpe_mm(motion.joints, scene.truth.motion.joints[nearest]) < 130
    other = make_method(method_spec("oracle-simulated"), body)(replace(case, number=2), scene.observation, scene.middle)
    assert other.motion is not None
    assert not np.allclose(other.motion.poses, motion.poses, atol=1e-3)


LIMBS = [
    JOINT_NAMES.index(f"{side}_{part}")
    for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    for side in ("left", "right")
]


def real_case_of(scene: Scene, folder: Path, average: int = 5) -> tuple[Case, JointTruth]:
    """The scene as real video knows it: limbs alone, at a few instants, some of them unknown."""
    frames, motion = len(scene.observation.mattes), scene.truth.motion
    rows = np.concatenate([frame * 15 + np.linspace(0, 14, average).round().astype(int) for frame in range(frames)])
    joints = motion.joints[rows][:, LIMBS].copy()
    joints[0, 3] = np.nan
    joints[1, :8] = np.nan  # too few for a body at this instant
    index = np.repeat(np.arange(frames), average)
    truth = JointTruth(joints, np.array(LIMBS), motion.times_s[rows], index, tuple(JOINT_NAMES[one] for one in LIMBS))
    save_joint_truth(folder / "truth.npz", truth)
    return bare_case(folder, frames), truth


def test_oracles_of_real_video_know_where_the_limbs_are(tmp_path: Path) -> None:
    """The body laid onto the joints is nearly the true one: as a start, as a floor, and in its height."""
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2, step_m=0.2)
    case, truth = real_case_of(scene, tmp_path)
    wrong = [replace(first, pose=first.pose + 0.3, betas=first.betas + 1) for first in scene.middle]
    scores = {}
    for name in ("static", "static@true-start", "oracle-floor"):
        prediction = make_method(method_spec(name), body)(case, scene.observation, wrong)
        scores[name] = judge(prediction, scene.observation, truth, body, None)
    assert scores["oracle-floor"]["mpjpe_mm"] < 12
    assert scores["oracle-floor"]["motion_mm"] < 0.25 * scores["oracle-floor"]["still_motion_mm"]
    assert scores["static@true-start"]["motion_mm"] == pytest.approx(scores["static"]["motion_mm"])  # both are still
    recorder = Recorder()
    TrueStart("recorder@true-start", recorder, body)(case, scene.observation, wrong)
    for start, true in zip(recorder.starts, scene.middle, strict=True):
        assert start.source == wrong[0].source  # fitted as the start whose place it takes
        assert torch.linalg.vector_norm(start.translation - true.translation) < 0.04
        assert float(height_m(body, start.betas)) == pytest.approx(float(height_m(body, true.betas)), abs=0.06)


def test_the_floor_of_a_known_motion_is_that_motion(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2, step_m=0.2)
    case = case_of(scene, tmp_path)
    prediction = make_method(method_spec("oracle-floor"), body)(case, scene.observation, scene.middle)
    scores = judge(prediction, scene.observation, scene.truth, body, None)
    assert scores["mpjpe_mm"] < 8
    assert scores["front_wrong"] == 0


@pytest.mark.parametrize("real", [True, False])
def test_a_start_whose_front_is_wrong_is_turned_and_a_right_one_kept(real: bool, tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2)
    case = real_case_of(scene, tmp_path)[0] if real else case_of(scene, tmp_path)
    turned = [scene.middle[0], mirrored_in_depth(scene.middle[1])]
    recorder = Recorder()
    TrueFront("recorder@true-front", recorder, body)(case, scene.observation, turned)
    assert recorder.starts[0] is turned[0]
    for found, true in zip(recorder.starts, scene.middle, strict=True):
        turns, expected = (axis_angle_to_matrix(one.pose) for one in (found, true))
        assert torch.allclose(turns, expected, atol=1e-4)
        assert torch.equal(found.translation, true.translation)


def test_real_videos_height_is_that_of_the_body_on_the_joints(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE)
    case, _ = real_case_of(scene, tmp_path)
    laid = true_bodies(case, body).betas
    assert laid is not None
    method = make_method(method_spec("best-settled-no-directions@true-height"), body)
    found = method(case, scene.observation, scene.middle).motion
    assert found is not None
    told_m = float(height_m(body, torch.from_numpy(found.betas)))
    assert told_m == pytest.approx(float(height_m(body, laid)), abs=1e-4)
    assert told_m == pytest.approx(float(height_m(body, torch.from_numpy(scene.truth.motion.betas))), abs=0.06)


def test_too_few_joints_are_no_body(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE)
    case, truth = real_case_of(scene, tmp_path)
    truth.joints[:, 5:] = np.nan
    save_joint_truth(case.truth, truth)
    for name in ("static@true-start", "oracle-floor", "best@true-height"):
        with pytest.raises(InputError, match="fewer than 6 joints"):
            make_method(method_spec(name), body)(case, scene.observation, scene.middle)


def test_the_rival_sees_the_sharp_middle_and_stands_still(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), _SIZE, frames=2)
    case, _ = real_case_of(scene, tmp_path)
    shown = []

    def initializer(frame_linear, plate_linear, matte, camera, body) -> FirstBody:  # type: ignore[no-untyped-def]
        shown.append((frame_linear, matte))
        return scene.middle[len(shown) - 1]

    rival = SharpMiddle("oracle-middle", initializer, 8, body)
    with pytest.raises(InputError, match=r"has no middle_0\.png"):
        rival(case, scene.observation, scene.middle)
    plate = scene.observation.plate_linear.numpy()
    for frame, path in enumerate(case.middle_paths()):
        picture = plate.copy()
        picture[10:40, 12 + 8 * frame : 24 + 8 * frame] = (0.9, 0.1, 0.1)
        write_png(path, picture ** np.float32(1 / 2.2))
    motion = rival(case, scene.observation, scene.middle).motion
    expected = make_method(method_spec("static"), body)(case, scene.observation, scene.middle).motion
    assert motion is not None
    assert expected is not None
    assert np.array_equal(motion.joints, expected.joints)
    for frame, (picture, matte) in enumerate(shown):
        assert picture[20, 18 + 8 * frame, 0] > 0.7
        assert float(matte[15:35, 14 + 8 * frame : 22 + 8 * frame].mean()) > 0.8
        assert float(matte[:, 40:].mean()) < 0.2


def test_missing_truth_is_said(tmp_path: Path) -> None:
    body, scene, case = load_default_body(), moving_scene(load_default_body(), _SIZE), bare_case(tmp_path)
    for name in ("static@true-matte", "static@true-start", "static@true-front", "oracle-matte", "oracle-floor"):
        with pytest.raises(InputError):
            make_method(method_spec(name), body)(case, scene.observation, scene.middle)
