"""Methods that are told the truth: they must use it, and nothing must use it by accident."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.datasets.case import Case
from hfb.datasets.synthetic.sharp import save_sharp
from hfb.datasets.truth import save_truth
from hfb.errors import InputError
from hfb.evaluation.baselines.build import make_method
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.evaluation.baselines.oracles import TrueMatte, TwoStageOracle
from hfb.evaluation.metrics import mpjpe_mm
from hfb.evaluation.prediction import Prediction
from hfb.evaluation.protocol import pose_rows
from hfb.fitting.identity import rescale_first_body
from hfb.io.media.images.image_io import write_matte
from hfb.motion.static_pose import FirstBody
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


def test_missing_truth_is_said(tmp_path: Path) -> None:
    body, scene, case = load_default_body(), moving_scene(load_default_body(), _SIZE), bare_case(tmp_path)
    for name in ("static@true-matte", "static@true-start", "oracle-matte"):
        with pytest.raises(InputError):
            make_method(method_spec(name), body)(case, scene.observation, scene.middle)
